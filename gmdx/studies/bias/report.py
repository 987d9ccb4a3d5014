"""`report.html` of a bias study: one file that opens offline, figures and all."""

from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from gmdx.pictures.page import number, p_value, page, percent, picture, table
from gmdx.studies.bias.compare import MetricAgreement
from gmdx.studies.bias.figures import DRAWN, bias_figures, shown, with_shown_unit
from gmdx.studies.bias.words import (
    CAPTIONS,
    difference_text,
    headline,
    interval,
)

if TYPE_CHECKING:
    from gmdx.studies.bias.result import BiasStudy


def report_html(study: "BiasStudy") -> str:
    """The whole report."""
    pictures = {
        name: picture(name, figure, CAPTIONS.get(name.split("_")[0], ""))
        for name, figure in bias_figures(study).items()
    }
    disputed = [html for name, html in pictures.items() if name.startswith("disputed")]
    title = f"{study.dataset.root.name}: {study.engines.label}"
    body = [
        f"<h1>How much do the labels depend on the simulator?</h1><p>{escape(title)}</p>",
        *(f"<p>{line}</p>" for line in headline(study)),
        "<h2>What ran</h2>",
        _runs(study),
        "<h2>Outcomes</h2>",
        _outcomes(study),
        pictures["outcomes"],
        "<h2>Metrics: mean differences</h2>",
        _differences(study),
        pictures["differences"],
        "<h2>Metrics: how far apart single grasps are</h2>",
        _limits(study),
        pictures["bland_altman"],
        "<h2>Metrics: ranks and distributions</h2>",
        _ranks(study),
        pictures["distributions"],
        "<h2>Labels</h2>",
        _flips(study),
        pictures["flips"],
        "<h2>By object</h2>",
        _objects(study),
        pictures["objects"],
        *_object_details(study),
        "<h2>The most disputed grasps</h2>",
        *(disputed if disputed else ["<p>The engines agree about every trial.</p>"]),
    ]
    if study.truth:
        body += ["<h2>Closed forms</h2>", _truth(study), pictures["truth"]]
    if study.failures:
        body += ["<h2>What could not be run</h2>", _failures(study)]
    return page(title, body)


def _runs(study: "BiasStudy") -> str:
    rows = [
        [run.name, run.label, study.versions[run.name], f"{study.rows[run.name].present.sum()}",
         f"{1e3 * run.physics.timestep:g}", f"{study.trials}"]
        for run in study.runs
    ]  # fmt: skip
    head = ["column suffix", "run", "engine", "grasps", "step (ms)", "trials a grasp"]
    return table(head, rows, words=range(3))


def _outcomes(study: "BiasStudy") -> str:
    rows = []
    for comparison in study.comparisons:
        found = comparison.outcomes
        test = found.mcnemar
        rows.append(
            [comparison.label, f"{found.trials.pairs}", percent(found.trials.agreement),
             number(found.trials.kappa), number(found.trials.matthews),
             percent(found.success.agreement), number(found.success.kappa),
             number(found.success.matthews), interval(found.success_difference, 100.0),
             f"{test.only_first} / {test.only_second}", p_value(test.p_value)]
        )  # fmt: skip
    head = ["second - first", "trials", "same outcome (%)", "kappa", "Matthews",
            "same success (%)", "kappa (success)", "Matthews (success)",
            "success difference (% points)", "nominal success only first / second",
            "McNemar p"]  # fmt: skip
    return table(head, rows)


def _columns(study: "BiasStudy", of: str) -> list[str]:
    return [f"{of}: {comparison.second}" for comparison in study.comparisons]


def _every(study: "BiasStudy", metric: str) -> Iterator[MetricAgreement]:
    for comparison in study.comparisons:
        yield comparison.metric(metric)


def _differences(study: "BiasStudy") -> str:
    rows = []
    for name in [m.metric for m in study.engines.metrics]:
        scale, _ = shown(name)
        found = study.engines.metric(name)
        cells = [interval(x.difference, scale) for x in _every(study, name)]
        rows.append(
            [with_shown_unit(name), f"{found.pairs}", f"{found.only_first} / {found.only_second}",
             number(scale * found.mean_first), number(scale * found.mean_second), *cells,
             difference_text(study, name)]
        )  # fmt: skip
    head = ["metric", "pairs", "exists only in first / second", f"mean {study.engines.first}",
            f"mean {study.engines.second}", *_columns(study, "difference"),
            "engines' difference / largest of the floor's"]  # fmt: skip
    return table(head, rows)


def _limits(study: "BiasStudy") -> str:
    rows = []
    for name in [m.metric for m in study.engines.metrics]:
        scale, _ = shown(name)
        limits = [
            f"{number(scale * x.limits.lower)} to {number(scale * x.limits.upper)}"
            for x in _every(study, name)
        ]
        rms = [number(scale * x.rms) for x in _every(study, name)]
        found = study.engines.metric(name)
        spread = f"{number(scale * found.low)} to {number(scale * found.high)}"
        rows.append([with_shown_unit(name), *limits, spread, *rms])
    head = ["metric", *_columns(study, "limits of agreement"),
            f"2.5 to 97.5 percentile: {study.engines.second}",
            *_columns(study, "root mean square")]  # fmt: skip
    return table(head, rows)


def _ranks(study: "BiasStudy") -> str:
    rows = [
        [name, *(number(x.spearman) for x in _every(study, name)),
         *(number(x.kendall) for x in _every(study, name)),
         *(number(x.ks) for x in _every(study, name))]
        for name in [m.metric for m in study.engines.metrics]
    ]  # fmt: skip
    head = ["metric", *_columns(study, "Spearman"), *_columns(study, "Kendall"),
            *_columns(study, "KS distance")]  # fmt: skip
    return table(head, rows)


def _flips(study: "BiasStudy") -> str:
    rows = [
        [f"success >= {flips.threshold:g}", comparison.label, f"{flips.grasps}",
         f"{flips.positive_first}", f"{flips.positive_second}", f"{flips.lost}", f"{flips.gained}",
         interval(flips.flipped, 100.0), number(flips.kappa), p_value(flips.p_value)]
        for k in range(len(study.config.thresholds))
        for comparison in study.comparisons
        for flips in [comparison.flips[k]]
    ]  # fmt: skip
    head = ["label", "second - first", "grasps", "positive in first", "in second", "lost", "gained",
            "flipped (%)", "kappa", "McNemar p"]  # fmt: skip
    return table(head, rows, words=range(2))


def _objects(study: "BiasStudy") -> str:
    found = {c.name: {o.object_id: o for o in c.objects} for c in study.comparisons}
    rows = []
    for one in study.engines.objects:
        others = [found[c.name].get(one.object_id) for c in study.comparisons]
        rows.append(
            [one.object_id, f"{one.grasps}", percent(one.success_first),
             *(percent(o.success_second) if o else "-" for o in others),
             *(percent(o.agreement) if o else "-" for o in others),
             *(number(o.kappa) if o else "-" for o in others)]
        )  # fmt: skip
    head = ["object", "grasps", f"success (%): {study.engines.first}",
            *_columns(study, "success (%)"), *_columns(study, "same outcome (%)"),
            *_columns(study, "kappa")]  # fmt: skip
    return table(head, rows)


def _object_details(study: "BiasStudy") -> Iterator[str]:
    """Every object's metrics, folded away; the floor's largest mean difference beside each."""
    floor = [{o.object_id: o for o in comparison.objects} for comparison in study.floor]
    head = ["metric", "pairs", f"mean {study.engines.first}", f"mean {study.engines.second}",
            "mean difference", "largest of the floor's", "limits of agreement", "Spearman",
            "Kendall", "KS distance", "largest KS of the floor's"]  # fmt: skip
    for one in study.engines.objects:
        own = [o[one.object_id].metrics for o in floor if one.object_id in o]
        rows = []
        for k, found in enumerate(one.metrics):
            if found.metric not in DRAWN:
                continue
            scale, _ = shown(found.metric)
            same = [metrics[k] for metrics in own]
            rows.append(
                [with_shown_unit(found.metric), f"{found.pairs}", number(scale * found.mean_first),
                 number(scale * found.mean_second), interval(found.difference, scale),
                 number(scale * _largest([abs(x.difference.mean) for x in same])),
                 f"{number(scale * found.limits.lower)} to {number(scale * found.limits.upper)}",
                 number(found.spearman), number(found.kendall), number(found.ks),
                 number(_largest([x.ks for x in same]))]
            )  # fmt: skip
        summary = f"<summary>{escape(one.object_id)}: all metrics</summary>"
        yield f"<details>{summary}{table(head, rows)}</details>"


def _largest(values: Sequence[float]) -> float:
    return max([value for value in values if np.isfinite(value)], default=float("nan"))


def _truth(study: "BiasStudy") -> str:
    engines = list(dict.fromkeys(row.engine for row in study.truth))
    by_case: dict[tuple[str, str], dict[str, str]] = {}
    expected: dict[tuple[str, str], tuple[float, str]] = {}
    for row in study.truth:
        case = (row.quantity, row.setting)
        expected[case] = (row.expected, row.unit)
        by_case.setdefault(case, {})[row.engine] = number(row.measured)
        by_case[case][f"{row.engine} error"] = number(row.error)
    rows = [
        [*case, expected[case][1] if expected[case][1] else "1 held, 0 lost",
         number(expected[case][0]), *(found[name] for name in engines),
         *(found[f"{name} error"] for name in engines)]
        for case, found in by_case.items()
    ]  # fmt: skip
    head = ["quantity", "setting", "unit", "closed form", *engines,
            *(f"error of {engine}" for engine in engines)]  # fmt: skip
    return table(head, rows, words=range(3))


def _failures(study: "BiasStudy") -> str:
    rows = [[f.object_id, f.stage, f.error, f.message] for f in study.failures]
    return table(["object", "run", "error", "message"], rows, words=range(4))
