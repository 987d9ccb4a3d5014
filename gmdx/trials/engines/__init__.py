"""What steps the trials: the table of engines, by their names.

`open_engine` opens one of the `ENGINES`; `choose` says what `auto` stands for. An engine runs the
schedule of `trials.protocol` and leaves the outcomes to `trials.execute`, so a new one is a module
(or a folder) with the methods of `Engine`, and a row in the table of `registry`. What
it needs is imported only when it is opened. `ParallelEngine` is for engines that step many
objects' trials side by side on devices.
"""

from gmdx.trials.engines.engine import Engine
from gmdx.trials.engines.parallel import MOST_OBJECTS, Cancelled, ParallelEngine
from gmdx.trials.engines.registry import AUTO, DEFAULT_ENGINE, ENGINES, choose, open_engine

__all__ = [
    "AUTO",
    "DEFAULT_ENGINE",
    "ENGINES",
    "MOST_OBJECTS",
    "Cancelled",
    "Engine",
    "ParallelEngine",
    "choose",
    "open_engine",
]
