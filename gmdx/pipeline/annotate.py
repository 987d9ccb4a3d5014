"""What happens to one object, from its mesh to its folder in the dataset.

On a CPU `annotate` does it all. Where trials run in batches across objects, `begin` does what comes
before them and `finish` what comes after.
"""

import logging
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gmdx.arrays import Array
from gmdx.dataset.costs import Costs
from gmdx.dataset.schema import Failure
from gmdx.dataset.store import StorageError
from gmdx.dataset.write import ObjectWriter
from gmdx.errors import GmdxError, SceneError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.machine.processes import return_freed_memory
from gmdx.metrics.compute import compute_metrics
from gmdx.metrics.quality import Evidence
from gmdx.objects.model import ObjectModel
from gmdx.objects.prepare import prepare
from gmdx.objects.sources.source import ObjectSource
from gmdx.pipeline.config import GenerateConfig
from gmdx.scenes.camera import render
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene
from gmdx.scenes.settle import settle
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials

logger = logging.getLogger("gmdx")

LABELS = np.array([outcome.label for outcome in Outcome], dtype=object)


@dataclass(frozen=True)
class Task:
    """An object to annotate."""

    source: ObjectSource
    folder: Path  # to write, which nobody else sees yet
    gripper: Gripper
    config: GenerateConfig


@dataclass(frozen=True)
class Ended:
    """What became of an object."""

    produced: bool
    grasps: int
    failures: tuple[Failure, ...]


@dataclass(frozen=True)
class Begun:
    """An object that is ready for its trials."""

    object: ObjectModel
    scenes: tuple[tuple[Scene, PlanarGrasp], ...]  # those that could be set up
    failures: tuple[Failure, ...]  # and the others
    costs: Costs


@dataclass(frozen=True)
class Tried:
    """An object with the results of its trials."""

    task: Task
    begun: Begun
    trials: tuple[TrialResults, ...]  # a record a scene


_Run = Callable[[Scene, PlanarGrasp, slice], TrialResults]


def annotate(task: Task) -> Ended:
    """Run every stage on one object, and write its folder."""
    config = task.config

    def run(scene: Scene, grasps: PlanarGrasp, rows: slice) -> TrialResults:
        return run_trials(
            scene,
            grasps[rows],
            config.engine,
            trials=config.trials,
            gripper=task.gripper,
            config=config.trial,
        )

    costs = Costs()
    try:
        obj = _prepared(task, costs)
        return _write(task, obj, lambda scene_id: _set_up(obj, scene_id, costs, task), run, costs)
    except StorageError:
        raise
    except Exception as error:
        return lost(failure(task.source.object_id, None, costs.current, error))


def begin(task: Task) -> Begun | Ended:
    """Everything before the trials."""
    costs = Costs()
    scenes: list[tuple[Scene, PlanarGrasp]] = []
    failures: list[Failure] = []
    try:
        obj = _prepared(task, costs)
    except Exception as error:
        return lost(failure(task.source.object_id, None, costs.current, error))
    for scene_id in range(task.config.scenes):
        try:
            scenes.append(_set_up(obj, scene_id, costs, task))
        except Exception as error:
            failures.append(failure(obj.object_id, scene_id, costs.current, error))
    if not scenes:
        return lost(*failures, _no_scene(task, costs))
    return Begun(obj, tuple(scenes), tuple(failures), costs)


def finish(tried: Tried) -> Ended:
    """Everything after the trials."""
    task, begun, costs = tried.task, tried.begun, tried.begun.costs
    scenes = {scene.scene_id: (scene, grasps) for scene, grasps in begun.scenes}
    results = dict(zip(scenes, tried.trials, strict=True))

    def run(scene: Scene, _: PlanarGrasp, rows: slice) -> TrialResults:
        found = results[scene.scene_id][rows]
        costs.add_device("trials", found.seconds)
        return found

    try:
        return _write(task, begun.object, scenes.__getitem__, run, costs, begun.failures)
    except StorageError:
        raise
    except Exception as error:
        return lost(failure(task.source.object_id, None, costs.current, error))


def _prepared(task: Task, costs: Costs) -> ObjectModel:
    with costs.stage("prepare"):
        obj = prepare(task.source, config=task.config.prepare, cache=task.config.cache)
    costs.add_prepared(obj.report["seconds"])
    return obj


def _set_up(obj: ObjectModel, scene_id: int, costs: Costs, task: Task) -> tuple[Scene, PlanarGrasp]:
    """The object at rest, and grasps on it."""
    config = task.config
    with costs.stage("settle"):
        scene = settle(
            obj, config.seed, scene_id=scene_id, physics=config.physics, config=config.settle
        )
    with costs.stage("sample"):
        grasps = sample_grasps(
            scene,
            config.grasps,
            sampler=config.sampler,
            gripper=task.gripper,
            config=config.sample,
            lines=config.metric.lines,
        )
    return scene, grasps


def _write(
    task: Task,
    obj: ObjectModel,
    set_up: Callable[[int], tuple[Scene, PlanarGrasp]],
    run: _Run,
    costs: Costs,
    known: Sequence[Failure] = (),
) -> Ended:
    """Every scene's images, trials and metrics into the object's folder."""
    config = task.config
    with costs.stage("write"):
        writer = ObjectWriter(task.folder, obj)
    evidence = Evidence()
    failures = list(known)
    failed = {item.scene_id for item in known}
    for scene_id in (n for n in range(config.scenes) if n not in failed):
        try:
            scene, grasps = set_up(scene_id)
            with costs.stage("render"):
                views = range(config.camera.views)
                images = [render(scene, view=view, config=config.camera) for view in views]
            found: list[Evidence] = []
            writer.write_scene(scene, images, _batches(scene, grasps, run, costs, found, task))
            evidence += sum(found, Evidence())
        except StorageError:
            raise
        except Exception as error:
            failures.append(failure(obj.object_id, scene_id, costs.current, error))
    if len(failures) == config.scenes:
        return lost(*failures, _no_scene(task, costs))
    failures.sort(key=lambda item: item.key)
    with costs.stage("write"):
        writer.close(failures=failures, evidence=evidence)
    writer.write_cost(costs.as_json())
    return Ended(produced=True, grasps=writer.grasps, failures=tuple(failures))


def _batches(
    scene: Scene,
    grasps: PlanarGrasp,
    run: _Run,
    costs: Costs,
    found: list[Evidence],
    task: Task,
) -> Iterator[tuple[PlanarGrasp, Mapping[str, Array]]]:
    """Grasps with their columns, a batch at a time, so that memory does not grow with them."""
    config = task.config
    for start in range(0, len(grasps), config.block):
        rows = slice(start, start + config.block)
        batch = grasps[rows]
        with costs.stage("trials"):
            trials = run(scene, grasps, rows)
        with costs.stage("metrics"):
            table = compute_metrics(scene, batch, trials, config=config.metric)
        costs.add_batch(trials, table.cost)
        found.append(table.evidence)
        with costs.stage("write"):
            yield batch, {**table.values, **table.extra, "outcomes": LABELS[table.outcomes]}
        return_freed_memory()


def failure(object_id: str, scene_id: int | None, stage: str, error: Exception) -> Failure:
    """An error as a line of `failures.jsonl`; one that nobody foresaw says where it arose."""
    message = str(error)
    if not isinstance(error, GmdxError):
        frames = traceback.extract_tb(error.__traceback__)
        where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else stage
        message = f"{message} ({where})"
        logger.debug("object %s failed in %s", object_id, stage, exc_info=error)
    return Failure(object_id, scene_id, stage, type(error).__name__, message)


def lost(*failures: Failure) -> Ended:
    """The end of an object that leaves no folder."""
    return Ended(produced=False, grasps=0, failures=failures)


def _no_scene(task: Task, costs: Costs) -> Failure:
    error = SceneError(f"none of the {task.config.scenes} scenes could be annotated")
    return failure(task.source.object_id, None, costs.current, error)
