"""Running the same trials on several engines: opened before anything runs, then followed."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gmdx.errors import GmdxError, UsageError
from gmdx.trials.run import Chosen, choose, open_backend

_LOG = logging.getLogger("gmdx")


@dataclass(frozen=True)
class RunProgress:
    """Where a comparison of engines stands."""

    label: str  # of the run finished last; "" at the start
    done: int  # runs
    total: int
    trials: int  # run by now


@dataclass(frozen=True)
class RunFailure:
    """An engine that could not do what it was asked."""

    label: str
    error: str


class Follower:
    """Counts runs, and tells of each."""

    def __init__(self, total: int, on_progress: Callable[[RunProgress], None] | None) -> None:
        self.done = self.trials = 0
        self.total, self.on_progress = total, on_progress
        self._tell("")

    def ran(self, label: str, trials: int) -> None:
        """A run has finished."""
        self.done += 1
        self.trials += trials
        self._tell(label)

    def failed(self, label: str, error: Exception, *, runs: int) -> RunFailure:
        """An engine has failed, and `runs` runs of it will not be."""
        # What is not our own error needs its place in the code to be understood.
        _LOG.warning(
            "%s failed: %s", label, error, exc_info=None if isinstance(error, GmdxError) else error
        )
        self.total -= runs
        return RunFailure(label, f"{type(error).__name__}: {error}")

    def _tell(self, label: str) -> None:
        if self.on_progress is not None:
            self.on_progress(RunProgress(label, self.done, self.total, self.trials))


def choose_all(backends: Sequence[str]) -> list[Chosen]:
    """Engines by their names, each of them installed.

    Raises:
        UsageError: One is not known or not installed, or there is none.
    """
    if not backends:
        raise UsageError("give at least one backend")
    for name in backends:
        open_backend(name)
    return [choose(name) for name in backends]


def refuse_less_than_one(**counts: int) -> None:
    """Refuse numbers of things below 1.

    Raises:
        UsageError: Naming the number.
    """
    for name, count in counts.items():
        if count < 1:
            raise UsageError(f"{name} must be at least 1, not {count}")
