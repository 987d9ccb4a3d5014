"""What the command `gmdx` exits with."""

from enum import IntEnum


class Exit(IntEnum):
    """How a command ended."""

    DONE = 0
    FAILED = 1  # nothing was produced, or an engine failed or missed its limits
    WRONG_USAGE = 2
    INTERRUPTED = 130  # 128 and the number of SIGINT, as shells have it
