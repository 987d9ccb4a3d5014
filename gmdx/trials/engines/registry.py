"""The engines by name."""

import contextlib
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from gmdx.errors import ConfigError, UsageError
from gmdx.machine.devices import has_accelerator, warp_fits
from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import TrialConfig

_LOG = logging.getLogger("gmdx")


@runtime_checkable
class Backend(Protocol):
    """An engine that runs the schedule of `protocol` on batches of trials."""

    @property
    def version(self) -> str:
        """The engine's name and version, as datasets record it."""
        ...

    def run(self, batches: Sequence[TrialBatch], *, config: TrialConfig) -> list[RawTrials]:
        """Run every trial to its named end; a batch's results do not depend on the others."""
        ...


@dataclass(frozen=True)
class Chosen:
    """A backend by name, with nothing left open."""

    backend: str  # of `BACKENDS`
    impl: str | None = None  # of `IMPLEMENTATIONS`, where the backend has more than one

    def __str__(self) -> str:
        return self.backend if self.impl is None else f"{self.backend}-{self.impl}"


BACKENDS = ("mujoco", "mjx", "bullet")


IMPLEMENTATIONS = ("warp", "jax")  # of mjx


def choose(backend: str, impl: str = "auto") -> Chosen:
    """What a backend's name, or `auto`, stands for on this machine.

    `auto` is MJX where there is an accelerator, and MuJoCo on the CPU otherwise; of MJX's
    implementations it is Warp on NVIDIA's devices, JAX on other accelerators, and on a plain CPU
    Warp where it is installed. `mjx-warp` and `mjx-jax` name both at once.

    Raises:
        ConfigError: A name is not known.
    """
    known = ("auto", *BACKENDS, *(f"mjx-{name}" for name in IMPLEMENTATIONS))
    if backend not in known:
        raise ConfigError(f"unknown backend {backend!r}; give one of {', '.join(known)}")
    if impl not in ("auto", *IMPLEMENTATIONS):
        names = ", ".join(("auto", *IMPLEMENTATIONS))
        raise ConfigError(f"unknown implementation {impl!r} of backend 'mjx'; give one of {names}")
    family, _, part = backend.partition("-")
    if impl != "auto" and (family in ("mujoco", "bullet") or (part and part != impl)):
        raise ConfigError(f"implementation {impl!r} is of backend 'mjx', not of {backend!r}")
    if part:
        backend, impl = family, part
    if backend not in ("auto", "mjx") or (backend == "auto" and not has_accelerator()):
        return Chosen("mujoco" if backend == "auto" else backend)
    if impl == "auto":
        impl = "warp" if warp_fits() else "jax"
    return Chosen("mjx", impl)


def engine_packages(chosen: Chosen) -> tuple[str, ...]:
    """Packages that an engine rests on, besides C MuJoCo."""
    packages = {
        "bullet": ("pybullet",),
        "mjx-warp": ("mujoco-mjx", "warp-lang"),
        "mjx-jax": ("jax", "jaxlib"),
    }
    return packages.get(str(chosen), ())


def _mujoco(threads: int) -> Backend:
    from gmdx.trials.engines.mujoco import MujocoBackend

    return MujocoBackend(threads=threads)


def _bullet() -> Backend:
    try:
        with _without_banner():
            from gmdx.trials.engines.bullet.engine import BulletBackend
    except ModuleNotFoundError as error:
        if error.name != "pybullet":
            raise
        raise UsageError(
            "backend 'bullet' needs pybullet: pip install 'gmdx[bullet]' (pybullet 3.2.7 has "
            "wheels for Python up to 3.11, later ones have to compile it)"
        ) from error
    return BulletBackend()


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


def open_backend(
    name: str, *, impl: str = "auto", threads: int = 1, batch_size: int | None = None
) -> Backend:
    """An engine by its name.

    Args:
        name: One of `BACKENDS`, or `auto`; see `choose`.
        impl: Of MJX: one of `IMPLEMENTATIONS`, or `auto`.
        threads: Of MuJoCo on the CPU.
        batch_size: Trials that MJX runs side by side; the device's memory decides if not given.

    Raises:
        UsageError: A name is not known, or what the backend needs is not installed.
    """
    chosen = choose(name, impl)
    if name == "auto" or (chosen.impl is not None and impl == "auto" and name == "mjx"):
        _LOG.info("backend %s: %s runs the trials", name, chosen)
    if chosen.backend == "bullet":
        return _bullet()
    if chosen.impl is not None:
        from gmdx.trials.engines.parallel import MjxBackend

        return MjxBackend(chosen.impl, batch_size=batch_size)
    return _mujoco(threads)
