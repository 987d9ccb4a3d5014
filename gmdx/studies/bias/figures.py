"""Figures of a bias study: the engines' difference, always beside the noise floor."""

from typing import TYPE_CHECKING

import numpy as np

from gmdx.metrics.table import METRICS
from gmdx.pictures.charts import key, label_panels, legend_above, panels
from gmdx.pictures.figure import INK, DrawConfig, new_figure
from gmdx.trials.outcome import Outcome

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gmdx.studies.bias.result import BiasStudy

COLORS = {"a": "0.15", "b": "#c8553d", "seed": "#e0a030", "timestep": "#1f6fb2", "hulls": "#1b8a3a"}
_SCALES = {"m": (1e3, "mm"), "rad": (1e3, "mrad")}
_UNITS = {metric.name: metric.unit for metric in METRICS}
DRAWN = tuple(m.name for m in METRICS if m.kind != "priori" and not m.name.endswith("_norm"))
_OUTCOMES = [outcome.label.replace("_", " ") for outcome in Outcome]


def shown(metric: str) -> tuple[float, str]:
    """By what a metric is multiplied to be shown, and its unit then."""
    unit = _UNITS[metric]
    return _SCALES.get(unit, (1.0, unit))


def with_shown_unit(metric: str) -> str:
    """Name and unit for an axis."""
    unit = shown(metric)[1]
    return f"{metric} ({unit})" if unit else metric


def bias_figures(study: "BiasStudy") -> dict[str, "Figure"]:
    """Every figure of the report, by name, in its order."""
    from gmdx.studies.bias.pictures import disputed_picture

    found = {
        "outcomes": draw_outcomes(study),
        "differences": draw_differences(study),
        "bland_altman": draw_bland_altman(study),
        "distributions": draw_distributions(study),
        "objects": draw_objects(study),
        "flips": draw_flips(study),
    }
    if study.truth:
        found["truth"] = draw_truth(study)
    for rank, row in enumerate(study.disputed, start=1):
        found[f"disputed_{rank}"] = disputed_picture(study, row)
    return found


def draw_outcomes(study: "BiasStudy") -> "Figure":
    """Confusion matrices of the outcomes of all trials, a panel per comparison."""
    used = np.zeros(len(Outcome), bool)
    for comparison in study.comparisons:
        counts = comparison.outcomes.trials.counts
        used |= (counts.sum(axis=0) + counts.sum(axis=1)) > 0
    names = [name for name, some in zip(_OUTCOMES, used, strict=True) if some]
    panels = len(study.comparisons)
    figure = new_figure(DrawConfig(width=260 + 330 * panels, height=500))
    grid = figure.subplots(1, panels, squeeze=False)[0]
    for axes, comparison in zip(grid, study.comparisons, strict=True):
        counts = comparison.outcomes.trials.counts[used][:, used]
        share = counts / max(counts.sum(), 1)
        axes.imshow(np.sqrt(share), cmap="Blues", vmin=0, vmax=1)
        for i, j in np.ndindex(*counts.shape):
            color = "white" if share[i, j] > 0.4 else INK
            axes.text(j, i, f"{counts[i, j]}", ha="center", va="center", fontsize=9, color=color)
        ticks = np.arange(len(names))
        axes.set_xticks(ticks, names, rotation=40, ha="right", fontsize=8)
        axes.set_yticks(ticks, names if axes is grid[0] else [""] * len(names), fontsize=8)
        axes.set_title(f"to the right: {comparison.second}", fontsize=9.5, color=INK)
    grid[0].set_ylabel(f"downwards: {study.engines.first}", fontsize=9.5, color=INK)
    figure.suptitle("outcomes of all trials (numbers of trials)", fontsize=12, color=INK)
    figure.subplots_adjust(left=0.5 / (0.9 + panels), right=0.99, top=0.84, bottom=0.27)
    return figure


def draw_differences(study: "BiasStudy") -> "Figure":
    """Mean differences with their intervals, in standard deviations over the grasps."""
    figure = new_figure(DrawConfig(width=900, height=140 + 46 * len(DRAWN)))
    axes = figure.subplots()
    count = len(study.comparisons)
    for row, name in enumerate(DRAWN):
        values = study.rows["a"].values[name]
        values = values[np.isfinite(values)]
        scale = float(values.std()) if len(values) else 0.0
        for k, comparison in enumerate(study.comparisons):
            found = comparison.metric(name).difference
            if scale == 0 or not np.isfinite(found.mean):
                continue
            y = row + 0.7 * ((k + 0.5) / count - 0.5)
            color = COLORS[comparison.name]
            axes.plot(found.mean / scale, y, "o", color=color, markersize=5 if k == 0 else 3.5)
            if np.isfinite([found.low, found.high]).all():
                ends = np.array([found.low, found.high]) / scale
                axes.plot(ends, [y, y], color=color, linewidth=2 if k == 0 else 1.2)
        if row % 2:
            axes.axhspan(row - 0.5, row + 0.5, facecolor="0.96", zorder=0)
    axes.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    axes.set_yticks(np.arange(len(DRAWN)), DRAWN)
    axes.set_ylim(len(DRAWN) - 0.5, -0.5)
    axes.set_xlabel(
        f"mean difference from {study.engines.first}, 95 % interval clustered by object\n"
        "(standard deviations of the metric over the grasps)"
    )
    legend_above(figure, [key(COLORS[c.name], c.second, marker="o") for c in study.comparisons])
    figure.tight_layout(rect=(0, 0, 1, 0.96))
    return figure


def draw_bland_altman(study: "BiasStudy") -> "Figure":
    """Differences of the engines over their means, with limits; the floor's limits are shaded."""
    figure, grid = _metric_panels(height=250)
    for axes, name in zip(grid, DRAWN, strict=True):
        scale, _ = shown(name)
        a, b = (scale * study.rows[run].values[name] for run in ("a", "b"))
        found = study.engines.metric(name)
        axes.plot(0.5 * (a + b), b - a, ".", color=COLORS["b"], markersize=3.5, alpha=0.5, mew=0)
        limits = [c.metric(name).limits for c in study.floor]
        low = min([scale * x.lower for x in limits if np.isfinite(x.lower)], default=0.0)
        high = max([scale * x.upper for x in limits if np.isfinite(x.upper)], default=0.0)
        if study.floor:
            axes.axhspan(low, high, facecolor=COLORS["timestep"], alpha=0.18, linewidth=0)
        axes.axhline(0, color="0.6", linewidth=0.8)
        if np.isfinite(found.difference.mean):
            axes.axhline(scale * found.difference.mean, color=INK, linewidth=1.3)
        for edge in (found.limits.lower, found.limits.upper):
            if np.isfinite(edge):
                axes.axhline(scale * edge, color=INK, linewidth=1, linestyle="--")
        axes.set_title(with_shown_unit(name), fontsize=10, color=INK)
    label_panels(grid, "mean of the engines", study.engines.label)
    figure.suptitle(
        "solid: mean difference; dashed: 95 % limits of agreement; "
        "shaded: the noise floor's widest limits",
        fontsize=11, color=INK,
    )  # fmt: skip
    figure.tight_layout(rect=(0, 0, 1, 0.98))
    return figure


def draw_distributions(study: "BiasStudy") -> "Figure":
    """Distribution functions of every run; the engines' are thick."""
    figure, grid = _metric_panels(height=230)
    for axes, name in zip(grid, DRAWN, strict=True):
        scale, _ = shown(name)
        for run in reversed(study.runs):
            values = np.sort(scale * study.rows[run.name].values[name])
            values = values[np.isfinite(values)]
            if not len(values):
                continue
            share = np.arange(1, len(values) + 1) / len(values)
            width = 1.8 if run.name in "ab" else 1.0
            axes.step(values, share, where="post", color=COLORS[run.name], linewidth=width)
        axes.set_ylim(0, 1.02)
        axes.set_title(with_shown_unit(name), fontsize=10, color=INK)
    label_panels(grid, "value", "share of grasps below")
    legend_above(figure, [key(COLORS[r.name], r.label) for r in study.runs])
    figure.tight_layout(rect=(0, 0, 1, 0.97))
    return figure


def draw_objects(study: "BiasStudy") -> "Figure":
    """Success and agreement object by object."""
    names = [o.object_id for o in study.engines.objects]
    figure = new_figure(DrawConfig(width=1100, height=170 + 34 * len(names)))
    left, right = figure.subplots(1, 2, sharey=True)
    place = {name: k for k, name in enumerate(names)}

    def scatter(axes: "Axes", run: str, values: dict[str, float], label: str) -> None:
        points = [(v, place[k]) for k, v in values.items() if k in place and np.isfinite(v)]
        x, y = np.array(points).reshape(-1, 2).T
        main = run in ("a", "b")
        axes.plot(x, y, "o" if main else "|", color=COLORS[run], label=label, mew=2,
                  markersize=7 if main else 13, zorder=3 if main else 4)  # fmt: skip

    first = {o.object_id: o.success_first for o in study.engines.objects}
    scatter(left, "a", first, study.engines.first)
    for comparison in study.comparisons:
        second = {o.object_id: o.success_second for o in comparison.objects}
        scatter(left, comparison.name, second, comparison.second)
        agreement = {o.object_id: o.agreement for o in comparison.objects}
        scatter(right, comparison.name, agreement, comparison.second)
    for axes, label in (
        (left, "share of trials that succeed"),
        (right, f"share of trials that end as in {study.engines.first}"),
    ):
        axes.set_xlim(-0.03, 1.03)
        axes.set_xlabel(label, fontsize=10)
        axes.grid(axis="y", color="0.9")
    left.set_yticks(np.arange(len(names)), names, fontsize=9)
    left.set_ylim(len(names) - 0.5, -0.5)
    legend_above(figure, left.get_legend_handles_labels()[0])
    figure.tight_layout(rect=(0, 0, 1, 1 - 45 / (170 + 34 * len(names))))
    return figure


def draw_flips(study: "BiasStudy") -> "Figure":
    """Shares of labels that change at each threshold, with intervals."""
    figure = new_figure(DrawConfig(width=800, height=420))
    axes = figure.subplots()
    count = len(study.comparisons)
    for k, comparison in enumerate(study.comparisons):
        x = np.arange(len(comparison.flips)) + 0.8 * ((k + 0.5) / count - 0.5)
        share = np.array([100 * flips.flipped.mean for flips in comparison.flips])
        ends = 100 * np.array([[f.flipped.low, f.flipped.high] for f in comparison.flips])
        axes.bar(x, share, 0.72 / count, color=COLORS[comparison.name], label=comparison.second)
        axes.vlines(x, ends[:, 0].clip(0), ends[:, 1], color=INK, linewidth=1.2)
    names = [f"success $\\geq$ {threshold:g}" for threshold in study.config.thresholds]
    axes.set_xticks(np.arange(len(names)), names)
    axes.set_ylim(0, None)
    axes.set_ylabel(f"labels that differ from {study.engines.first} (%)")
    legend_above(figure, axes.get_legend_handles_labels()[0])
    figure.tight_layout(rect=(0, 0, 1, 0.93))
    return figure


def draw_truth(study: "BiasStudy") -> "Figure":
    """Measured forces over the closed form's, of both engines and of finer steps."""
    rows = [row for row in study.truth if row.unit == "N"]
    cases = list(dict.fromkeys((row.quantity, row.setting) for row in rows))
    figure = new_figure(DrawConfig(width=900, height=150 + 26 * len(cases)))
    axes = figure.subplots()
    colors = {run.engine: COLORS[run.name] for run in reversed(study.runs[:2])}
    colors |= {run.label: COLORS[run.name] for run in study.runs if run.name == "timestep"}
    for engine, color in colors.items():
        found = [r for r in rows if r.engine == engine]
        places = [cases.index((r.quantity, r.setting)) for r in found]
        main = engine in {run.engine for run in study.runs[:2]}
        axes.plot([r.ratio for r in found], places, "o" if main else "|", color=color,
                  markersize=6 if main else 11, mew=1 if main else 2, label=engine)  # fmt: skip
    axes.axvline(1, color="0.6", linewidth=0.8)
    axes.set_yticks(np.arange(len(cases)), [f"{q}, {s}" for q, s in cases], fontsize=9)
    axes.set_ylim(len(cases) - 0.5, -0.5)
    axes.grid(axis="y", color="0.92")
    axes.set_xlabel("measured force / closed form (no dot: the object was not held)")
    legend_above(figure, axes.get_legend_handles_labels()[0])
    figure.tight_layout(rect=(0, 0, 1, 0.93))
    return figure


def _metric_panels(*, height: int) -> tuple["Figure", list["Axes"]]:
    """A panel for each metric that is drawn."""
    figure, grid = panels(len(DRAWN), height=height, margin=80)
    for axes in grid:
        axes.tick_params(labelsize=8)
        axes.ticklabel_format(axis="both", style="sci", scilimits=(-3, 4))
    return figure, grid
