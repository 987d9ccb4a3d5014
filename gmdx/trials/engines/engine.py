"""What every engine offers."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import TrialConfig


@runtime_checkable
class Engine(Protocol):
    """Runs the schedule of `protocol` on batches of trials."""

    @property
    def version(self) -> str:
        """The engine's name and version, as datasets record it."""
        ...

    def run(self, batches: Sequence[TrialBatch], *, config: TrialConfig) -> list[RawTrials]:
        """Run every trial to its named end; a batch's results do not depend on the others."""
        ...
