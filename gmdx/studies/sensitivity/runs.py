"""One run of a sensitivity study: the trials of an object's grasps with other parameters."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import GmdxError
from gmdx.grasps.sample import sample_grasps
from gmdx.metrics.formulas import motion_metrics, outcome_metrics
from gmdx.objects.prepare import CacheOption, PrepareConfig, prepare
from gmdx.objects.sources import ObjectSource
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.settle import settle
from gmdx.studies.sensitivity.indices import Design
from gmdx.studies.sensitivity.parameters import HULL_BOUNDS, PARAMETERS, Setup, decomposition_for
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.run import run_trials

BASELINE = -1  # the block of an object's first run, with every parameter at its default
COUNTS = ("grasps", "trials", "held", "closed", "lower_bounds", "diverged")
HULL_COUNT = "hull_count"  # of the object in a run: equal levels of `hulls` show here

Value = float | int | str
Row = dict[str, Value]


@dataclass(frozen=True)
class Output:
    """What a run yields of one object's grasps."""

    name: str
    unit: str  # "" for a pure number
    definition: str


OUTPUTS = (
    Output("success", "", "share of successful trials (sim_success), mean over the grasps"),
    Output("force", "N", "push-out force, median over the grasps that the nominal trial held"),
    Output("moved", "m", "shift of the object during closing, mean over the nominal trials"),
    Output(
        "rotation",
        "rad",
        "rotation of the object during closing (clo_ori_comfort), mean over the nominal trials",
    ),
    Output(
        "stability",
        "rad",
        "rotation of the object in lift and hold (lif_ori_stability), mean over the nominal "
        "trials that came to their end",
    ),
)


@dataclass(frozen=True)
class SetupTask:
    """An object to prepare, settle and sample grasps of, once."""

    source: ObjectSource
    gripper: Gripper
    hulls: bool  # also those of the other bounds
    grasps: int
    trials: int
    seed: int
    cache: CacheOption


@dataclass(frozen=True)
class Chunk:
    """A few runs of one object."""

    object_id: str
    setup: Setup
    names: tuple[str, ...]  # of the parameters
    runs: tuple[int, ...]
    blocks: tuple[int, ...]
    values: Float[Array, "k d"]  # NaN: the default


def set_up(task: SetupTask) -> Setup | str:
    """The scene and grasps that all runs of an object share, or why there are none."""
    try:
        obj = prepare(task.source, cache=task.cache)
        hulls = {HULL_BOUNDS[1]: obj.hulls}
        for bound in HULL_BOUNDS if task.hulls else ():
            if bound not in hulls:
                config = PrepareConfig(decompose=decomposition_for(bound))
                hulls[bound] = prepare(task.source, config=config, cache=task.cache).hulls
        scene = settle(obj, task.seed)
        grasps = sample_grasps(scene, task.grasps, gripper=task.gripper)
    except GmdxError as error:
        return str(error)
    return Setup(scene, grasps, task.gripper, task.trials, TrialConfig(), hulls)


def changed(setup: Setup, values: Mapping[str, float]) -> Setup:
    """The setup with the given values of parameters; NaN leaves a default."""
    for name, value in values.items():
        if not np.isnan(value):
            setup = PARAMETERS[name].change(setup, value)
    return setup


def run_chunk(chunk: Chunk) -> list[Row]:
    """The rows of a few runs."""
    rows: list[Row] = []
    for run, block, given in zip(chunk.runs, chunk.blocks, chunk.values, strict=True):
        values = {
            name: PARAMETERS[name].default(chunk.setup) if np.isnan(value) else float(value)
            for name, value in zip(chunk.names, given, strict=True)
        }
        setup = changed(chunk.setup, dict(zip(chunk.names, given, strict=True)))
        named: Row = {"object_id": chunk.object_id, "run": run, "block": block}
        rows.append({**named, **values, **measure(setup)})
    return rows


def measure(setup: Setup) -> dict[str, float | int]:
    """Run the trials, and what came out: the outputs, and how many grasps each rests on.

    An output that no grasp has is NaN.
    """
    trials = run_trials(
        setup.scene,
        setup.grasps,
        trials=setup.trials,
        gripper=setup.gripper,
        config=setup.config,
    )
    motion = motion_metrics(trials)
    outcome = outcome_metrics(trials)
    held = (trials.outcome[:, 0] == Outcome.SUCCESS) & ~np.isnan(trials.push_force)
    return {
        "success": _mean(outcome["sim_success"]),
        "force": float(np.median(trials.push_force[held])) if held.any() else np.nan,
        "moved": _mean(motion["moved"]),
        "rotation": _mean(motion["clo_ori_comfort"]),
        "stability": _mean(motion["lif_ori_stability"]),
        "grasps": len(setup.grasps),
        "trials": int(trials.outcome.size),
        "held": int(held.sum()),
        "closed": int(np.isfinite(motion["moved"]).sum()),
        "lower_bounds": int(trials.push_force_is_lower_bound[held].sum()),
        "diverged": int(Outcome.is_failure(trials.outcome).sum()),
        HULL_COUNT: len(setup.scene.object.hulls),
    }


def chunks(
    object_id: str, setup: Setup, design: Design, *, done: set[int], size: int
) -> list[Chunk]:
    """The runs of one object that are not done yet, a few at a time: the baseline, then all."""
    stretched = [
        PARAMETERS[name].values(np.nan_to_num(design.places[:, k]))
        for k, name in enumerate(design.names)
    ]
    values = np.where(np.isnan(design.places), np.nan, np.stack(stretched, axis=1))
    values = np.concatenate([np.full((1, values.shape[1]), np.nan), values])
    block = np.concatenate([[BASELINE], design.block])
    todo = [run for run in range(len(values)) if run not in done]
    return [
        Chunk(
            object_id,
            setup,
            design.names,
            tuple(part),
            tuple(int(b) for b in block[part]),
            values[part],
        )
        for part in (todo[k : k + size] for k in range(0, len(todo), size))
    ]


def _mean(values: Float[Array, "n"]) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if len(known) else np.nan
