"""Trials of several objects in one batch on a device, while the host works on other objects.

The host's processes prepare objects and compute metrics; one thread keeps the device at work. Its
batches are made of objects in the order in which they come, and no result depends on them.
"""

import contextlib
import logging
import queue
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

from gmdx.errors import GmdxError
from gmdx.machine.clock import Seconds
from gmdx.machine.processes import LATER, Finished, Later, run_tasks
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
_PATIENCE = 30.0  # s, for the device's thread to end at its next look when a run is broken off


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
    device = _Device(engine, config)
    _LOG.info("trials run on %s", engine.version)
    schedule = _Schedule(tasks, device)
    # What is not known yet is no task that a worker sees.
    stream = cast(Iterator[Task | TriedObject], schedule.next_tasks())
    try:
        with contextlib.closing(run_tasks(_on_host, stream, workers=workers)) as items:
            for item in items:
                ended = schedule.take(item)
                if ended is not None:
                    yield ended
                yield from schedule.failed()
        yield from schedule.failed()
    finally:
        device.close()


def _on_host(task: Task | TriedObject) -> ReadyObject | ObjectOutcome:
    """What a worker process does: everything before an object's trials, or everything after."""
    return set_up(task) if isinstance(task, Task) else finish(task)


def _tried(ready: ReadyObject, results: Sequence[TrialResults]) -> TriedObject:
    """An object with the results of its scenes' trials, whose seconds are the device's."""
    scenes = tuple(
        SceneTrials(at.scene, at.grasps, found)
        for at, found in zip(ready.scenes, results, strict=True)
    )
    spent = {"trials": sum(found.seconds for found in results)}
    seconds = ready.seconds + Seconds(spent, spent)
    return TriedObject(ready.task, ready.object, scenes, ready.failures, seconds)


@dataclass(frozen=True)
class _Batch:
    """Objects whose trials run together, and then what came of them."""

    objects: Sequence[tuple[Task, ReadyObject]]
    results: Sequence[tuple[TrialResults, ...] | Exception] = ()


class _Schedule:
    """Which host work comes next, so that neither host nor device waits where it need not."""

    def __init__(self, tasks: Iterator[Task], device: "_Device") -> None:
        self._tasks, self._device = tasks, device
        self._more = True  # tasks to begin
        self._beginning = self._on_device = 0  # objects
        self._ready: list[tuple[Task, ReadyObject]] = []
        self._tried: deque[TriedObject] = deque()
        self._finishing = 0
        self._failed: list[Finished[Task, ObjectOutcome]] = []

    def next_tasks(self) -> Iterator[Task | TriedObject | Later]:
        """Finishing comes first, as it frees memory; then a batch is made while one is running."""
        while True:
            self._collect()
            self._hand_over()
            if self._tried:
                self._finishing += 1
                yield self._tried.popleft()
                continue
            if self._more and self._beginning + len(self._ready) < self._device.objects:
                task = next(self._tasks, None)
                self._more = task is not None
                if task is not None:
                    self._beginning += 1
                    yield task
                continue
            if not (self._more or self._beginning or self._on_device or self._finishing):
                return
            yield LATER

    def take(
        self, item: Finished[Task | TriedObject, ReadyObject | ObjectOutcome]
    ) -> Finished[Task, ObjectOutcome] | None:
        """Note what a worker did; the end of an object, where it was that."""
        if isinstance(item.task, Task):
            self._beginning -= 1
            if isinstance(item.result, ReadyObject):
                self._ready.append((item.task, item.result))
                return None
            return Finished(item.task, item.result)
        self._finishing -= 1
        if isinstance(item.result, ReadyObject):
            raise TypeError("an object was begun again instead of finished")
        return Finished(item.task.task, item.result)

    def failed(self) -> Iterator[Finished[Task, ObjectOutcome]]:
        """Objects whose trials could not be run."""
        while self._failed:
            yield self._failed.pop()

    def _hand_over(self) -> None:
        """Give the device what is ready, when it is a full batch or all that there will be."""
        last = not self._more and not self._beginning
        full = len(self._ready) >= self._device.objects
        if self._ready and self._on_device == 0 and (full or last):
            self._on_device = len(self._ready)
            self._device.give(_Batch(self._ready))
            self._ready = []

    def _collect(self) -> None:
        """Take finished batches from the device."""
        batch = self._device.take()
        if batch is None:
            return
        self._on_device -= len(batch.objects)
        for (task, begun), result in zip(batch.objects, batch.results, strict=True):
            if isinstance(result, Exception):
                why = failure(task.source.object_id, None, "trials", result)
                self._failed.append(Finished(task, lost(*begun.failures, why)))
            else:
                self._tried.append(_tried(begun, result))


class _Device:
    """A thread that runs one batch after the other."""

    def __init__(self, engine: ParallelEngine, config: GenerateConfig) -> None:
        self.engine, self._config = engine, config
        trials = config.scenes * config.grasps * config.trials
        self.objects = min(max(1, -(-engine.wanted_trials // trials)), MOST_OBJECTS)  # a batch
        self._given: queue.SimpleQueue[_Batch | None] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[_Batch | BaseException] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name="gmdx trials", daemon=True)
        self._thread.start()

    def give(self, batch: _Batch) -> None:
        """Queue a batch."""
        self._given.put(batch)

    def take(self) -> _Batch | None:
        """A batch that is done, if there is one."""
        try:
            found = self._done.get_nowait()
        except queue.Empty:
            return None
        if isinstance(found, BaseException):
            raise found
        return found

    def close(self) -> None:
        """End the thread: at once where it has nothing to do, else at its next chunk of steps."""
        self.engine.cancel()
        self._given.put(None)
        self._thread.join(timeout=_PATIENCE)

    def _serve(self) -> None:
        while (batch := self._given.get()) is not None:
            try:
                self._done.put(_Batch(batch.objects, self._run(batch.objects)))
            except Cancelled:
                return
            except BaseException as error:  # the caller's thread raises it
                self._done.put(error)
                return

    def _run(
        self, objects: Sequence[tuple[Task, ReadyObject]]
    ) -> Sequence[tuple[TrialResults, ...] | Exception]:
        """Trials of all objects at once; if that fails, of one after the other, to find out why.

        Raises:
            Exception: Everything failed, and not by an error of our own: the device is lost.
        """
        found = self._together(objects)
        if not isinstance(found, Exception):
            return found
        if len(objects) == 1:
            return [found]
        _LOG.warning("a batch of %d objects failed: %s; each alone now", len(objects), str(found))
        alone = [self._together([item]) for item in objects]
        if all(isinstance(one, Exception) and not isinstance(one, GmdxError) for one in alone):
            raise found
        return [one if isinstance(one, Exception) else one[0] for one in alone]

    def _together(
        self, objects: Sequence[tuple[Task, ReadyObject]]
    ) -> Sequence[tuple[TrialResults, ...]] | Exception:
        """Trials in one call, or the error without what it refers to on the device."""
        pairs = [(at.scene, at.grasps) for _, begun in objects for at in begun.scenes]
        try:
            results = run_trials(
                [scene for scene, _ in pairs],
                [grasps for _, grasps in pairs],
                self.engine,
                trials=self._config.trials,
                gripper=objects[0][0].gripper,
                config=self._config.trial,
            )
        except Cancelled:
            raise
        except Exception as error:
            _LOG.debug("trials failed", exc_info=error)
            return error.with_traceback(None)
        found = iter(results)
        return [tuple(next(found) for _ in begun.scenes) for _, begun in objects]
