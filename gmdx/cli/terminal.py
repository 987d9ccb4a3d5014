"""What commands show: tables, a progress bar on a terminal, plain lines elsewhere."""

import contextlib
import logging
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import Console
from rich.logging import RichHandler
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar

if TYPE_CHECKING:
    from gmdx.machine.progress import OnProgress, Progress

_logger = logging.getLogger("gmdx")


class _Screen(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to the command that the reader has seen enough: rich would exit with 1."""
        raise BrokenPipeError


def console() -> Console:
    """Standard output; wide enough for every table where it is not a terminal."""
    if sys.stdout.isatty():
        return _Screen()
    return _Screen(width=max(shutil.get_terminal_size().columns, 160))


def say(text: str) -> None:
    """A line of output."""
    sys.stdout.write(f"{text}\n")


def complain(text: str) -> None:
    """A line about what went wrong."""
    sys.stderr.write(f"{text}\n")


@contextlib.contextmanager
def interrupts_kept() -> Iterator[None]:
    """Raise a Ctrl-C at the end of what is inside: imports, some of which would swallow it.

    Nothing is raised where interrupts are ignored, as for a job in a script's background.
    """
    ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    if ignored or threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt


@contextlib.contextmanager
def following(noun: str, *, things: str = "objects") -> Iterator["OnProgress"]:
    """A function that shows how a run goes on, object by object.

    Args:
        noun: What objects are given, for the rate: "grasps".
        things: What is counted as done.
    """
    if sys.stderr.isatty():
        with _bar(noun, things) as show:
            yield show
    else:
        with _lines(noun, things) as show:
            yield show


@contextlib.contextmanager
def _bar(noun: str, things: str) -> Iterator["OnProgress"]:
    """A progress bar on standard error, with rate and remaining time."""
    screen = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(f"{things}, {{task.fields[rate]}}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
    )
    start = time.perf_counter()
    handler = RichHandler(console=screen, show_path=False, show_time=False)
    with _logging_to(handler), Bar(*columns, console=screen, transient=True) as bar:
        task = bar.add_task("working", total=None, rate=f"0.0 {noun}/s")

        def show(progress: "Progress") -> None:
            rate = progress.count / (time.perf_counter() - start)
            bar.update(
                task, total=progress.total, completed=progress.done, rate=f"{rate:.1f} {noun}/s"
            )
            for failure in progress.failures:
                _logger.warning("%s", failure)

        yield show


@contextlib.contextmanager
def _lines(noun: str, things: str) -> Iterator["OnProgress"]:
    """A line per object on standard error."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%H:%M:%S"))
    start = time.perf_counter()

    def show(progress: "Progress") -> None:
        for failure in progress.failures:
            _logger.warning("%s", failure)
        if progress.done == 0:
            _logger.info("%d %s to do", progress.total, things)
            return
        seconds = time.perf_counter() - start
        left = seconds / progress.done * (progress.total - progress.done)
        _logger.info(
            "[%d/%d] %s; %.1f %s/s, %.0f s left",
            progress.done,
            progress.total,
            progress.name,
            progress.count / seconds,
            noun,
            left,
        )

    with _logging_to(handler):
        yield show


@contextlib.contextmanager
def _logging_to(handler: logging.Handler) -> Iterator[None]:
    """Send the library's messages to `handler` while a command runs."""
    before = _logger.level
    _logger.addHandler(handler)
    _logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        _logger.removeHandler(handler)
        _logger.setLevel(before)
