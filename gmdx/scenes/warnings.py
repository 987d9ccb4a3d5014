"""MuJoCo's own messages."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

_LOG = logging.getLogger("gmdx")


@contextmanager
def quiet_warnings() -> Iterator[None]:
    """Send MuJoCo's warnings to the log instead of a file in the working directory."""
    mujoco.set_mju_user_warning(lambda message: _LOG.debug("MuJoCo: %s", message))
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)
