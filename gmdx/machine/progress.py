"""Where a run stands: the one record that whoever follows a run is given."""

from collections.abc import Callable
from dataclasses import dataclass

from gmdx.errors import Failure


@dataclass(frozen=True)
class Progress:
    """Where a run stands, at its start and after each thing that it finished."""

    name: str  # what was finished last: an object, a replay, an engine; "" at the start
    done: int  # things finished in this run
    total: int  # things to do in this run
    count: int  # grasps or trials worked through in this run: what a rate is of
    failures: tuple[Failure, ...] = ()  # of what was finished last


OnProgress = Callable[[Progress], None]


class Follower:
    """Counts what a run finishes, and tells of it."""

    def __init__(self, total: int, on_progress: OnProgress | None) -> None:
        """Tell of the start.

        Args:
            total: Things to do.
            on_progress: Whom to tell; None: nobody.
        """
        self.done = self.count = 0
        self._total, self._on_progress = total, on_progress
        self._tell("", ())

    def finished(
        self, name: str, *, things: int = 1, count: int = 0, failures: tuple[Failure, ...] = ()
    ) -> None:
        """Something was finished, well or not.

        Args:
            name: What it was.
            things: How many of the total it was.
            count: Grasps or trials that it worked through.
            failures: What of it failed.
        """
        self.done += things
        self.count += count
        self._tell(name, failures)

    def _tell(self, name: str, failures: tuple[Failure, ...]) -> None:
        if self._on_progress is not None:
            self._on_progress(Progress(name, self.done, self._total, self.count, failures))
