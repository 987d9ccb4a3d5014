"""Warp's messages: off the screen, into the log, and a count of its compilations."""

import logging
from dataclasses import dataclass
from typing import Any

import warp as wp

from gmdx.machine.devices import start_warp

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
    start_warp()
    if not isinstance(wp.get_logger(), _Listener):
        wp.set_logger(_Listener())
    wp.config.log_level = wp.LOG_INFO  # the modules that it builds are told of at this level


def kernel_counts() -> KernelCounts:
    """How many modules of kernels this process has built or loaded so far."""
    listen()
    listener = wp.get_logger()
    return KernelCounts(listener.compiled, listener.loaded)
