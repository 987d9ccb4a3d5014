"""Where this user's caches are, and JAX's among them."""

import os
import sys
from pathlib import Path
from typing import Any

_JAX_FOLDER = "JAX_COMPILATION_CACHE_DIR"


def cache_folder() -> Path:
    """Where what is slow to make is kept: prepared objects, and what JAX compiles.

    The environment variable GMDX_CACHE if set, else `gmdx` in the platform's folder for caches
    (XDG_CACHE_HOME or ~/.cache on Linux).
    """
    own = os.environ.get("GMDX_CACHE")
    if own:
        return Path(own).expanduser()
    shared = os.environ.get("XDG_CACHE_HOME")
    if shared:
        return Path(shared).expanduser() / "gmdx"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "gmdx"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", str(Path.home()))) / "gmdx" / "cache"
    return Path.home() / ".cache" / "gmdx"


def keep_jax_compilations() -> None:
    """Let JAX keep what it compiles in `cache_folder`, for processes to come.

    It holds for this process and those that it starts. A folder that the user has configured for
    JAX is left as it is.
    """
    folder = os.environ.setdefault(_JAX_FOLDER, str(cache_folder() / "jax"))
    if "jax" in sys.modules:  # which has read its environment already
        import jax

        settings: Any = jax.config  # untyped in JAX
        if not settings.jax_compilation_cache_dir:
            settings.update("jax_compilation_cache_dir", folder)
