"""What this machine can compute on, and which array kernels run on it."""

import logging
import os
import sys
import tempfile
from functools import lru_cache
from importlib.util import find_spec

from gmdx.errors import ConfigError
from gmdx.machine.caches import keep_jax_compilations

_LOG = logging.getLogger("gmdx")


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


def implementation(name: str) -> str:
    """The implementation of an array kernel that a configured name stands for.

    `auto` is NumPy on every machine. JAX runs only where it is named: it was not measured faster
    on a GPU or TPU of any kind, and on a CPU it compiles for some 20 s before it takes 0.55 to
    0.85 of NumPy's time (`gmdx bench epsilon`). What it compiles is kept on disk.

    Args:
        name: The name itself, or `auto`.

    Raises:
        ConfigError: It is JAX, which is not installed.
    """
    if name == "auto":
        return "numpy"
    if name == "jax":
        if not installed("jax"):
            raise ConfigError("implementation 'jax' needs jax: pip install 'gmdx[jax]'")
        # JAX would take most of a device's memory at once, which worker processes share.
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
        keep_jax_compilations()
    return name


def on_device(implementation: str) -> str:
    """An implementation's name as records give it: JAX's with the platform it computes on."""
    if implementation != "jax":
        return implementation
    import jax

    return f"jax ({jax.default_backend()})"
