"""What work costs: seconds on the clock and of the processor, by the name of a stage."""

import contextlib
import os
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Seconds:
    """Seconds by stage."""

    wall: Mapping[str, float] = field(default_factory=dict)  # s, on the clock
    processor: Mapping[str, float] = field(default_factory=dict)  # s, of all cores together

    def __add__(self, other: "Seconds") -> "Seconds":
        """Both together, stage by stage."""
        return Seconds(added(self.wall, other.wall), added(self.processor, other.processor))


class Clock:
    """Counts the seconds of stages, and knows which stage runs or ran last."""

    def __init__(self) -> None:
        self.current = ""  # the stage that runs, or ran last: where an error arose
        self._wall: dict[str, float] = defaultdict(float)
        self._processor: dict[str, float] = defaultdict(float)

    @property
    def seconds(self) -> Seconds:
        """What was counted until now."""
        return Seconds(dict(self._wall), dict(self._processor))

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what happens inside under `name`; processes that it starts and awaits too."""
        self.current = name
        wall, processor = time.perf_counter(), processor_seconds()
        try:
            yield
        finally:
            self._wall[name] += time.perf_counter() - wall
            self._processor[name] += processor_seconds() - processor

    def run(self, stage: str, function: Callable[P, T], /, *args: P.args, **options: P.kwargs) -> T:
        """What `function` returns for these arguments, its time counted under a stage's name."""
        with self.stage(stage):
            return function(*args, **options)


def processor_seconds() -> float:
    """Of this process, all its threads, and the processes that it has awaited."""
    return time.process_time() + sum(os.times()[2:4])


def added(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """The sums of two mappings, name by name."""
    return {name: one.get(name, 0.0) + other.get(name, 0.0) for name in {**one, **other}}
