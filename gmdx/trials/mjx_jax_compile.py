"""JAX's compilations: kept on disk between processes, and counted."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import jax

from gmdx.objects.cache import cache_folder

_COMPILED = "/jax/core/compile/backend_compile_duration"
_FROM_DISK = "/jax/compilation_cache/cache_hits"


def enable_compilation_cache() -> None:
    """Keep what JAX compiles in this user's folder for caches, for processes to come.

    A folder that the user has configured for JAX is left as it is.
    """
    settings: Any = jax.config  # untyped in JAX
    if not (settings.jax_compilation_cache_dir or os.environ.get("JAX_COMPILATION_CACHE_DIR")):
        settings.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))


@dataclass
class Compilations:
    """What was compiled while it was watched, small helpers of JAX included."""

    seconds: list[float] = field(default_factory=list)
    from_disk: int = 0  # of these, found in the cache on disk

    def longer_than(self, seconds: float) -> int:
        """How many took longer: a step does by far, JAX's helpers do not."""
        return sum(duration > seconds for duration in self.seconds)


@contextmanager
def watched_compilations() -> Iterator[Compilations]:
    """Count the compilations of this process meanwhile."""
    found = Compilations()

    def on_duration(event: str, duration_secs: float, **_: Any) -> None:
        if event == _COMPILED:
            found.seconds.append(duration_secs)

    def on_event(event: str, **_: Any) -> None:
        if event == _FROM_DISK:
            found.from_disk += 1

    jax.monitoring.register_event_duration_secs_listener(on_duration)
    jax.monitoring.register_event_listener(on_event)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_duration_listener(on_duration)
        jax.monitoring.unregister_event_listener(on_event)
