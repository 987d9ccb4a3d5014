"""Which accelerator JAX computes on, if there is one, and which array kernels that asks for."""

import logging
import os
import sys
import tempfile
from functools import lru_cache
from importlib.metadata import entry_points
from importlib.util import find_spec

from gmdx.errors import ConfigError
from gmdx.machine.caches import keep_jax_compilations

_LOG = logging.getLogger("gmdx")


@lru_cache(maxsize=1)
def accelerator() -> str | None:
    """JAX's name of the accelerator's platform, such as `gpu` or `tpu`; None on a plain CPU.

    JAX, which takes half a second and 130 MB to import, is only asked where one of the plugins
    is installed by which it reaches accelerators.
    """
    if not (entry_points(group="jax_plugins") or installed("jax_plugins") or installed("libtpu")):
        return None
    # JAX would take most of the memory at once, and worker processes and Warp share the device.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    import jax

    try:
        platform = str(jax.default_backend())
    except RuntimeError as error:  # a plugin without its device, or the other way round
        _LOG.warning("JAX found no device: %s; array kernels run on the CPU without it", error)
        return None
    return None if platform == "cpu" else platform


def installed(module: str) -> bool:
    """Whether a module could be imported."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # not even the package that it would be in
        return False


@lru_cache(maxsize=1)
def cuda_devices() -> int:
    """How many NVIDIA devices Warp sees; 0 where Warp is not installed."""
    if not installed("warp"):
        return 0
    import warp

    start_warp()
    count: int = warp.get_cuda_device_count()
    return count


@lru_cache(maxsize=1)
def start_warp() -> None:
    """Start Warp without its banner.

    Its C code writes to standard error that there is no NVIDIA driver: to our log instead.
    """
    import warp

    warp.config.log_level = warp.LOG_WARNING
    sys.stderr.flush()
    saved = os.dup(2)
    with tempfile.TemporaryFile() as heard:
        os.dup2(heard.fileno(), 2)
        try:
            warp.init()
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            heard.seek(0)
            for line in heard.read().decode(errors="replace").splitlines():
                _LOG.debug("warp: %s", line)


def check_implementation(name: str, known: tuple[str, ...], *, kernel: str) -> None:
    """Refuse a name that is neither `auto` nor one of a kernel's implementations.

    Raises:
        ConfigError: Listing the known ones.
    """
    if name not in ("auto", *known):
        choices = ", ".join(("auto", *known))
        raise ConfigError(f"{kernel} has no implementation {name!r}; give one of {choices}")


def implementation(name: str, *, cpu: str, accelerated: str = "jax") -> str:
    """The implementation of an array kernel that a configured name stands for on this machine.

    What JAX compiles from then on is kept on disk.

    Args:
        name: The name itself, or `auto`.
        cpu: What `auto` is on a plain CPU.
        accelerated: What `auto` is where JAX has an accelerator.

    Raises:
        ConfigError: It is JAX, which is not installed.
    """
    if name == "jax" and not installed("jax"):
        raise ConfigError("implementation 'jax' needs jax: pip install 'gmdx[jax]'")
    if name == "auto":
        name = cpu if accelerator() is None else accelerated
    if name == "jax":
        keep_jax_compilations()
    return name


def on_device(implementation: str) -> str:
    """An implementation's name as records give it: JAX's with the platform it computes on."""
    if implementation != "jax":
        return implementation
    return f"jax ({accelerator() or 'cpu'})"
