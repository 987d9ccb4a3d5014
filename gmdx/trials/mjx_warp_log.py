"""Warp's messages: off the screen, into the log, and a count of its compilations."""

import logging
import os
import sys
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import warp as wp

_LOG = logging.getLogger("gmdx")


@dataclass(frozen=True)
class KernelCounts:
    """Since Warp's messages are listened to."""

    compiled: int  # modules of kernels that were built
    loaded: int  # modules that were built before and came from the cache on disk


class _Listener:
    """A logger for Warp, which reports each module that it builds or loads in a message."""

    def __init__(self) -> None:
        self.compiled = self.loaded = 0

    def debug(self, message: str) -> None:
        _LOG.debug("warp: %s", message)

    def info(self, message: str) -> None:
        if message.rstrip().endswith("(compiled)"):
            if self.compiled == 0:
                _LOG.info("compiling Warp kernels (once on this machine)")
            self.compiled += 1
        self.loaded += message.rstrip().endswith("(cached)")
        _LOG.debug("warp: %s", message)

    def warning(self, message: str, category: Any = None, stacklevel: int = 1) -> None:
        _LOG.warning("warp: %s", message)

    def error(self, message: str) -> None:
        _LOG.error("warp: %s", message)


def listen() -> None:
    """Start Warp with its messages in our log; more calls change nothing."""
    if not isinstance(wp.get_logger(), _Listener):
        wp.set_logger(_Listener())
    wp.config.log_level = wp.LOG_INFO  # the modules that it builds are told of at this level
    _start()


@lru_cache(maxsize=1)
def _start() -> None:
    """Start Warp, whose C code writes to standard error that there is no NVIDIA driver."""
    sys.stderr.flush()
    saved = os.dup(2)
    with tempfile.TemporaryFile() as heard:
        os.dup2(heard.fileno(), 2)
        try:
            wp.init()
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            heard.seek(0)
            for line in heard.read().decode(errors="replace").splitlines():
                _LOG.debug("warp: %s", line)


def kernel_counts() -> KernelCounts:
    """How many modules of kernels this process has built or loaded so far."""
    listen()
    listener = wp.get_logger()
    return KernelCounts(listener.compiled, listener.loaded)
