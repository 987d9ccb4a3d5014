"""The executors by name, and tasks run on one of them."""

import contextlib
from collections.abc import Callable, Generator, Iterable
from itertools import islice
from typing import TypeVar

from gmdx.errors import UsageError
from gmdx.machine.executor import Executor, Finished, Inbox, SerialExecutor
from gmdx.machine.processes import ProcessExecutor

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

# What opens an executor with a number of workers.
EXECUTORS: dict[str, Callable[[Inbox, int], Executor]] = {
    "serial": lambda inbox, _: SerialExecutor(inbox),
    "processes": lambda inbox, workers: ProcessExecutor(inbox, workers=workers),
}


def open_executor(inbox: Inbox, *, workers: int, name: str | None = None) -> Executor:
    """An executor, to be closed.

    Args:
        inbox: Where its results go.
        workers: How many tasks run side by side.
        name: One of `EXECUTORS`; None: this process for one worker, else processes.

    Raises:
        UsageError: The name is not known.
    """
    if name is None:
        name = "serial" if workers == 1 else "processes"
    if name not in EXECUTORS:
        raise UsageError(f"unknown executor {name!r}; give one of {', '.join(EXECUTORS)}")
    return EXECUTORS[name](inbox, workers)


def run_tasks(
    function: Callable[[TaskT], ResultT],
    tasks: Iterable[TaskT],
    *,
    workers: int,
    executor: str | None = None,
) -> Generator[Finished[TaskT, ResultT], None, None]:
    """Run `function` on every task and yield the results as they come.

    Args:
        function: Importable by name, as processes are spawned. An exception that it raises is
            raised here and ends the run.
        tasks: Drawn one at a time, as workers become free and after the results before were
            taken.
        workers: How many tasks run side by side.
        executor: One of `EXECUTORS`; None: this process for one worker, where a crash is a crash,
            else processes.

    Raises:
        WorkerError: A worker process could not start.
    """
    inbox, queue, under_way = Inbox(), iter(tasks), 0
    with contextlib.closing(open_executor(inbox, workers=workers, name=executor)) as running:
        while True:
            for task in islice(queue, max(running.places - under_way, 0)):
                running.give(function, task)
                under_way += 1
            if under_way == 0:
                return
            finished = inbox.take()
            under_way -= 1
            yield finished
