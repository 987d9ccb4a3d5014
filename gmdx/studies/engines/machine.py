"""What a measurement ran on, and what its engines compiled and held on their devices."""

import platform
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from gmdx.machine.processes import available_cores
from gmdx.trials.engines.registry import Chosen

_PACKAGES = (
    "gmdx", "numpy", "mujoco", "mujoco-mjx", "warp-lang", "jax", "jaxlib", "pybullet",
)  # fmt: skip
_CPU_FILE = Path("/proc/cpuinfo")
_COMPILED = "/jax/core/compile/backend_compile_duration"
_FROM_DISK = "/jax/compilation_cache/cache_hits"
_HELPER = 1.0  # s; JAX's own small programs compile faster than this, a step of trials does not


@dataclass(frozen=True)
class Machine:
    """The host, and the versions of what ran."""

    processor: str
    cores: int  # that this process may use
    system: str
    python: str
    packages: dict[str, str]  # versions; what is not installed is not listed


@dataclass(frozen=True)
class Compilations:
    """Programs for a device that this process asked for: Warp's modules, or JAX's functions."""

    compiled: int
    cached: int  # found on disk, where an earlier process had compiled them

    def since(self, before: "Compilations") -> "Compilations":
        """What came after `before`."""
        return Compilations(self.compiled - before.compiled, self.cached - before.cached)


def machine() -> Machine:
    """This machine."""
    packages = {}
    for name in _PACKAGES:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            continue
    return Machine(
        processor=_processor(),
        cores=available_cores(),
        system=f"{platform.system()} {platform.machine()}",
        python=platform.python_version(),
        packages=packages,
    )


def compilations(chosen: Chosen) -> Compilations | None:
    """What has been compiled for an engine in this process so far; None where nothing is.

    JAX's are counted from the first call on, without its own small helpers.
    """
    if chosen.impl == "warp":
        from gmdx.trials.engines.warp.log import kernel_counts

        counts = kernel_counts()
        return Compilations(counts.compiled, counts.loaded)
    if chosen.impl == "jax":
        listener = _jax_listener()
        return Compilations(listener.compiled, listener.cached)
    return None


def peak_device_memory(chosen: Chosen) -> int | None:
    """The most memory that an engine ever held on one device in this process, bytes.

    None where the engine computes on the CPU, or its device does not tell.
    """
    if chosen.impl == "warp":
        import warp

        pools = [device for device in warp.get_cuda_devices() if device.is_mempool_supported]
        return max((int(warp.get_mempool_used_mem_high(pool)) for pool in pools), default=None)
    if chosen.impl == "jax":
        import jax

        stats: list[dict[str, Any]] = [one.memory_stats() or {} for one in jax.local_devices()]
        peaks = (one.get("peak_bytes_in_use") for one in stats)
        return max((int(peak) for peak in peaks if peak is not None), default=None)
    return None


class _JaxListener:
    """Counts what JAX compiles, by the events that it reports."""

    def __init__(self) -> None:
        self.compiled = self.cached = 0
        self._found = False

    def on_event(self, event: str, **_: str | int) -> None:
        """A program found on disk is reported before the time that it took."""
        self._found |= event == _FROM_DISK

    def on_duration(self, event: str, duration_secs: float, **_: str | int) -> None:
        if event == _COMPILED:
            self.cached += self._found
            self.compiled += not self._found and duration_secs > _HELPER
            self._found = False


@lru_cache(maxsize=1)
def _jax_listener() -> _JaxListener:
    """The one of this process."""
    import jax

    listener = _JaxListener()
    jax.monitoring.register_event_listener(listener.on_event)
    jax.monitoring.register_event_duration_secs_listener(listener.on_duration)
    return listener


def _processor() -> str:
    """The processor's name; its architecture where the system does not tell."""
    if _CPU_FILE.is_file():
        for line in _CPU_FILE.read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
