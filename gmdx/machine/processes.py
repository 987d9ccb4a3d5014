"""Tasks in processes of their own: a crash costs one task, and nothing outlives the caller."""

import contextlib
import ctypes
import logging
import logging.handlers
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import connection, resource_tracker
from typing import Any, Generic, TypeVar

from gmdx.errors import GmdxError

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
_CONTEXT = multiprocessing.get_context("spawn")  # a fork would copy the caller's threads' locks


@dataclass(frozen=True)
class Crash:
    """A worker process ended without a result."""

    exit_code: int  # negative: the signal that ended it

    def __str__(self) -> str:
        if self.exit_code >= 0:
            return f"the worker process exited with code {self.exit_code}"
        name = signal.Signals(-self.exit_code).name
        hint = "; the machine may be short of memory" if name == "SIGKILL" else ""
        return f"the worker process was ended by {name}{hint}"


@dataclass(frozen=True)
class Finished(Generic[TaskT, ResultT]):
    """A task and what came of it."""

    task: TaskT
    result: ResultT | Crash


class WorkerError(GmdxError):
    """Worker processes cannot be started."""


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def return_freed_memory() -> None:
    """Hand memory that was freed back to the system.

    The GNU allocator keeps it in pieces between what lives on, and grows with every batch of
    large arrays; other allocators have no such call, nor the need for it.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


class Later:
    """In a stream of tasks: there is none now, but there will be; ask again."""


LATER = Later()
_ASK_AGAIN = 0.02  # s


def run_tasks(
    function: Callable[[TaskT], ResultT], tasks: Iterable[TaskT], *, workers: int
) -> Generator[Finished[TaskT, ResultT], None, None]:
    """Run `function` on every task and yield the results as they come.

    Args:
        function: Importable by name, as processes are spawned. An exception that it raises is
            raised here and ends the run.
        tasks: Drawn one at a time, as workers become free and after the results before were
            taken; `LATER` where the next task is not known yet.
        workers: Number of processes; 1 runs the tasks in this process, where a crash is a crash.

    Raises:
        WorkerError: A worker process could not start.
    """
    if workers == 1:
        for task in tasks:
            if isinstance(task, Later):
                time.sleep(_ASK_AGAIN)
            else:
                yield Finished(task, function(task))
        return
    queue = iter(tasks)
    busy: list[_Worker[TaskT, ResultT]] = []
    idle: list[_Worker[TaskT, ResultT]] = []
    try:
        while True:
            later = False
            while len(busy) < workers and not later:
                drawn = next(queue, _NOTHING)
                if isinstance(drawn, _Nothing):
                    break
                if isinstance(drawn, Later):
                    later = True
                elif idle:
                    busy.append(idle.pop())
                    busy[-1].give(drawn)
                else:
                    busy.append(_Worker(function, drawn))
            if not busy and not later:
                return
            waiting = {handle: worker for worker in busy for handle in worker.handles}
            found = connection.wait(list(waiting), timeout=_ASK_AGAIN if later else None)
            for worker in {id(w): w for w in map(waiting.__getitem__, found)}.values():
                done, result = worker.task, worker.receive()
                if isinstance(result, _Nothing):
                    continue
                busy.remove(worker)
                if isinstance(result, Crash):
                    worker.end()
                else:
                    idle.append(worker)
                yield Finished(done, result)
    finally:
        for worker in [*busy, *idle]:
            worker.end()


class _Nothing:
    """No value: None may be a task or a result."""


_NOTHING = _Nothing()


class _Worker(Generic[TaskT, ResultT]):
    """The caller's end of one worker process, and the task that it has."""

    def __init__(self, function: Callable[[TaskT], ResultT], task: TaskT) -> None:
        self.task = task
        self._started = False
        self._pipe, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(function, theirs), daemon=False)
        with _one_thread_each(), _interrupts_held_back():
            self._process.start()
        theirs.close()
        with contextlib.suppress(BrokenPipeError):  # a death is seen in `receive`
            self._pipe.send(task)

    @property
    def handles(self) -> tuple[Any, Any]:
        """What to wait on: a message, or the end of the process."""
        return self._pipe, self._process.sentinel

    def give(self, task: TaskT) -> None:
        """Send the next task to a worker that has finished one."""
        self.task = task
        with contextlib.suppress(BrokenPipeError):
            self._pipe.send(task)

    def receive(self) -> ResultT | Crash | _Nothing:
        """A result, a crash, or nothing yet (the worker has started, or logged something)."""
        try:
            message = self._pipe.recv() if self._pipe.poll() else None
        except (EOFError, ConnectionResetError):
            message = None
        if message is None:
            self._process.join()
            if not self._started:
                raise WorkerError(
                    "a worker process did not start; a script that calls this with several "
                    "workers needs `if __name__ == '__main__':` around its main part"
                )
            return Crash(int(self._process.exitcode or 0))
        kind, value = message
        if kind == "log":
            logging.getLogger(value.name).handle(value)
            return _NOTHING
        if kind == "error":
            raise value
        if kind == "started":
            self._started = True
            return _NOTHING
        result: ResultT = value
        return result

    def end(self) -> None:
        """Stop the process and whatever it has started."""
        if self._started:  # it leads a process group of its own from then on
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid or 0, signal.SIGKILL)
        self._process.kill()
        self._process.join()
        self._pipe.close()
        self._process.close()


class _ToCaller(logging.handlers.QueueHandler):
    """Hands log records to the caller, which decides how they are shown."""

    def __init__(self, pipe: Any) -> None:
        super().__init__(pipe)
        self._pipe = pipe

    def enqueue(self, record: logging.LogRecord) -> None:
        """Send a record, whose arguments are text by now."""
        self._pipe.send(("log", record))


def _serve(function: Callable[[TaskT], ResultT], pipe: Any) -> None:
    """Life of a worker process: a task in, a result out, until the caller is gone."""
    os.setpgid(0, 0)  # so that one signal ends it together with its own children
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller decides
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_caller, daemon=True).start()
    logging.getLogger().addHandler(_ToCaller(pipe))
    try:
        pipe.send(("started", None))
    except BrokenPipeError:  # the caller was interrupted meanwhile
        return
    while True:
        try:
            task = pipe.recv()
        except EOFError:
            return
        message: tuple[str, Any]
        try:
            message = ("result", function(task))
        except Exception as error:
            message = ("error", error)
        pipe.send(message)


def _end_with_caller() -> None:
    """Wait for the caller's end, however sudden, and go with it."""
    caller = multiprocessing.parent_process()
    if caller is not None:
        connection.wait([caller.sentinel])
    os.killpg(0, signal.SIGKILL)


@contextlib.contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Processes started inside are deaf to Ctrl-C at once; the caller hears it afterwards.

    A terminal sends it to all of them, and one that is still importing would answer with a
    traceback.
    """
    resource_tracker.ensure_running()  # it would let them through again at its start
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started inside compute with one thread, so that they do not fight for cores."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
