"""The engines by name: a row of the table says all that the rest of gmdx knows of one."""

import contextlib
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gmdx.errors import ConfigError, UsageError
from gmdx.machine.devices import cuda_devices, installed
from gmdx.trials.engines.engine import Engine

AUTO, DEFAULT_ENGINE = "auto", "mujoco"

_LOG = logging.getLogger("gmdx")


@dataclass(frozen=True)
class EngineOptions:
    """What may be said of how an engine runs; no result depends on it."""

    threads: int = 1  # of those that compute on the CPU
    parallel_trials: int | None = None  # side by side on a device; None: what its memory allows


@dataclass(frozen=True)
class EngineEntry:
    """An engine that can be named."""

    open: Callable[[EngineOptions], Engine]
    parallel: bool = False  # the trials of many objects run side by side on a device
    packages: tuple[str, ...] = ()  # that it rests on, besides MuJoCo
    needs: Mapping[str, str] = field(default_factory=dict)  # package to install, by module
    install: str = ""  # what to say of installing it


def choose(name: str) -> str:
    """The engine that a name, or `auto`, stands for on this machine.

    `auto` is Warp where there is an NVIDIA device and Warp is installed, and MuJoCo elsewhere.

    Raises:
        ConfigError: The name is not known.
    """
    if name not in (AUTO, *ENGINES):
        raise ConfigError(f"unknown engine {name!r}; give one of {', '.join((AUTO, *ENGINES))}")
    if name != AUTO:
        return name
    return "warp" if cuda_devices() > 0 and installed("mujoco.mjx") else DEFAULT_ENGINE


def open_engine(name: str, *, threads: int = 1, parallel_trials: int | None = None) -> Engine:
    """An engine by its name.

    Args:
        name: One of `ENGINES`, or `auto`; see `choose`.
        threads: Of MuJoCo on the CPU.
        parallel_trials: Trials side by side on a device; its memory decides if not given.

    Raises:
        UsageError: The name is not known, or what the engine needs is not installed.
    """
    chosen = choose(name)
    if name == AUTO:
        _LOG.info("engine auto: %s runs the trials", chosen)
    entry = ENGINES[chosen]
    try:
        return entry.open(EngineOptions(threads, parallel_trials))
    except ModuleNotFoundError as error:
        missing = str(error.name).split(".")[0]
        if missing not in entry.needs:
            raise
        raise UsageError(
            f"engine {chosen!r} needs {entry.needs[missing]}: {entry.install}"
        ) from error


def _mujoco(options: EngineOptions) -> Engine:
    from gmdx.trials.engines.mujoco import MujocoEngine

    return MujocoEngine(threads=options.threads)


def _warp(options: EngineOptions) -> Engine:
    from gmdx.trials.engines import warp
    from gmdx.trials.engines.parallel import ParallelEngine

    return ParallelEngine("warp", warp, parallel_trials=options.parallel_trials)


def _bullet(_: EngineOptions) -> Engine:
    with _without_banner():
        from gmdx.trials.engines.bullet import BulletEngine

    return BulletEngine()


@contextlib.contextmanager
def _without_banner() -> Iterator[None]:
    """PyBullet's C code announces its build time on standard error where it is imported."""
    sys.stderr.flush()
    saved = os.dup(2)
    try:
        with Path(os.devnull).open("w") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


ENGINES: Mapping[str, EngineEntry] = {
    "mujoco": EngineEntry(_mujoco),
    "warp": EngineEntry(
        _warp,
        parallel=True,
        packages=("mujoco-mjx", "warp-lang"),
        needs={"warp": "warp-lang", "mujoco": "mujoco-mjx"},
        install="pip install 'gmdx[warp]'",
    ),
    "bullet": EngineEntry(
        _bullet,
        packages=("pybullet",),
        needs={"pybullet": "pybullet"},
        install="pip install 'gmdx[bullet]' (pybullet 3.2.7 has wheels for Python up to 3.11, "
        "later ones have to compile it)",
    ),
}
