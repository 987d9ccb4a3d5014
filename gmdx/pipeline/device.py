"""Trials of several objects in one batch on a device, while the host works on other objects.

The host's processes prepare objects and compute metrics; one thread keeps the device at work. Its
batches are made of objects in the order in which they come, and no result depends on them.
"""

import contextlib
import logging
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass

from gmdx.errors import GmdxError
from gmdx.machine.clock import Seconds
from gmdx.machine.executor import Crash, Executor, Finished, Inbox, ThreadExecutor
from gmdx.machine.tasks import open_executor
from gmdx.pipeline.annotate import finish, set_up
from gmdx.pipeline.config import GenerateConfig
from gmdx.pipeline.stages import (
    ObjectOutcome,
    ReadyObject,
    SceneTrials,
    Task,
    TriedObject,
    failure,
    lost,
)
from gmdx.trials.engines import MOST_OBJECTS, Cancelled, ParallelEngine, open_engine
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials

_LOG = logging.getLogger("gmdx")

_TryAll = Callable[[Sequence[ReadyObject]], Sequence[TriedObject | ObjectOutcome]]


def annotate_in_batches(
    tasks: Iterator[Task], config: GenerateConfig, *, workers: int
) -> Generator[Finished[Task, ObjectOutcome], None, None]:
    """Annotate objects, their trials on a device in batches across objects.

    Args:
        tasks: An object each.
        config: Of the run, resolved.
        workers: Processes for everything but the trials.
    """
    engine = open_engine(config.engine, parallel_trials=config.parallel_trials)
    if not isinstance(engine, ParallelEngine):
        raise ValueError(f"engine {config.engine} has no trials side by side")
    _LOG.info("trials run on %s", engine.version)
    trials = config.scenes * config.grasps * config.trials
    batch = min(max(1, -(-engine.wanted_trials // trials)), MOST_OBJECTS)
    inbox = Inbox()
    with (
        contextlib.closing(
            ThreadExecutor(inbox, name="gmdx trials", cancel=engine.cancel)
        ) as device,
        contextlib.closing(open_executor(inbox, workers=workers)) as host,
    ):
        yield from schedule(tasks, _Trials(engine, config), inbox, host, device, batch=batch)


def schedule(
    tasks: Iterator[Task],
    try_all: _TryAll,
    inbox: Inbox,
    host: Executor,
    device: Executor,
    *,
    batch: int,
) -> Generator[Finished[Task, ObjectOutcome], None, None]:
    """Keep host and device at work: a batch is made while one is on the device.

    Args:
        tasks: An object each, drawn as they are needed.
        try_all: Runs a batch's trials on the device.
        inbox: Of both executors.
        host: Does what comes before the trials and after them.
        device: Runs the trials.
        batch: Objects of a full batch.
    """
    coming = next(tasks, None)
    setting_up = finishing = on_device = 0  # objects
    ready: list[ReadyObject] = []  # for the next batch
    tried: deque[TriedObject] = deque()  # to be finished
    while True:
        all_ready = coming is None and setting_up == 0
        if on_device == 0 and ready and (len(ready) >= batch or all_ready):
            device.give(try_all, ready)
            on_device, ready = len(ready), []

        while setting_up + finishing < host.places:
            if tried:  # first, as it frees memory
                host.give(finish, tried.popleft())
                finishing += 1
            elif coming is not None and setting_up + len(ready) < batch:
                host.give(set_up, coming)
                setting_up += 1
                coming = next(tasks, None)
            else:
                break

        if setting_up + finishing + on_device == 0:
            return
        done = inbox.take()
        match done.task, done.result:
            case Task(), ReadyObject() as found:
                setting_up -= 1
                ready.append(found)
            case Task() as task, found:
                setting_up -= 1
                yield Finished(task, done.attempt, found)
            case TriedObject(task=task), found:
                finishing -= 1
                yield Finished(task, done.attempt, found)
            case objects, Crash() as crash:
                on_device = 0
                for obj in objects:
                    yield Finished(obj.task, done.attempt, crash)
            case objects, outcomes:
                on_device = 0
                for obj, found in zip(objects, outcomes, strict=True):
                    if isinstance(found, TriedObject):
                        tried.append(found)
                    else:
                        yield Finished(obj.task, done.attempt, found)


@dataclass(frozen=True)
class _Trials:
    """What the device does with a batch."""

    engine: ParallelEngine
    config: GenerateConfig

    def __call__(self, batch: Sequence[ReadyObject]) -> list[TriedObject | ObjectOutcome]:
        """Trials of all objects at once; if that fails, of one after the other, to find out why.

        Raises:
            Exception: Everything failed, and not by an error of our own: the device is lost.
        """
        found = self._together(batch)
        if not isinstance(found, Exception):
            return [_tried(*pair) for pair in zip(batch, found, strict=True)]
        if len(batch) == 1:
            return [_untried(batch[0], found)]
        _LOG.warning("a batch of %d objects failed: %s; each alone now", len(batch), str(found))
        alone = [self._together([ready]) for ready in batch]
        if all(isinstance(one, Exception) and not isinstance(one, GmdxError) for one in alone):
            raise found
        return [
            _untried(ready, one) if isinstance(one, Exception) else _tried(ready, one[0])
            for ready, one in zip(batch, alone, strict=True)
        ]

    def _together(self, batch: Sequence[ReadyObject]) -> list[list[TrialResults]] | Exception:
        """Each object's results in one call, or the error without what it holds on the device."""
        scenes = [at for ready in batch for at in ready.scenes]
        try:
            results = run_trials(
                [at.scene for at in scenes],
                [at.grasps for at in scenes],
                self.engine,
                trials=self.config.trials,
                gripper=batch[0].task.gripper,
                config=self.config.trial,
            )
        except Cancelled:
            raise
        except Exception as error:
            _LOG.debug("trials failed", exc_info=error)
            return error.with_traceback(None)
        found = iter(results)
        return [[next(found) for _ in ready.scenes] for ready in batch]


def _tried(ready: ReadyObject, results: Sequence[TrialResults]) -> TriedObject:
    """An object with the results of its scenes' trials, whose seconds are the device's."""
    scenes = tuple(
        SceneTrials(at.scene, at.grasps, found)
        for at, found in zip(ready.scenes, results, strict=True)
    )
    spent = {"trials": sum(found.seconds for found in results)}
    seconds = ready.seconds + Seconds(spent, spent)
    return TriedObject(ready.task, ready.object, scenes, ready.failures, seconds)


def _untried(ready: ReadyObject, error: Exception) -> ObjectOutcome:
    """The outcome of an object whose trials cannot be run."""
    why = failure(ready.task.source.object_id, None, "trials", error)
    return lost(*ready.failures, why)
