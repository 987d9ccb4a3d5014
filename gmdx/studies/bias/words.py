"""The words of a bias study: captions, its summary in a table and in a few sentences."""

from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from gmdx.pictures.page import number, p_value, percent
from gmdx.statistics.clustered import Interval

if TYPE_CHECKING:
    from gmdx.studies.bias.result import BiasStudy

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
