"""Executors run tasks: what they offer, and the inbox where the results of all of them arrive.

Whoever has work opens an inbox, gives tasks to executors that share it, and takes what finishes:

    inbox = Inbox()
    executor = open_executor(inbox, workers=4)
    attempt = executor.give(function, task)
    finished = inbox.take()  # waits, for this attempt or for another
    executor.close()
"""

import itertools
import signal
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import Pipe, connection
from queue import SimpleQueue
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

_PATIENCE = 30.0  # s, for a thread to end at its next look


@dataclass(frozen=True)
class Crash:
    """An attempt ended without a result, as what ran it died."""

    why: str  # in words
    exit_code: int | None = None  # of its process, if known; negative: the signal that ended it

    def __str__(self) -> str:
        return self.why


@dataclass(frozen=True)
class Finished(Generic[TaskT, ResultT]):
    """A task that was given, and what came of it."""

    task: TaskT
    attempt: int  # the number that `give` returned
    result: ResultT | Crash


@runtime_checkable
class Executor(Protocol):
    """Runs functions on tasks somewhere, and puts what comes of each attempt into an inbox."""

    @property
    def places(self) -> int:
        """How many attempts it takes on at once, at least 1; nobody gives it more.

        It may change while a run goes on.
        """
        ...

    def give(self, function: Callable[[TaskT], ResultT], task: TaskT) -> int:
        """Start an attempt at a task.

        Its end is put into the inbox: the result, or the crash of what ran it. An exception that
        the function raises, this or `Inbox.take` raises.

        Args:
            function: Importable by name, as it may be called in another process.
            task: Its argument.

        Returns:
            The attempt's number, which no other of the inbox has.
        """
        ...

    def close(self) -> None:
        """End what is under way, without results, and everything that was started for it."""
        ...


class Inbox:
    """Where executors put what has finished: the one place at which a caller waits."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._items: deque[Finished[Any, Any] | BaseException] = deque()
        self._bell, self._rope = Pipe(duplex=False)  # rung once for each item
        self._watched: dict[Any, Callable[[], object]] = {self._bell: self._bell.recv_bytes}

    def number(self) -> int:
        """A number for the next attempt: 1, 2, ..."""
        return next(self._numbers)

    def put(self, item: Finished[Any, Any] | BaseException) -> None:
        """Leave something to be taken, or to be raised there; any thread may."""
        self._items.append(item)
        self._rope.send_bytes(b"")

    def watch(self, handle: Any, on_ready: Callable[[], object]) -> None:
        """Call a function within `take` whenever there is something to read from a handle."""
        self._watched[handle] = on_ready

    def unwatch(self, handle: Any) -> None:
        """Forget a handle."""
        del self._watched[handle]

    def take(self) -> Finished[Any, Any]:
        """Wait for the next attempt to finish.

        Raises:
            Exception: What a task's function raised.
        """
        while True:
            for handle in connection.wait(list(self._watched)):
                self._watched[handle]()
                if handle is self._bell:
                    item = self._items.popleft()
                    if isinstance(item, BaseException):
                        raise item
                    return item


class SerialExecutor:
    """This very thread, where a crash is a crash."""

    places = 1

    def __init__(self, inbox: Inbox) -> None:
        self._inbox = inbox

    def give(self, function: Callable[[TaskT], ResultT], task: TaskT) -> int:
        """Run the task now."""
        attempt = self._inbox.number()
        self._inbox.put(Finished(task, attempt, function(task)))
        return attempt

    def close(self) -> None:
        """Nothing is under way between calls."""


class ThreadExecutor:
    """One thread of this process, for work that mostly waits for a device."""

    places = 1

    def __init__(self, inbox: Inbox, *, name: str, cancel: Callable[[], None]) -> None:
        """Start the thread.

        Args:
            inbox: Where results go.
            name: Of the thread.
            cancel: Makes a function that is running raise soon.
        """
        self._inbox, self._cancel = inbox, cancel
        self._given: SimpleQueue[tuple[int, Callable[[Any], Any], Any] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)
        self._thread.start()

    def give(self, function: Callable[[TaskT], ResultT], task: TaskT) -> int:
        """Queue the task."""
        attempt = self._inbox.number()
        self._given.put((attempt, function, task))
        return attempt

    def close(self) -> None:
        """End the thread: at once where it has nothing to do, else when it notices."""
        self._cancel()
        self._given.put(None)
        self._thread.join(timeout=_PATIENCE)

    def _serve(self) -> None:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # it is for the caller's thread
        while (given := self._given.get()) is not None:
            attempt, function, task = given
            try:
                self._inbox.put(Finished(task, attempt, function(task)))
            except BaseException as error:  # for the caller
                self._inbox.put(error)
            del given, task  # a device's memory may hang on it
