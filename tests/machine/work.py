"""Work for workers: short, failing, crashing, endless. Little is imported, so they start fast."""

import logging
import os
import signal
import time
from pathlib import Path

from gmdx.errors import DatasetError
from gmdx.machine.cores import THREAD_VARIABLES


def double(x: int) -> int:
    return 2 * x


def die(x: int) -> int:
    """Odd tasks end their process, each in another way."""
    if x == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if x == 3:
        os._exit(7)
    if x == 5:
        os.kill(os.getpid(), signal.SIGSEGV)
    return 2 * x


def refuse(x: int) -> int:
    raise DatasetError(f"task {x} is refused")


def threads(_: int) -> list[str | None]:
    return [os.environ.get(name) for name in THREAD_VARIABLES]


def die_once(marker: Path) -> str:
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def send_much(note: Path | None) -> bytes:
    """A result that no pipe holds, after a note of who sends it."""
    if note is None:
        return b""
    result = bytes(50_000_000)
    note.write_text(f"{os.getpid()}.")
    return result


def unsendable(x: int) -> object:
    if x:
        raise ValueError("bad", lambda: None)
    return lambda: None


def own_pid(_: int) -> int:
    return os.getpid()


def sleep_long(_: int) -> int:
    time.sleep(600)
    return 0


def warn(x: int) -> int:
    logging.getLogger("gmdx").warning("task %d is odd, %s", x, Path("here"))
    return x


def sleep_or_double(x: int) -> int:
    return sleep_long(x) if x else double(x)
