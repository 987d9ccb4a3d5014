"""The commands `gmdx bench ...`: figures of this machine, on objects of choice.

Each is imported when it is first used, so that one measurement does not load, and hold in memory,
what another rests on.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_MODULES = {
    "gmdx.cli.bench.depth": ("Depth",),
    "gmdx.cli.bench.epsilon": ("Epsilon", "Patches"),
    "gmdx.cli.bench.parity": ("Parity",),
    "gmdx.cli.bench.pipeline": ("Pipeline",),
    "gmdx.cli.bench.trials": ("Trials",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A command, from its module."""
    if name not in _HOME:
        raise AttributeError(f"module 'gmdx.cli.bench' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
