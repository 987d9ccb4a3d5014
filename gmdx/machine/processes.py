"""Tasks in processes of their own: a crash costs one attempt, and nothing outlives the caller."""

import contextlib
import functools
import logging
import logging.handlers
import multiprocessing
import os
import pickle
import signal
import threading
import weakref
from collections.abc import Callable, Iterator
from multiprocessing import connection, resource_tracker
from typing import Any, TypeVar

from gmdx.errors import GmdxError
from gmdx.machine.cores import one_thread_each
from gmdx.machine.executor import Crash, Finished, Inbox

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

_CONTEXT = multiprocessing.get_context("spawn")  # a fork would copy the caller's threads' locks


class WorkerError(GmdxError):
    """A worker process cannot be started, or cannot hand over what it has."""


class ProcessExecutor:
    """Worker processes, started as they are needed and kept."""

    def __init__(self, inbox: Inbox, *, workers: int) -> None:
        self.places = workers
        self._inbox = inbox
        self._workers: set[_Worker] = set()
        self._idle: list[_Worker] = []
        # Python waits for its processes before it ends: those of an executor left open go first.
        weakref.finalize(self, _end_all, self._workers)

    def give(self, function: Callable[[TaskT], ResultT], task: TaskT) -> int:
        """Send the task to a worker that is free, or to a new one."""
        attempt = self._inbox.number()
        worker = self._idle.pop() if self._idle else self._start()
        worker.give(function, task, attempt)
        return attempt

    def close(self) -> None:
        """Kill all workers, and what they have started."""
        self._idle.clear()
        while self._workers:
            self._end(next(iter(self._workers)))

    def _start(self) -> "_Worker":
        with one_thread_each(), _interrupts_held_back():
            worker = _Worker()
            self._workers.add(worker)
            self._inbox.watch(worker.pipe, functools.partial(self._listen, worker))
        return worker

    def _end(self, worker: "_Worker") -> int:
        """Kill a worker; the exit code that it had, if it was dead already."""
        self._inbox.unwatch(worker.pipe)
        code = worker.end()
        self._workers.discard(worker)
        return code

    def _listen(self, worker: "_Worker") -> None:
        """Take a worker's message, or note its end."""
        kind, value = worker.receive()
        if kind == "log":
            logging.getLogger(value.name).handle(value)
        elif kind == "error":
            self._idle.append(worker)
            raise value
        elif kind == "result":
            self._idle.append(worker)
            self._inbox.put(Finished(worker.task, worker.attempt, value))
        elif kind == "end":
            code = self._end(worker)
            if not worker.started:
                raise WorkerError(
                    "a worker process did not start; a script that calls this with several "
                    "workers needs `if __name__ == '__main__':` around its main part"
                )
            if worker in self._idle:
                self._idle.remove(worker)  # nobody has lost anything
            else:
                self._inbox.put(Finished(worker.task, worker.attempt, _crash(code)))


def _end_all(workers: "set[_Worker]") -> None:
    while workers:
        workers.pop().end()


def _crash(exit_code: int) -> Crash:
    """The end of a worker in words."""
    if exit_code >= 0:
        return Crash(f"the worker process exited with code {exit_code}", exit_code)
    name = signal.Signals(-exit_code).name
    hint = "; the machine may be short of memory" if name == "SIGKILL" else ""
    return Crash(f"the worker process was ended by {name}{hint}", exit_code)


class _Worker:
    """The caller's end of one worker process, and the attempt that it is at."""

    def __init__(self) -> None:
        self.task: Any = None
        self.attempt = 0
        self.started = False
        self.pipe, theirs = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(theirs,), daemon=False)
        self._process.start()
        theirs.close()

    def give(self, function: Callable[[TaskT], ResultT], task: TaskT, attempt: int) -> None:
        """Send a task."""
        self.task, self.attempt = task, attempt
        message = pickle.dumps((function, task))
        with contextlib.suppress(BrokenPipeError):  # a death is seen in `receive`
            self.pipe.send_bytes(message)

    def receive(self) -> tuple[str, Any]:
        """Kind and content of the next message."""
        try:
            message = self.pipe.recv_bytes()
        except (EOFError, OSError):  # OSError: it died within a message
            return "end", None
        kind, value = pickle.loads(message)
        self.started = True
        return kind, value

    def end(self) -> int:
        """Stop the process and whatever it has started; its exit code."""
        if self.started:  # it leads a process group of its own from then on
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid or 0, signal.SIGKILL)
        self._process.kill()  # without effect on one that is ending in its own way
        self._process.join()
        code = self._process.exitcode
        self.pipe.close()
        self._process.close()
        return 0 if code is None else code


def _serve(pipe: Any) -> None:
    """Life of a worker process: a task in, a result out, until the caller is gone."""
    os.setpgid(0, 0)  # so that one signal ends it together with its own children
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the caller decides
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_caller, daemon=True).start()
    caller = _Caller(pipe)
    logging.getLogger().addHandler(caller)
    with contextlib.suppress(EOFError, BrokenPipeError):  # the caller is gone
        caller.send(pickle.dumps(("started", None)))
        while True:
            caller.send(_answer(pipe.recv_bytes()))


def _answer(message: bytes) -> bytes:
    """What came of a task."""
    try:
        function, task = pickle.loads(message)
        return pickle.dumps(("result", function(task)))
    except Exception as error:
        try:
            return pickle.dumps(("error", error))
        except Exception as why:
            text = f"{type(error).__name__}: {error} (which cannot be handed over: {why})"
            return pickle.dumps(("error", WorkerError(text)))


class _Caller(logging.handlers.QueueHandler):
    """A worker's line to the caller, who gets its log records too, and shows them as it likes."""

    def __init__(self, pipe: Any) -> None:
        super().__init__(pipe)
        self._pipe = pipe

    def send(self, message: bytes) -> None:
        """Send a message, while no other thread sends a record."""
        self.acquire()
        try:
            self._pipe.send_bytes(message)
        finally:
            self.release()

    def enqueue(self, record: logging.LogRecord) -> None:
        """Send a record, whose arguments are text by now."""
        self.send(pickle.dumps(("log", record)))


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
