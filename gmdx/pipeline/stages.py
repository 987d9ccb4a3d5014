"""The stages that one object goes through, each timed, and the records between them."""

import logging
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ParamSpec, TypeVar

from gmdx.errors import Failure, GmdxError
from gmdx.files.folder import StorageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.machine.clock import Clock, Seconds
from gmdx.metrics.compute import MetricTable, compute_metrics
from gmdx.objects.model import ObjectModel
from gmdx.objects.prepare import prepare
from gmdx.objects.sources import ObjectSource
from gmdx.pipeline.config import GenerateConfig
from gmdx.scenes.camera import DepthImage, render
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene
from gmdx.scenes.settle import settle
from gmdx.trials.results import TrialResults, joined_results
from gmdx.trials.run import run_trials

logger = logging.getLogger("gmdx")
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Task:
    """An object to annotate."""

    source: ObjectSource
    folder: Path  # to write, which nobody else sees yet
    gripper: Gripper
    config: GenerateConfig


@dataclass(frozen=True)
class SceneGrasps:
    """A scene and the grasps sampled in it."""

    scene: Scene
    grasps: PlanarGrasp


@dataclass(frozen=True)
class SceneTrials:
    """A scene, its grasps, and what their trials came to."""

    scene: Scene
    grasps: PlanarGrasp
    trials: TrialResults


@dataclass(frozen=True)
class ReadyObject:
    """An object that is ready for its trials."""

    task: Task
    object: ObjectModel
    scenes: tuple[SceneGrasps, ...]  # those that could be set up
    failures: tuple[Failure, ...]  # and the others
    seconds: Seconds  # spent until now


@dataclass(frozen=True)
class TriedObject:
    """An object whose trials have run."""

    task: Task
    object: ObjectModel
    scenes: tuple[SceneTrials, ...]  # those whose trials could be run
    failures: tuple[Failure, ...]  # the others, and those that could not be set up
    seconds: Seconds  # spent until now


@dataclass(frozen=True)
class ObjectOutcome:
    """What became of an object."""

    produced: bool
    grasps: int
    failures: tuple[Failure, ...]


@dataclass(frozen=True)
class Stages:
    """What can be done to a task's object, with its configuration and on a clock."""

    task: Task
    clock: Clock = field(default_factory=Clock)

    def prepare(self) -> ObjectModel:
        """The object in the mesh file, for physics."""
        config = self.task.config
        return self.clock.run(
            "prepare", prepare, self.task.source, config=config.prepare, cache=config.cache
        )

    def settle(self, obj: ObjectModel, scene_id: int) -> Scene:
        """The object at rest on the table."""
        config = self.task.config
        return self.clock.run(
            "settle",
            settle,
            obj,
            config.seed,
            scene_id=scene_id,
            physics=config.physics,
            config=config.settle,
        )

    def sample(self, scene: Scene) -> PlanarGrasp:
        """Grasps on it."""
        config = self.task.config
        return self.clock.run(
            "sample",
            sample_grasps,
            scene,
            config.grasps,
            sampler=config.sampler,
            gripper=self.task.gripper,
            lines=config.metric.lines,
            config=config.sample,
        )

    def try_grasps(self, scene: Scene, grasps: PlanarGrasp) -> TrialResults:
        """Their trials, in this process, some grasps at a time to bound memory."""
        config = self.task.config
        return joined_results(
            [
                self.clock.run(
                    "trials",
                    run_trials,
                    scene,
                    grasps[rows],
                    config.engine,
                    trials=config.trials,
                    gripper=self.task.gripper,
                    config=config.trial,
                )
                for rows in self.blocks(grasps)
            ]
        )

    def render(self, scene: Scene) -> list[DepthImage]:
        """The scene's depth images, by view."""
        camera = self.task.config.camera
        return [
            self.clock.run("render", render, scene, view=view, config=camera)
            for view in range(camera.views)
        ]

    def measure(self, scene: Scene, grasps: PlanarGrasp, trials: TrialResults) -> MetricTable:
        """All metrics of some grasps."""
        config = self.task.config.metric
        return self.clock.run("metrics", compute_metrics, scene, grasps, trials, config=config)

    def blocks(self, grasps: PlanarGrasp) -> Iterator[slice]:
        """Rows of grasps that are worked on together, so that memory does not grow with them."""
        block = self.task.config.block
        return (slice(start, start + block) for start in range(0, len(grasps), block))

    def attempt(
        self, scene_id: int | None, function: Callable[P, T], /, *args: P.args, **kw: P.kwargs
    ) -> T | Failure:
        """What a function returns, or why it failed as a line of `failures.jsonl`.

        Args:
            scene_id: What the failure is of; None: the whole object.
            function: One stage, or some in a row.
            *args: Its arguments.
            **kw: Its keyword arguments.

        Raises:
            StorageError: The disk refused, which is no failure of the object.
        """
        try:
            return function(*args, **kw)
        except StorageError:
            raise
        except Exception as error:
            return failure(self.task.source.object_id, scene_id, self.clock.current, error)


def failure(object_id: str, scene_id: int | None, stage: str, error: Exception) -> Failure:
    """An error as a line of `failures.jsonl`; one that nobody foresaw says where it arose."""
    message = str(error)
    if not isinstance(error, GmdxError):
        frames = traceback.extract_tb(error.__traceback__)
        where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else stage
        message = f"{message} ({where})"
        logger.debug("object %s failed in %s", object_id, stage, exc_info=error)
    return Failure(object_id, scene_id, stage, type(error).__name__, message)


def lost(*failures: Failure) -> ObjectOutcome:
    """The outcome of an object that leaves no folder."""
    return ObjectOutcome(produced=False, grasps=0, failures=failures)
