"""What two runs of the same grasps differ in: outcomes, metrics, labels, over all and by object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.metrics.table import COMPARED, Metric
from gmdx.statistics.agreement import (
    LabelAgreement,
    Limits,
    McNemar,
    kendall,
    ks_distance,
    label_agreement,
    limits_of_agreement,
    mcnemar,
    spearman,
)
from gmdx.statistics.clustered import Interval, clustered_mean
from gmdx.studies.bias.replay import RunRows
from gmdx.trials.outcome import Outcome

_OUTCOMES = len(Outcome)


@dataclass(frozen=True)
class MetricAgreement:
    """One metric in two runs; differences are second - first, over grasps that have it in both."""

    metric: str
    unit: str
    pairs: int
    only_first: int  # grasps for which it exists in the first run alone
    only_second: int
    mean_first: float
    mean_second: float
    difference: Interval  # of the mean, clustered
    limits: Limits
    low: float  # 2.5th percentile of the differences as they are
    high: float  # 97.5th
    rms: float  # root mean square difference
    changed: float  # share of pairs that differ at all
    spearman: float
    kendall: float
    ks: float  # Kolmogorov-Smirnov distance


@dataclass(frozen=True)
class OutcomeAgreement:
    """How trials ended in two runs."""

    trials: LabelAgreement  # outcomes of all trials
    nominal: LabelAgreement  # of the nominal ones
    success: LabelAgreement  # no or yes, of all trials that diverged in neither run
    mcnemar: McNemar  # of success in nominal trials: one pair a grasp
    success_difference: Interval  # of all those trials, second - first, clustered
    lower_bounds: tuple[int, int]  # push-out forces that are lower bounds, first and second


@dataclass(frozen=True)
class Flips:
    """How labels "success share >= threshold" change."""

    threshold: float
    grasps: int
    positive_first: int
    positive_second: int
    lost: int  # positive in the first run alone
    gained: int  # in the second alone
    flipped: Interval  # share, clustered
    kappa: float
    p_value: float  # McNemar's


@dataclass(frozen=True)
class ObjectAgreement:
    """One object in two runs; intervals take its grasps as independent."""

    object_id: str
    grasps: int
    agreement: float  # of the outcomes of all trials
    kappa: float
    success_first: float  # share of trials
    success_second: float
    metrics: tuple[MetricAgreement, ...]


@dataclass(frozen=True)
class Comparison:
    """Everything that two runs differ in."""

    name: str  # of the second run
    label: str
    first: str
    second: str
    grasps: int  # that both runs have
    outcomes: OutcomeAgreement
    metrics: tuple[MetricAgreement, ...]
    flips: tuple[Flips, ...]
    objects: tuple[ObjectAgreement, ...]

    def metric(self, name: str) -> MetricAgreement:
        """The agreement of one metric."""
        return next(metric for metric in self.metrics if metric.metric == name)


def compare(
    first: RunRows,
    second: RunRows,
    objects: Sequence[str],
    index: Int[Array, "n"],
    *,
    name: str,
    labels: tuple[str, str],
    thresholds: Sequence[float],
    seed: int,
    resamples: int,
) -> Comparison:
    """Compare two runs of the same n grasps.

    Args:
        first: What the second is measured against.
        second: The run in question.
        objects: Ids of the objects.
        index: Which of them each grasp is of.
        name: Of the comparison.
        labels: Of the runs.
        thresholds: Of the success share.
        seed: Of the resampling.
        resamples: Of each interval.
    """
    both = first.present & second.present

    def metrics(rows: Bool[Array, "n"], cluster: Int[Array, "n"]) -> tuple[MetricAgreement, ...]:
        return tuple(
            _metric(
                metric,
                first.values[metric.name][rows],
                second.values[metric.name][rows],
                cluster[rows],
                seed=seed,
                resamples=resamples,
            )
            for metric in COMPARED
        )

    grasp = np.arange(len(index))
    return Comparison(
        name=name,
        label=f"{labels[1]} - {labels[0]}",
        first=labels[0],
        second=labels[1],
        grasps=int(both.sum()),
        outcomes=_outcomes(first, second, both, index, seed=seed, resamples=resamples),
        metrics=metrics(both, index),
        flips=tuple(
            _flips(first, second, both, index, threshold, seed=seed, resamples=resamples)
            for threshold in thresholds
        ),
        objects=tuple(
            _object(object_id, first, second, rows, metrics(rows, grasp))
            for k, object_id in enumerate(objects)
            if (rows := both & (index == k)).any()
        ),
    )


def _metric(
    metric: Metric,
    first: Float[Array, "n"],
    second: Float[Array, "n"],
    cluster: Int[Array, "n"],
    *,
    seed: int,
    resamples: int,
) -> MetricAgreement:
    has_first, has_second = np.isfinite(first), np.isfinite(second)
    both = has_first & has_second
    a, b = first[both], second[both]
    difference = b - a
    some = len(difference) > 0
    low, high = np.percentile(difference, [2.5, 97.5]) if some else (np.nan, np.nan)
    return MetricAgreement(
        metric=metric.name,
        unit=metric.unit,
        pairs=int(both.sum()),
        only_first=int((has_first & ~has_second).sum()),
        only_second=int((~has_first & has_second).sum()),
        mean_first=float(a.mean()) if some else np.nan,
        mean_second=float(b.mean()) if some else np.nan,
        difference=clustered_mean(difference, cluster[both], seed=seed, resamples=resamples),
        limits=limits_of_agreement(difference, cluster[both]),
        low=float(low),
        high=float(high),
        rms=float(np.sqrt((difference**2).mean())) if some else np.nan,
        changed=float((difference != 0).mean()) if some else np.nan,
        spearman=spearman(a, b),
        kendall=kendall(a, b),
        ks=ks_distance(a, b),
    )


def _outcomes(
    first: RunRows,
    second: RunRows,
    both: Bool[Array, "n"],
    index: Int[Array, "n"],
    *,
    seed: int,
    resamples: int,
) -> OutcomeAgreement:
    a, b = first.outcomes[both], second.outcomes[both]
    cluster = np.broadcast_to(index[both][:, None], a.shape)
    valid = ~(Outcome.is_failure(a) | Outcome.is_failure(b))
    yes_a, yes_b = a == Outcome.SUCCESS, b == Outcome.SUCCESS
    sure = valid[:, 0]
    return OutcomeAgreement(
        trials=label_agreement(a.ravel(), b.ravel(), classes=_OUTCOMES),
        nominal=label_agreement(a[:, 0], b[:, 0], classes=_OUTCOMES),
        success=label_agreement(yes_a[valid].astype(int), yes_b[valid].astype(int), classes=2),
        mcnemar=mcnemar(yes_a[sure, 0], yes_b[sure, 0]),
        success_difference=clustered_mean(
            yes_b[valid].astype(float) - yes_a[valid], cluster[valid], seed=seed,
            resamples=resamples,
        ),
        lower_bounds=(int(first.lower_bound[both].sum()), int(second.lower_bound[both].sum())),
    )  # fmt: skip


def _flips(
    first: RunRows,
    second: RunRows,
    both: Bool[Array, "n"],
    index: Int[Array, "n"],
    threshold: float,
    *,
    seed: int,
    resamples: int,
) -> Flips:
    share_a, share_b = first.values["sim_success"], second.values["sim_success"]
    rows = both & np.isfinite(share_a) & np.isfinite(share_b)
    # A share of 3 / 5 is not always the double nearest to 0.6.
    yes_a, yes_b = share_a[rows] >= threshold - 1e-9, share_b[rows] >= threshold - 1e-9
    test = mcnemar(yes_a, yes_b)
    agreement = label_agreement(yes_a.astype(int), yes_b.astype(int), classes=2)
    flipped = (yes_a != yes_b).astype(float)
    return Flips(
        threshold=threshold,
        grasps=int(rows.sum()),
        positive_first=int(yes_a.sum()),
        positive_second=int(yes_b.sum()),
        lost=test.only_first,
        gained=test.only_second,
        flipped=clustered_mean(flipped, index[rows], seed=seed, resamples=resamples),
        kappa=agreement.kappa,
        p_value=test.p_value,
    )


def _object(
    object_id: str,
    first: RunRows,
    second: RunRows,
    rows: Bool[Array, "n"],
    metrics: tuple[MetricAgreement, ...],
) -> ObjectAgreement:
    a, b = first.outcomes[rows], second.outcomes[rows]
    valid = ~(Outcome.is_failure(a) | Outcome.is_failure(b))
    labels = label_agreement(a.ravel(), b.ravel(), classes=_OUTCOMES)
    shares = [
        float((x[valid] == Outcome.SUCCESS).mean()) if valid.any() else np.nan for x in (a, b)
    ]
    return ObjectAgreement(
        object_id=object_id,
        grasps=int(rows.sum()),
        agreement=labels.agreement,
        kappa=labels.kappa,
        success_first=shares[0],
        success_second=shares[1],
        metrics=metrics,
    )


def most_disputed(first: RunRows, second: RunRows, count: int) -> list[int]:
    """Rows that two runs disagree about most, worst first; none that they agree on.

    By difference of the success share, then by whether the nominal trial ended otherwise, then by
    how many trials did.
    """
    both = first.present & second.present
    share = np.abs(second.values["sim_success"] - first.values["sim_success"])
    share = np.where(both & np.isfinite(share), share, 0.0)
    otherwise = (first.outcomes != second.outcomes) & both[:, None]
    order = np.lexsort([np.arange(len(both)), -otherwise.sum(1), ~otherwise[:, 0], -share])
    return [int(row) for row in order[:count] if otherwise[row].any()]
