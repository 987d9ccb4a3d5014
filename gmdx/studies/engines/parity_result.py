"""What a comparison of an engine with C MuJoCo comes to."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gmdx.errors import UsageError
from gmdx.statistics.agreement import LabelAgreement
from gmdx.studies.engines.machine import Machine
from gmdx.studies.engines.runs import RunFailure
from gmdx.trials.outcome import Outcome


@dataclass(frozen=True)
class ParityLimits:
    """What an engine must keep to; None: no limit."""

    outcomes: float  # least share of trials that end alike
    length: float | None = None  # m, of the median difference of every metric in m
    angle: float | None = None  # rad, of every metric in rad
    force: float | None = None  # of the push-out force's median relative difference


@dataclass(frozen=True)
class Share:
    """A share, and an interval that holds the true one 95 times in 100."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Disagreement:
    """Trials that ended in one way in the reference, and in another in the engine."""

    reference: str  # an outcome's label
    other: str
    trials: int


@dataclass(frozen=True)
class DifferingTrial:
    """One trial that ended otherwise than in the reference."""

    object_id: str
    grasp_id: int
    trial: int
    reference: str  # an outcome's label
    other: str


@dataclass(frozen=True)
class MetricParity:
    """Absolute differences of one metric over the grasps that have it in both engines."""

    metric: str
    unit: str  # "" for a ratio or a count
    pairs: int
    only_reference: int  # grasps that have it in the reference alone
    only_other: int
    median: float  # NaN without pairs, as the next two
    p95: float
    worst: float
    limit: float | None  # of the median

    @property
    def within(self) -> bool | None:
        """Whether the limit holds, which needs a pair at least; None without a limit."""
        return None if self.limit is None else self.median < self.limit


@dataclass(frozen=True)
class ObjectParity:
    """The trials of one object."""

    object_id: str
    trials: int
    agreement: float  # share of equal outcomes


@dataclass(frozen=True)
class EngineParity:
    """One engine against the reference."""

    engine: str
    version: str
    reference: str
    grasps: int
    outcomes: LabelAgreement  # of all trials; rows are the reference's, by value of `Outcome`
    agreement: Share
    success: tuple[float, float]  # share of trials, in the reference and in the engine
    disagreements: tuple[Disagreement, ...]  # the most frequent first
    differing: tuple[DifferingTrial, ...]
    objects: tuple[ObjectParity, ...]
    metrics: tuple[MetricParity, ...]
    force: MetricParity  # the push-out force's difference as a part of the reference's
    limits: ParityLimits | None

    @property
    def trials(self) -> int:
        """How many were compared."""
        return self.outcomes.pairs

    @property
    def agrees(self) -> bool | None:
        """Whether as many outcomes agree as must; None without limits."""
        return None if self.limits is None else self.agreement.value >= self.limits.outcomes

    @property
    def passed(self) -> bool | None:
        """Whether every limit holds; None without limits."""
        if self.limits is None:
            return None
        kept = [self.agrees, self.force.within, *(metric.within for metric in self.metrics)]
        return False not in kept

    def metric(self, name: str) -> MetricParity:
        """One metric's differences.

        Raises:
            UsageError: It is not compared.
        """
        for metric in self.metrics:
            if metric.metric == name:
                return metric
        known = ", ".join(metric.metric for metric in self.metrics)
        raise UsageError(f"no compared metric {name!r}; give one of {known}")

    def as_json(self) -> dict[str, Any]:
        """Everything, with the verdicts; what does not exist is None."""
        labels = [outcome.label for outcome in Outcome]
        counts = self.outcomes.counts
        values = asdict(self) | {
            "trials": self.trials,
            "outcomes": {
                "agreement": asdict(self.agreement) | {"within": self.agrees},
                "kappa": self.outcomes.kappa,
                "counts": {
                    row: {column: int(counts[i, j]) for j, column in enumerate(labels)}
                    for i, row in enumerate(labels)
                },
            },
            "success": {"reference": self.success[0], "other": self.success[1]},
            "metrics": [asdict(one) | {"within": one.within} for one in self.metrics],
            "force": asdict(self.force) | {"within": self.force.within},
            "passed": self.passed,
        }
        del values["agreement"]
        found: dict[str, Any] = _without_nan(values)
        return found


@dataclass(frozen=True)
class ParityFigures:
    """Every engine against the reference, on the same trials."""

    machine: Machine
    reference: str  # the engine, with its version
    objects: tuple[str, ...]
    grasps: int
    nudge: float  # m, that every object is moved by in `floor`
    floor: EngineParity | None  # the reference against itself: what rounding can come to
    parities: tuple[EngineParity, ...]
    failures: tuple[RunFailure, ...]

    def as_json(self) -> dict[str, Any]:
        """Everything."""
        return asdict(self) | {
            "floor": None if self.floor is None else self.floor.as_json(),
            "parities": [parity.as_json() for parity in self.parities],
        }


def _without_nan(value: Any) -> Any:
    """The same with None for every NaN, which JSON does not have."""
    if isinstance(value, dict):
        return {name: _without_nan(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and np.isnan(value) else value
