"""Running the same trials on several engines: each in a process of its own, and followed."""

import contextlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from gmdx.errors import GmdxError, UsageError
from gmdx.machine.executor import Crash
from gmdx.machine.tasks import run_tasks
from gmdx.trials.engines import ENGINES, choose, open_engine

_LOG = logging.getLogger("gmdx")

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True)
class RunFailure:
    """An engine that could not do what it was asked."""

    label: str
    error: str


@dataclass(frozen=True)
class _Job(Generic[TaskT, ResultT]):
    """A task, and what its process needs to know."""

    label: str
    function: Callable[[TaskT], ResultT]
    task: TaskT
    log_level: int


def run_apart(
    function: Callable[[TaskT], ResultT], task: TaskT, *, label: str, isolated: bool
) -> ResultT | RunFailure:
    """Run a task where no other engine's memory, threads or programs are in its way.

    Args:
        function: Importable by name.
        task: Its argument.
        label: Of the task, for messages.
        isolated: Use a new process, which a crash ends alone; False stays in this one.

    Returns:
        What the function returned, or why it could not.
    """
    job = _Job(label, function, task, _LOG.getEffectiveLevel())
    if not isolated:
        return _attempt(job)
    apart = run_tasks(_attempt_aloud, [job], workers=1, executor="processes")
    with contextlib.closing(apart) as finished:
        result = next(finished).result
    if isinstance(result, Crash):
        _LOG.warning("%s failed: %s", label, result)
        return RunFailure(label, str(result))
    return result


def choose_all(engines: Sequence[str]) -> list[str]:
    """Engines by their names, each of them installed.

    Raises:
        UsageError: One is not known or not installed, or there is none.
    """
    if not engines:
        raise UsageError("give at least one engine")
    for name in engines:
        open_engine(name)
    return [choose(name) for name in engines]


def refuse_idle_sizes(engines: Sequence[str], sizes: Sequence[int]) -> None:
    """Refuse numbers of parallel trials where no engine takes any.

    Raises:
        UsageError: Naming the engines.
    """
    if sizes and not any(ENGINES[name].parallel for name in engines):
        parallel = " and ".join(name for name, entry in ENGINES.items() if entry.parallel)
        raise UsageError(f"parallel trials are for {parallel}, and not for {', '.join(engines)}")


def refuse_less_than_one(**counts: int) -> None:
    """Refuse numbers of things below 1.

    Raises:
        UsageError: Naming the number.
    """
    for name, count in counts.items():
        if count < 1:
            raise UsageError(f"{name} must be at least 1, not {count}")


def _attempt_aloud(job: _Job[TaskT, ResultT]) -> ResultT | RunFailure:
    """In a new process: log what the caller listens to."""
    _LOG.setLevel(job.log_level)
    return _attempt(job)


def _attempt(job: _Job[TaskT, ResultT]) -> ResultT | RunFailure:
    try:
        return job.function(job.task)
    except Exception as error:  # one engine's failure is none of the others'
        own = isinstance(error, GmdxError)
        # What is not our own error needs its place in the code to be understood.
        _LOG.warning("%s failed: %s", job.label, error, exc_info=None if own else error)
        return RunFailure(job.label, str(error) if own else f"{type(error).__name__}: {error}")
