"""What happens to one object, from its mesh to its folder in the dataset: the stages in a row.

`annotate` does it all in this process. Where trials of many objects run side by side on a device,
`set_up` comes before them and `finish` after.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import TypeVar

from gmdx.dataset.costs import cost_record
from gmdx.dataset.write import ObjectWriter
from gmdx.errors import Failure, SceneError
from gmdx.machine.clock import added
from gmdx.machine.memory import return_freed_memory
from gmdx.metrics.quality import Evidence
from gmdx.objects.model import ObjectModel
from gmdx.pipeline.stages import (
    ObjectOutcome,
    ReadyObject,
    SceneGrasps,
    SceneTrials,
    Stages,
    Task,
    TriedObject,
    failure,
    lost,
)
from gmdx.trials.results import TrialResults

T = TypeVar("T")


def annotate(task: Task) -> ObjectOutcome:
    """Prepare, settle, sample, try, render, measure and write one object."""
    ready = set_up(task)
    if isinstance(ready, ObjectOutcome):
        return ready
    return finish(try_grasps(ready))


def set_up(task: Task) -> ReadyObject | ObjectOutcome:
    """Prepare the object, and in every scene let it come to rest and sample grasps."""
    stages = Stages(task)
    obj = stages.attempt(None, stages.prepare)
    if isinstance(obj, Failure):
        return lost(obj)
    numbers = range(task.config.scenes)
    scenes, failures = _parted([stages.attempt(k, _set_up, stages, obj, k) for k in numbers])
    if not scenes:
        return lost(*failures, _no_scene(stages))
    return ReadyObject(task, obj, scenes, failures, stages.clock.seconds)


def _set_up(stages: Stages, obj: ObjectModel, scene_id: int) -> SceneGrasps:
    scene = stages.settle(obj, scene_id)
    grasps = stages.sample(scene)
    return SceneGrasps(scene, grasps)


def try_grasps(ready: ReadyObject) -> TriedObject:
    """Run the trials of every scene, in this process."""
    stages = Stages(ready.task)
    found = [stages.attempt(at.scene.scene_id, _try, stages, at) for at in ready.scenes]
    scenes, failures = _parted(found)
    seconds = ready.seconds + stages.clock.seconds
    return TriedObject(ready.task, ready.object, scenes, (*ready.failures, *failures), seconds)


def _try(stages: Stages, at: SceneGrasps) -> SceneTrials:
    return SceneTrials(at.scene, at.grasps, stages.try_grasps(at.scene, at.grasps))


def finish(tried: TriedObject) -> ObjectOutcome:
    """Render, measure and write every scene, and close the object's folder.

    Raises:
        StorageError: The disk refused.
    """
    stages = Stages(tried.task)
    made = stages.attempt(None, _finish, stages, tried)
    return lost(*tried.failures, made) if isinstance(made, Failure) else made


@dataclass(frozen=True)
class _WrittenScene:
    """What is left of a scene when it is written."""

    trials: TrialResults
    evidence: Evidence
    cost: dict[str, float]  # processor seconds of its metrics, by stage


def _finish(stages: Stages, tried: TriedObject) -> ObjectOutcome:
    obj, run = tried.object, stages.clock.run
    writer = run("write", ObjectWriter, tried.task.folder, obj)
    found = [stages.attempt(at.scene.scene_id, _write, stages, writer, at) for at in tried.scenes]
    scenes, failed = _parted(found)
    failures = tuple(sorted((*tried.failures, *failed), key=lambda item: item.key))
    if not scenes:
        return lost(*failures, _no_scene(stages))
    evidence = reduce(add, (scene.evidence for scene in scenes))
    run("write", writer.close, failures=failures, evidence=evidence)
    writer.write_cost(
        cost_record(
            tried.seconds + stages.clock.seconds,
            prepared=obj.report["seconds"],
            trials=[scene.trials for scene in scenes],
            metrics=[scene.cost for scene in scenes],
        )
    )
    return ObjectOutcome(produced=True, grasps=writer.grasps, failures=failures)


def _write(stages: Stages, writer: ObjectWriter, at: SceneTrials) -> _WrittenScene:
    run = stages.clock.run
    evidence, cost = Evidence(), dict[str, float]()
    images = stages.render(at.scene)
    run("write", writer.begin_scene, at.scene, images)
    try:
        for rows in stages.blocks(at.grasps):
            grasps, trials = at.grasps[rows], at.trials[rows]
            table = stages.measure(at.scene, grasps, trials)
            run("write", writer.add_grasps, grasps, trials, table)
            evidence, cost = evidence + table.evidence, added(cost, table.cost)
            return_freed_memory()
    except BaseException:
        writer.drop_scene()
        raise
    run("write", writer.end_scene)
    return _WrittenScene(at.trials, evidence, cost)


def _parted(found: Sequence[T | Failure]) -> tuple[tuple[T, ...], tuple[Failure, ...]]:
    """What was made, and what failed."""
    made = tuple(item for item in found if not isinstance(item, Failure))
    return made, tuple(item for item in found if isinstance(item, Failure))


def _no_scene(stages: Stages) -> Failure:
    task = stages.task
    error = SceneError(f"none of the {task.config.scenes} scenes could be annotated")
    return failure(task.source.object_id, None, stages.clock.current, error)
