"""Running a dataset's grasps again, in the same engine or another, under a changed setting."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.config import merge
from gmdx.dataset.read import Dataset, grasps_in, read_dataset
from gmdx.errors import DatasetError, Failure, GmdxError
from gmdx.files.folder import writing
from gmdx.files.formats import write_parquet
from gmdx.metrics.compute import MetricConfig, compute_metrics
from gmdx.metrics.table import COMPARED
from gmdx.objects.decompose import Attempt, DecomposeConfig, decompose
from gmdx.objects.model import ObjectModel
from gmdx.objects.repair import as_trimesh
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials

logger = logging.getLogger("gmdx")

PARTS_FOLDER = "parts"
KEY = ("object_id", "scene_id", "grasp_id")
_LABELS = [outcome.label for outcome in Outcome]
_OTHER_SEED = 1_000_003  # added to a run's seed: other noise, as reproducible


@dataclass(frozen=True)
class Run:
    """One way to run the same grasps on the same scenes."""

    name: str  # what its columns end in
    label: str  # in tables and figures
    engine: str
    physics: PhysicsConfig
    seed_shift: int = 0  # added to the seed of the pose noise
    hulls: DecomposeConfig | None = None  # the surface is decomposed anew


@dataclass(frozen=True)
class Replay:
    """A task: one object's chosen grasps in one run."""

    dataset: Path
    object_id: str
    rows: tuple[int, ...]  # of the object's table
    run: Run
    gripper: Gripper
    trials: int  # of each grasp
    trial: TrialConfig
    metric: MetricConfig
    out: Path  # to write, which nobody else sees yet

    @property
    def part(self) -> str:
        """The path inside the study that it comes into place at."""
        return f"{PARTS_FOLDER}/{self.object_id}/{self.run.name}.parquet"


@dataclass(frozen=True)
class RunRows:
    """What one run gave for n grasps; grasps that it lacks are NaN, and their outcomes -1."""

    values: dict[str, Float[Array, "n"]]  # by metric
    outcomes: Int[Array, "n t"]  # of every trial
    lower_bound: Bool[Array, "n"]  # of the push-out force
    poses: Float[Array, "n 4 7"]  # of the object by Snapshot, nominal trial: m, wxyz
    tool: Float[Array, "n 4 3"]  # m, of the tool point by Snapshot
    present: Bool[Array, "n"]

    def __len__(self) -> int:
        return len(self.present)


def runs_of(dataset: Dataset, other: str, *, noise_floor: bool) -> tuple[Run, ...]:
    """The dataset's own run `a`, the other engine's `b`, and the noise floor's.

    The floor is the dataset's engine with other pose noise, with half the time step, and with
    hulls of another resolution: a change that nobody would call another simulator.

    Args:
        dataset: Whose configuration all of them share.
        other: The second engine.
        noise_floor: Whether to run it.
    """
    physics, own = dataset.physics, str(dataset.info["engine"])
    pair = (Run("a", own, own, physics), Run("b", other, other, physics))
    if not noise_floor:
        return pair
    decompose = dataset.info["configuration"]["prepare"]["decompose"]
    hulls = other_hulls(merge(DecomposeConfig(), decompose))
    finer = replace(physics, timestep=0.5 * physics.timestep)
    return (
        *pair,
        Run("seed", f"{own}, other noise", own, physics, seed_shift=_OTHER_SEED),
        Run("timestep", f"{own}, half the step", own, finer),
        Run("hulls", f"{own}, other hulls", own, physics, hulls=hulls),
    )


def other_hulls(config: DecomposeConfig) -> DecomposeConfig:
    """Hulls of another resolution, held to the same bounds of fidelity.

    Coarser parts, a third of the hulls, a quarter of the vertices a hull, and vertices left out
    where they stick out twice as far.
    """
    coarser = Attempt(1.67 * config.attempts[0].threshold, config.attempts[0].seconds)
    return replace(
        config,
        attempts=(coarser,),
        max_hulls=max(config.max_hulls // 3, 1),
        max_vertices=max(config.max_vertices // 4, 8),
        vertex_tolerance=2.0 * config.vertex_tolerance,
    )


def replay(task: Replay) -> Failure | None:
    """Run one task and write its part; what cannot be run is returned, with the reason."""
    try:
        tables = list(_scenes(task))
    except Exception as error:  # one object's surprise is not the others'
        if not isinstance(error, GmdxError):
            logger.debug("%s failed in %s", task.object_id, task.run.name, exc_info=error)
        return Failure(task.object_id, None, task.run.name, type(error).__name__, str(error))
    table = pa.concat_tables(tables)
    with writing(task.out):
        write_parquet(task.out, [table], table.schema)
    return None


def _scenes(task: Replay) -> list[pa.Table]:
    dataset, run = read_dataset(task.dataset), task.run
    chosen = dataset.grasps(task.object_id).take(list(task.rows))
    hulls = None
    tables = []
    for scene_id in sorted(set(chosen["scene_id"].to_pylist())):
        rows = chosen.filter(pc.equal(chosen["scene_id"], scene_id))
        grasps = grasps_in(rows)
        scene = replace(dataset.scene(task.object_id, scene_id).scene, physics=run.physics)
        if run.hulls is not None:
            hulls = _hulls(scene.object, run.hulls) if hulls is None else hulls
            scene = replace(scene, object=replace(scene.object, hulls=hulls))
        trials = run_trials(
            replace(scene, seed=scene.seed + run.seed_shift),
            grasps,
            run.engine,
            trials=task.trials,
            gripper=task.gripper,
            config=task.trial,
        )
        tables.append(_part(rows, scene, trials, task.metric))
    return tables


def _hulls(obj: ObjectModel, config: DecomposeConfig) -> tuple[Float[Array, "_ 3"], ...]:
    """The dataset holds the surface that physics saw, so no source mesh is needed."""
    return decompose(as_trimesh(obj.vertices, obj.faces), config=config).hulls


def _part(rows: pa.Table, scene: Scene, trials: TrialResults, metric: MetricConfig) -> pa.Table:
    table = compute_metrics(scene, grasps_in(rows), trials, config=metric)
    columns: dict[str, Any] = {name: rows[name] for name in KEY}
    columns |= {m.name: table[m.name] for m in COMPARED}
    columns |= {name: table.extra[name] for name in ("force_is_lower_bound", "valid_trials")}
    columns["outcomes"] = [[_LABELS[o] for o in row] for row in trials.outcome]
    poses = np.concatenate([trials.object_position, trials.object_quaternion], axis=2)
    columns["poses"] = list(poses.reshape(len(rows), -1))
    columns["tool"] = list(trials.tool_position.reshape(len(rows), -1))
    part = pa.table(columns)
    return part.replace_schema_metadata({"engine": trials.engine})


@dataclass(frozen=True)
class RunParts:
    """All parts of one run: its rows, and the engine that it named."""

    rows: RunRows
    version: str  # of the engine, with its name; "" where nothing ran


def read_parts(paths: Sequence[tuple[Path, int]], *, trials: int) -> RunParts:
    """The rows of one run.

    Args:
        paths: By object: its part, which may be missing, and how many grasps it has.
        trials: Of each grasp.

    Raises:
        DatasetError: A part is damaged.
    """
    found: list[RunRows] = []
    version = ""
    for path, count in paths:
        if not path.is_file():
            found.append(_missing(count, trials))
            continue
        try:
            table = pq.read_table(path, partitioning=None)
        except (OSError, pa.ArrowInvalid) as error:
            raise DatasetError(
                f"cannot read {path}: {error}; remove it and run the same command"
            ) from error
        version = (table.schema.metadata or {}).get(b"engine", b"").decode()
        found.append(_rows(table))
    return RunParts(_joined(found), version)


def _rows(table: pa.Table) -> RunRows:
    n = len(table)
    index = {label: k for k, label in enumerate(_LABELS)}
    return RunRows(
        values={m.name: table[m.name].to_numpy().astype(float) for m in COMPARED},
        outcomes=np.array([[index[o] for o in row] for row in table["outcomes"].to_pylist()]),
        lower_bound=table["force_is_lower_bound"].to_numpy().astype(bool),
        poses=np.array(table["poses"].to_pylist(), float).reshape(n, 4, 7),
        tool=np.array(table["tool"].to_pylist(), float).reshape(n, 4, 3),
        present=np.ones(n, bool),
    )


def _missing(count: int, trials: int) -> RunRows:
    return RunRows(
        values={m.name: np.full(count, np.nan) for m in COMPARED},
        outcomes=np.full((count, trials), -1),
        lower_bound=np.zeros(count, bool),
        poses=np.full((count, 4, 7), np.nan),
        tool=np.full((count, 4, 3), np.nan),
        present=np.zeros(count, bool),
    )


def _joined(parts: Sequence[RunRows]) -> RunRows:
    return RunRows(
        values={m.name: np.concatenate([p.values[m.name] for p in parts]) for m in COMPARED},
        outcomes=np.concatenate([p.outcomes for p in parts]),
        lower_bound=np.concatenate([p.lower_bound for p in parts]),
        poses=np.concatenate([p.poses for p in parts]),
        tool=np.concatenate([p.tool for p in parts]),
        present=np.concatenate([p.present for p in parts]),
    )
