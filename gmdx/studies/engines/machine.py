"""What a measurement ran on, and what its engines compiled and held on their devices."""

import platform
from dataclasses import dataclass
from pathlib import Path

from gmdx.machine.cores import available_cores
from gmdx.machine.packages import versions_installed

_PACKAGES = (
    "gmdx", "numpy", "mujoco", "mujoco-mjx", "warp-lang", "jax", "jaxlib", "pybullet",
)  # fmt: skip
_CPU_FILE = Path("/proc/cpuinfo")


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
    """Programs for a device that this process asked for: Warp's modules."""

    compiled: int
    cached: int  # found on disk, where an earlier process had compiled them

    def since(self, before: "Compilations") -> "Compilations":
        """What came after `before`."""
        return Compilations(self.compiled - before.compiled, self.cached - before.cached)


def machine() -> Machine:
    """This machine."""
    return Machine(
        processor=_processor(),
        cores=available_cores(),
        system=f"{platform.system()} {platform.machine()}",
        python=platform.python_version(),
        packages=versions_installed(_PACKAGES),
    )


def compilations(engine: str) -> Compilations | None:
    """What has been compiled for an engine in this process so far; None where nothing is."""
    if engine != "warp":
        return None
    from gmdx.trials.engines.warp import kernel_counts

    counts = kernel_counts()
    return Compilations(counts.compiled, counts.loaded)


def peak_device_memory(engine: str) -> int | None:
    """The most memory that an engine ever held on one device in this process, bytes.

    None where the engine computes on the CPU, or its device does not tell.
    """
    if engine != "warp":
        return None
    import warp

    pools = [device for device in warp.get_cuda_devices() if device.is_mempool_supported]
    return max((int(warp.get_mempool_used_mem_high(pool)) for pool in pools), default=None)


def _processor() -> str:
    """The processor's name; its architecture where the system does not tell."""
    if _CPU_FILE.is_file():
        for line in _CPU_FILE.read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
