"""The commands `gmdx bench ...`: figures of this machine, on objects of choice."""

from gmdx.cli.bench.depth import Depth
from gmdx.cli.bench.epsilon import Epsilon, Patches
from gmdx.cli.bench.parity import Parity
from gmdx.cli.bench.pipeline import Pipeline
from gmdx.cli.bench.trials import Trials

__all__ = [
    "Depth",
    "Epsilon",
    "Parity",
    "Patches",
    "Pipeline",
    "Trials",
]
