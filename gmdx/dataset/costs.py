"""What an object cost: seconds by stage, for `cost.json`."""

import contextlib
import os
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

from gmdx.metrics.table import METRICS
from gmdx.trials.results import TrialResults


class Costs:
    """Adds up wall-clock and processor seconds by stage of the pipeline."""

    def __init__(self) -> None:
        self.current = ""  # the stage that runs, or ran last: where an error arose
        self._wall: dict[str, float] = defaultdict(float)
        self._cpu: dict[str, float] = defaultdict(float)
        self._metrics: dict[str, float] = defaultdict(float)
        self._trials: dict[str, float] = defaultdict(float)
        self._prepare: Mapping[str, Any] = {}
        self._grasps = 0

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what happens inside under `name`; processes that it starts and awaits too."""
        self.current = name
        wall, cpu = time.perf_counter(), _processor_seconds()
        try:
            yield
        finally:
            self._wall[name] += time.perf_counter() - wall
            self._cpu[name] += _processor_seconds() - cpu

    def add_device(self, name: str, seconds: float) -> None:
        """Count seconds of a device, which stand for processor seconds, under a stage's name."""
        self._wall[name] += seconds
        self._cpu[name] += seconds

    def add_prepared(self, seconds: Mapping[str, Any]) -> None:
        """Take up the seconds by step that preparing the object reported."""
        self._prepare = seconds

    def add_batch(self, trials: TrialResults, metrics: Mapping[str, float]) -> None:
        """Take up what trials and metrics report about one batch of grasps.

        Args:
            trials: Results of the batch, with the seconds inside the engine's step.
            metrics: Seconds by stage of the metric table.
        """
        self._grasps += len(trials)
        self._trials["steps"] += trials.steps
        self._trials["step_seconds"] += trials.step_seconds
        self._trials["seconds"] += trials.seconds
        for stage, seconds in metrics.items():
            self._metrics[stage] += seconds

    def as_json(self) -> dict[str, Any]:
        """The content of `cost.json`."""
        return {
            "grasps": self._grasps,
            "wall_seconds": dict(self._wall),
            "cpu_seconds": dict(self._cpu),
            "prepare_seconds": dict(self._prepare),
            "trials": dict(self._trials),
            "metric_seconds": dict(self._metrics),
            "seconds_per_grasp_and_metric": self._by_metric(),
        }

    def _by_metric(self) -> dict[str, float]:
        """Processor seconds that one metric of one grasp needs, with all that it rests on.

        Metrics of one stage share its cost: asked for together, they cost it once.
        """
        grasps = max(self._grasps, 1)
        trials = self._cpu["trials"] + self._metrics["trial"]
        needs = {
            "object": self._metrics["object"],
            "grasp": self._metrics["grasp"],
            "contact": self._metrics["contact"],
            "trial": trials,
        }
        seconds = {}
        for metric in METRICS:
            if metric.stage == "epsilon":
                contacts = needs["contact"] if metric.kind == "priori" else trials
                total = contacts + self._metrics[f"epsilon/{metric.name}"]
            else:
                total = needs[metric.stage]
                if metric.kind == "comparative":
                    total += needs["contact"]
            seconds[metric.name] = total / grasps
        return seconds


def _processor_seconds() -> float:
    """Of this process, all its threads, and the processes that it has awaited."""
    return sum(os.times()[:4])
