"""Trials on MuJoCo Warp: the worlds of many objects in one batch, on NVIDIA devices or the CPU.

This door is what `ParallelEngine` asks of an implementation: which objects go together
(`bucket`), room for them (`open_worlds`, `suggested_capacity`), and what ran (`version`).
"""

from gmdx.trials.engines.warp.log import kernel_counts
from gmdx.trials.engines.warp.worlds import bucket, open_worlds, suggested_capacity, version

__all__ = [
    "bucket",
    "kernel_counts",
    "open_worlds",
    "suggested_capacity",
    "version",
]
