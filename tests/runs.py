"""Real runs of the whole pipeline on a few simple meshes, in this process or in one of its own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import trimesh

from gmdx.dataset import schema
from gmdx.pipeline.generate import GenerateConfig

FILES = {
    "object.json", "mesh.ply", "hulls.npz", "scenes.npz", "grasps.parquet", "contacts.parquet",
    "cost.json",
}  # fmt: skip
FLAGS = ("--grasps", "6", "--scenes", "2", "--trials", "2", "--seed", "5")


def small_config(cache: Path | None, **options: object) -> GenerateConfig:
    """What FLAGS say, as a configuration."""
    values = {"grasps": 6, "scenes": 2, "trials": 2, "seed": 5, "cache": cache} | options
    return GenerateConfig(**values)  # type: ignore[arg-type]


def write_meshes(folder: Path, count: int = 3) -> list[Path]:
    """Simple closed meshes, each quick to prepare."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for k in range(count):
        mesh = trimesh.creation.box((0.03, 0.035 + 0.004 * k, 0.05))
        path = folder / f"box{k}.stl"
        mesh.export(path)
        paths.append(path)
    return paths


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a dataset but the timings, as bytes."""
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in root.rglob("*")
        if path.is_file() and path.name != schema.COST_FILE
    }


def assert_whole(root: Path) -> None:
    """Whatever is under objects/ is complete."""
    for folder in (root / schema.OBJECTS_FOLDER).iterdir():
        assert {path.name for path in folder.iterdir()} == FILES


@contextmanager
def interrupts_heard() -> Iterator[None]:
    """What is started inside takes SIGINT, as from a terminal.

    Jobs that a script puts into the background inherit that it is ignored; a handler of this
    process is reset to the default in what it starts. (Python code between fork and exec could
    do it as well, but where JAX has started threads, forks of that kind may hang.)
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class Command:
    """`gmdx` in a process and a session of its own."""

    def __init__(self, *words: str | Path, cache: Path, setup: str = "") -> None:
        command = [sys.executable, "-m", "gmdx", *map(str, words)]
        if setup:
            command = ["bash", "-c", f'{setup}; exec "$@"', "bash", *command]
        with interrupts_heard():
            self.process = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
                env={**os.environ, "GMDX_CACHE": str(cache)},
            )

    def finish(self, timeout: float = 120.0) -> "Command":
        self.out, self.err = self.process.communicate(timeout=timeout)
        self.code = self.process.returncode
        return self

    def members(self) -> list[int]:
        """Living processes of its session; zombies left out."""
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rpartition(")")[2].split()
            except OSError:  # it ended while we looked
                continue
            if fields[0] != "Z" and int(fields[3]) == self.process.pid:
                found.append(int(stat.parent.name))
        return found

    def wait_for(self, pattern: str, root: Path, timeout: float = 120.0) -> None:
        """Until a path below `root` matches, or the command has ended."""
        end = time.monotonic() + timeout
        while not list(root.glob(pattern)) and self.process.poll() is None:
            assert time.monotonic() < end
            time.sleep(0.02)

    def assert_no_orphans(self) -> None:
        end = time.monotonic() + 10
        while self.members():
            assert time.monotonic() < end, "processes outlive the command"
            time.sleep(0.05)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.communicate()


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
