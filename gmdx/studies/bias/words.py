"""Words, numbers and style of a bias study's report."""

from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from gmdx.statistics.clustered import Interval

if TYPE_CHECKING:
    from gmdx.studies.bias.result import BiasStudy

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1240px;
  margin: 2em auto; padding: 0 1.2em }
h1 { font-size: 1.6em } h2 { font-size: 1.25em; margin-top: 2.2em }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: 0.83em; margin: 0.8em 0 }
th, td { padding: 0.25em 0.7em; border-bottom: 1px solid #e2e2e2; vertical-align: bottom }
th { border-bottom: 1.5px solid #888; font-weight: 600; max-width: 11em }
.w { text-align: left } .n { text-align: right; font-variant-numeric: tabular-nums }
td { white-space: nowrap }
tbody tr:nth-child(even) { background: #f7f7f7 }
figure { margin: 1.2em 0 } img { max-width: 100% }
figcaption { font-size: 0.88em; color: #555; max-width: 60em }
details { margin: 0.4em 0 } summary { cursor: pointer }
"""

CAPTIONS = {
    "outcomes": "Rows: the dataset's engine; columns: the other run. What is off the diagonal "
    "ended otherwise. Trials of the other-noise run are other draws, so they pair only loosely.",
    "differences": "Bars that miss 0 are more than chance over objects; a difference means "
    "something about the engines only where it also exceeds the noise floor's.",
    "bland": "A dot is a grasp. The nominal trial has no pose noise, so other noise changes only "
    "the success share and collisions.",
    "distributions": "What a dataset's users would see if it had been made by each run.",
    "objects": "Dots: the two engines. Dashes: the dataset's engine against itself.",
    "flips": "A label is positive where at least that share of a grasp's trials succeeds.",
    "truth": "Coulomb friction between rigid bodies; an engine's own deviation, not tuned away.",
}


def number(value: float) -> str:
    """Three significant digits; "-" for what does not exist."""
    if not np.isfinite(value):
        return "-"
    if value != 0 and abs(value) < 5e-4:
        return f"{value:.1e}"
    return "0" if value == 0 else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def percent(share: float) -> str:
    """A share in per cent, one decimal."""
    return f"{100 * share:.1f}" if np.isfinite(share) else "-"


def p_value(value: float) -> str:
    """A p value; no more than says something."""
    if not np.isfinite(value):
        return "-"
    return "< 0.0001" if value < 1e-4 else f"{value:.4f}"


def interval(found: Interval, scale: float) -> str:
    """A mean and its interval; a star where Student's t stands in for the bootstrap."""
    if not np.isfinite(found.mean):
        return "-"
    mean = number(scale * found.mean)
    if not np.isfinite([found.low, found.high]).all():
        return mean
    star = "*" if found.method == "t" else ""
    return f"{mean} [{number(scale * found.low)}, {number(scale * found.high)}]{star}"


def difference_text(study: "BiasStudy", metric: str) -> str:
    """How many times the floor's largest mean difference the engines' is."""
    found = study.engines.metric(metric).difference
    floor = [abs(c.metric(metric).difference.mean) for c in study.floor]
    floor = [value for value in floor if np.isfinite(value)]
    if not floor or not np.isfinite(found.mean):
        return "-"
    if max(floor) == 0:
        return "0" if found.mean == 0 else "no floor"
    return number(abs(found.mean) / max(floor))


def summary_head(study: "BiasStudy") -> tuple[str, ...]:
    """The columns of `summary`."""
    threshold = study.config.thresholds[0]
    return (
        "second - first", "same outcome (%)", "kappa", "success difference (% points)",
        "McNemar p", f"labels flipped at success >= {threshold:g} (%)",
    )  # fmt: skip


def summary(study: "BiasStudy") -> Iterator[tuple[str, ...]]:
    """A row for the engines and for each part of the noise floor."""
    for comparison in study.comparisons:
        found = comparison.outcomes
        yield (
            comparison.label,
            percent(found.trials.agreement),
            number(found.trials.kappa),
            interval(found.success_difference, 100.0),
            p_value(found.mcnemar.p_value),
            interval(comparison.flips[0].flipped, 100.0),
        )


def headline(study: "BiasStudy") -> Iterator[str]:
    """The study in a few sentences, as HTML."""
    engines, floor = study.engines, study.floor
    yield (
        f"{engines.grasps} grasps of {len(engines.objects)} objects, each run in "
        f"{escape(engines.first)} and in {escape(engines.second)} on the same scenes, by the same "
        f"schedule, with the same pose noise; {engines.outcomes.trials.pairs} trials each."
    )
    success = engines.outcomes.success_difference
    agreement = [percent(c.outcomes.trials.agreement) for c in floor]
    beside = f" (noise floor: {', '.join(agreement)} %)" if floor else ""
    yield (
        f"{percent(engines.outcomes.trials.agreement)} % of the trials end alike{beside}; "
        f"Cohen's kappa {number(engines.outcomes.trials.kappa)}. The share of successes differs "
        f"by {interval(success, 100.0)} percentage points."
    )
    flips = [
        f"{percent(flip.flipped.mean)} % at success &ge; {flip.threshold:g}"
        + (f" (floor: up to {percent(max(c.flips[k].flipped.mean for c in floor))} %)"
           if floor else "")
        for k, flip in enumerate(engines.flips)
    ]  # fmt: skip
    yield f"Labels that flip: {'; '.join(flips)}."
    first, second = engines.outcomes.lower_bounds
    yield (
        f"Push-out forces that are only lower bounds, because the ramp ended first: {first} in "
        f"{escape(engines.first)}, {second} in {escape(engines.second)}; they enter as they are."
    )
    yield (
        "Differences are second - first. Intervals are 95 % bootstrap-t intervals that resample "
        "whole objects; a star marks Student's t with one degree of freedom less than objects, "
        "where too few objects differ to resample. Limits of agreement are mean &plusmn; 1.96 "
        "standard deviations, between and within objects together (Bland and Altman 2007). "
        "McNemar's test is exact, on one nominal trial a grasp, and takes grasps as independent, "
        "which those of one object are not quite: read it beside the clustered interval. "
        "The noise floor is the dataset's own engine with other pose noise, half the time step, "
        "and hulls of another resolution; other noise leaves the nominal trial, and so the "
        "metrics taken from it, exactly as they are."
    )
