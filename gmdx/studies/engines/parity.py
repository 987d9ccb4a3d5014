"""How far an engine agrees with C MuJoCo on the same seeded trials: outcomes and metrics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy import stats

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.errors import UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.metrics.compute import compute_metrics
from gmdx.metrics.table import COMPARED
from gmdx.scenes.scene import Scene
from gmdx.statistics.agreement import label_agreement
from gmdx.studies.engines.parity_result import (
    DifferingTrial,
    Disagreement,
    EngineParity,
    MetricParity,
    ObjectParity,
    ParityLimits,
    Share,
)
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import TrialResults

LIMITS: Mapping[str, ParityLimits] = MappingProxyType(
    {
        "warp": ParityLimits(outcomes=0.98, length=1e-4, angle=1e-3, force=0.02),
    }
)


@dataclass(frozen=True)
class Measured:
    """What one engine gave for n grasps of some objects, with t trials each."""

    version: str  # of the engine, with its device
    objects: tuple[str, ...]
    object: Int[Array, "n"]  # of each grasp: index into `objects`
    grasp_id: Int[Array, "n"]
    outcomes: Int[Array, "n t"]  # values of `Outcome`
    values: Mapping[str, Float[Array, "n"]]  # by name, those of `COMPARED`
    force_is_lower_bound: Bool[Array, "n"]


def measure(
    scenes: Sequence[Scene], grasps: Sequence[PlanarGrasp], results: Sequence[TrialResults]
) -> Measured:
    """What an engine's trials come to: their outcomes, and the metrics that come of them.

    Args:
        scenes: Of one object or of several; two scenes of one object count as that object.
        grasps: A record for each scene.
        results: The trials of each scene, all of one engine.

    Raises:
        UsageError: There is no scene, or not as many grasps and results as scenes.
        MetricError: The trials are not those of the grasps.
    """
    if not scenes or not len(scenes) == len(grasps) == len(results):
        raise UsageError(
            f"{len(scenes)} scenes, {len(grasps)} records of grasps and {len(results)} of "
            "results: give one of each for each scene"
        )
    tables = [
        compute_metrics(scene, batch, result)
        for scene, batch, result in zip(scenes, grasps, results, strict=True)
    ]
    ids = [scene.object.object_id for scene in scenes]
    objects = tuple(dict.fromkeys(ids))
    return Measured(
        version=results[0].engine,
        objects=objects,
        object=np.repeat([objects.index(one) for one in ids], [len(table) for table in tables]),
        grasp_id=np.concatenate([result.grasp_id for result in results]),
        outcomes=np.concatenate([table.outcomes for table in tables]),
        values={
            metric.name: np.concatenate([table[metric.name] for table in tables])
            for metric in COMPARED
        },
        force_is_lower_bound=np.concatenate([r.push_force_is_lower_bound for r in results]),
    )


def compare_trials(
    reference: Measured, other: Measured, *, engine: str, limits: ParityLimits | None = None
) -> EngineParity:
    """One engine against the reference, trial by trial and grasp by grasp.

    Trials of one grasp resemble each other, so the interval of the share of equal outcomes
    (Wilson's) takes each grasp for one thing: it is wide rather than narrow.

    Args:
        reference: What the reference gave.
        other: What the engine gave for the same grasps.
        engine: The engine's short name.
        limits: What it must keep to.

    Raises:
        UsageError: The two are not of the same grasps and trials.
    """
    _refuse_others(reference, other)
    a, b = reference.outcomes, other.outcomes
    equal = a == b
    labels = label_agreement(a.ravel(), b.ravel(), classes=len(Outcome))
    value = float(equal.mean())
    low, high = wilson(value, len(a))

    def limit(unit: str) -> float | None:
        return None if limits is None else {"m": limits.length, "rad": limits.angle}.get(unit)

    force, other_force = reference.values["force"], other.values["force"]
    bounds = reference.force_is_lower_bound & other.force_is_lower_bound
    pushed_out = (force > 0) & (other_force > 0) & ~bounds
    scale = np.where(pushed_out, force, np.nan)
    return EngineParity(
        engine=engine,
        version=other.version,
        reference=reference.version,
        grasps=len(a),
        outcomes=labels,
        agreement=Share(value, low, high),
        success=(float((a == Outcome.SUCCESS).mean()), float((b == Outcome.SUCCESS).mean())),
        disagreements=_disagreements(labels.counts),
        differing=tuple(
            DifferingTrial(
                object_id=reference.objects[reference.object[row]],
                grasp_id=int(reference.grasp_id[row]),
                trial=int(trial),
                reference=Outcome(a[row, trial]).label,
                other=Outcome(b[row, trial]).label,
            )
            for row, trial in np.argwhere(~equal)
        ),
        objects=tuple(
            ObjectParity(name, int(equal[rows].size), float(equal[rows].mean()))
            for number, name in enumerate(reference.objects)
            if (rows := reference.object == number).any()
        ),
        metrics=tuple(
            _metric(
                metric.name,
                metric.unit,
                reference.values[metric.name],
                other.values[metric.name],
                limit=limit(metric.unit),
            )
            for metric in COMPARED
        ),
        force=_metric(
            "force, relative",
            "",
            force / scale,
            other_force / scale,
            limit=None if limits is None else limits.force,
        ),
        limits=limits,
    )


def wilson(share: float, count: int, *, level: float = 0.95) -> tuple[float, float]:
    """Wilson's interval of a share of `count` independent things: its low and high end.

    Source: Wilson, "Probable inference, the law of succession, and statistical inference", 1927.
    """
    z = float(stats.norm.ppf(0.5 * (1.0 + level)))
    scale = 1.0 + z**2 / count
    middle = (share + z**2 / (2 * count)) / scale
    half = z / scale * float(np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2)))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _refuse_others(reference: Measured, other: Measured) -> None:
    same = (
        reference.objects == other.objects
        and np.array_equal(reference.object, other.object)
        and np.array_equal(reference.grasp_id, other.grasp_id)
        and reference.outcomes.shape == other.outcomes.shape
    )
    if not same:
        raise UsageError(
            f"{reference.version} ran {reference.outcomes.shape} grasps and trials, "
            f"{other.version} {other.outcomes.shape}, or other ones: compare the same grasps "
            "in both"
        )


def _disagreements(counts: Int[Array, "k k"]) -> tuple[Disagreement, ...]:
    """Pairs of unequal outcomes that occur, the most frequent first."""
    found = [
        Disagreement(first.label, second.label, int(counts[first, second]))
        for first in Outcome
        for second in Outcome
        if first != second and counts[first, second] > 0
    ]
    return tuple(sorted(found, key=lambda one: -one.trials))


def _metric(
    name: str,
    unit: str,
    reference: Float[Array, "n"],
    other: Float[Array, "n"],
    *,
    limit: float | None,
) -> MetricParity:
    has, other_has = np.isfinite(reference), np.isfinite(other)
    difference = np.abs(other - reference)[has & other_has]
    if len(difference):
        median, p95, worst = (float(p) for p in np.percentile(difference, [50, 95, 100]))
    else:
        median = p95 = worst = np.nan
    return MetricParity(
        metric=name,
        unit=unit,
        pairs=len(difference),
        only_reference=int((has & ~other_has).sum()),
        only_other=int((~has & other_has).sum()),
        median=median,
        p95=p95,
        worst=worst,
        limit=limit,
    )
