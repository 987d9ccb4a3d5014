"""Runs in processes of their own that die by SIGKILL in the middle of a call about their folder.

The processes are forks of one server that has imported everything, so that each costs little. The
calls are watched from outside the library: it knows nothing of it.
"""

import builtins
import io
import json
import multiprocessing
import os
import re
import signal
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(
    [
        "gmdx.pipeline.generate",
        "gmdx.studies.bias.report",
        "gmdx.studies.bias.study",
        "gmdx.studies.sensitivity.study",
    ]
)


@dataclass(frozen=True)
class Call:
    """A call that a run makes about a file or folder of its output."""

    kind: str  # write, fsync or rename
    name: str  # of the file or folder, without the number of its attempt
    number: int = 0  # of the write since the file was opened


@dataclass(frozen=True)
class Death:
    """Where a run is to die: the first time that it makes a call."""

    at: Call
    done: bool  # the call is done by then, and half of what it writes else


def start(run: Callable[[Path], object], out: Path, death: Death | None = None) -> Any:
    """A process that runs `run(out)`, importable by name."""
    process = _SERVER.Process(target=_live, args=(run, out, death, None))
    process.start()
    return process


def calls_of(run: Callable[[Path], object], out: Path, log: Path) -> list[Call]:
    """The different calls of a whole run, in the order in which each came first."""
    process = _SERVER.Process(target=_live, args=(run, out, None, log))
    process.start()
    process.join()
    assert process.exitcode == 0
    calls = (Call(**values) for values in json.loads(log.read_text()))
    return list(dict.fromkeys(calls))


def _live(run: Callable[[Path], object], out: Path, death: Death | None, log: Path | None) -> None:
    watch = _Watch(out, death)
    watch.begin()
    run(out)
    if log is not None:
        log.write_text(json.dumps([asdict(call) for call in watch.calls]))


class _Watch:
    """Stands between a run and the system, for what concerns one folder."""

    def __init__(self, root: Path, death: Death | None) -> None:
        self.calls: list[Call] = []
        self._root, self._death = root, death
        self._open, self._fsync = io.open, os.fsync
        self._renames = {"rename": os.rename, "replace": os.replace}

    def begin(self) -> None:
        io.open = builtins.open = self._opened  # type: ignore[assignment]
        os.fsync = self._fsynced
        os.rename, os.replace = self._renamed("rename"), self._renamed("replace")

    def _name(self, path: object) -> str | None:
        if isinstance(path, int) or not Path(str(path)).is_relative_to(self._root):
            return None
        return re.sub(r"^(\d+-|run-.*)", "", Path(str(path)).name)

    def _made(self, call: Call, whole: Callable[[], Any], half: Callable[[], Any]) -> Any:
        """Make a call, or die of it."""
        self.calls.append(call)
        if self._death is None or call != self._death.at:
            return whole()
        (whole if self._death.done else half)()
        return os.kill(os.getpid(), signal.SIGKILL)

    def _opened(self, file: Any, mode: str = "r", *args: Any, **options: Any) -> Any:
        opened = self._open(file, mode, *args, **options)
        name = self._name(file)
        if name is None or not set(mode) & set("wax+"):
            return opened
        write, count = opened.write, 0

        def written(data: Any) -> Any:
            nonlocal count
            count += 1
            part = data if isinstance(data, str) else memoryview(data).cast("B")

            def flushed(what: Any) -> None:
                write(what)
                opened.flush()

            return self._made(
                Call("write", name, count),
                lambda: write(data),
                lambda: flushed(part[: len(part) // 2]),
            )

        opened.write = written
        return opened

    def _fsynced(self, descriptor: int) -> None:
        name = self._name(Path(f"/proc/self/fd/{descriptor}").readlink())
        if name is None:
            return self._fsync(descriptor)
        return self._made(Call("fsync", name), lambda: self._fsync(descriptor), lambda: None)

    def _renamed(self, kind: str) -> Any:
        def renamed(source: Any, target: Any, **options: Any) -> Any:
            name = self._name(target)
            if name is None:
                return self._renames[kind](source, target, **options)
            return self._made(
                Call("rename", name),
                lambda: self._renames[kind](source, target, **options),
                lambda: None,
            )

        return renamed
