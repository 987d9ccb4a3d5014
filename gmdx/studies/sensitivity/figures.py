"""Pictures of a sensitivity study: tornado plots of its indices, and curves one at a time."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.pictures.charts import COLUMNS, panels, whiskers
from gmdx.pictures.figure import INK, DrawConfig, new_figure
from gmdx.studies.sensitivity.indices import Indices
from gmdx.studies.sensitivity.parameters import SEED, Parameter
from gmdx.studies.sensitivity.runs import BASELINE, OUTPUTS, Output

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RAISES, LOWERS, SHARE, FLOOR = "tab:red", "tab:blue", "tab:purple", "0.88"
_TITLES = {
    "morris": "mean absolute effect of a parameter's whole range (mu*), 95 % interval",
    "sobol": "share of the variance: total (bar) and alone (diamond), 95 % intervals",
    "oat": "largest minus smallest value over a parameter's range, others at their default",
}


def draw_tornado(method: str, output: Output, indices: Indices) -> "Figure":
    """Parameters by how much the output depends on them, the largest on top.

    The grey band is what `seed` reaches: chance alone does as much.

    Args:
        method: With which the indices were estimated.
        output: Of which.
        indices: One a parameter; without any, the picture says why.
    """
    count = len(indices.names)
    figure = new_figure(DrawConfig(width=900, height=170 + 30 * count))
    axes = figure.add_subplot()
    known = np.isfinite(indices.total)
    order = np.argsort(np.where(known, indices.total, -np.inf), kind="stable")
    at = np.arange(count, dtype=float)
    total, half, main = (
        values[order] for values in (indices.total, indices.total_half, indices.main)
    )
    signs = [RAISES if m > 0 else LOWERS for m in main]
    colors = [SHARE] * count if method == "sobol" else signs
    axes.barh(at, np.nan_to_num(total), color=colors, alpha=0.75, height=0.65)
    whiskers(axes, total, half, at, least=0.0)
    if method == "sobol":
        axes.plot(main, at, "D", color=INK, markersize=5)
        whiskers(axes, main, indices.main_half[order], at - 0.2)
    noise = indices.names.index(SEED) if SEED in indices.names else None
    if noise is not None and known[noise]:
        reach = indices.total[noise] + np.nan_to_num(indices.total_half[noise])
        axes.axvspan(0.0, reach, color=FLOOR, zorder=0)
    axes.set_yticks(at, [indices.names[k] for k in order])
    unit = "" if method == "sobol" or not output.unit else f" ({output.unit})"
    axes.set_xlabel(f"{_TITLES[method]}{unit}", fontsize=9)
    axes.set_title(f"what the {_noun(output)} depends on", fontsize=11)
    axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
    if method != "sobol" and known.any():
        axes.barh([0], [0], color=RAISES, alpha=0.75, label="a larger value raises it")
        axes.barh([0], [0], color=LOWERS, alpha=0.75, label="a larger value lowers it")
        axes.legend(loc="lower right", fontsize=8)
    if not known.any():
        why = "it is the same in all runs" if indices.constant else "too many runs have no value"
        axes.text(0.5, 0.5, f"no indices: {why}", transform=axes.transAxes, ha="center")
    figure.tight_layout()
    return figure


def draw_curves(output: Output, parameters: Sequence[Parameter], runs: "pd.DataFrame") -> "Figure":
    """One panel a parameter: the output over its range, all others at their default.

    Thin lines are objects, the thick one is the mean of those that have a value throughout;
    the dotted line is the default, the grey band the range that other seeds give.

    Args:
        output: Which.
        parameters: Of the study.
        runs: Its runs.
    """
    figure, grid = panels(len(parameters), height=250, margin=60, share_y=True)
    names = [parameter.name for parameter in parameters]
    floor = mean_curve(runs, names.index(SEED), SEED, output.name)[1]
    for k, (axes, parameter) in enumerate(zip(grid, parameters, strict=True)):
        if np.isfinite(floor).any():
            axes.axhspan(np.nanmin(floor), np.nanmax(floor), color=FLOOR, zorder=0)
        for _, own in runs[runs.block == k].groupby("object_id"):
            axes.plot(own[parameter.name], own[output.name], color="0.6", linewidth=0.8)
        axes.plot(*mean_curve(runs, k, parameter.name, output.name), color=INK, marker=".")
        default = float(runs[runs.block == BASELINE][parameter.name].iloc[0])
        if parameter.name != SEED:
            axes.axvline(default, color="0.4", linestyle=":")
        if parameter.scale == "log" or parameter.levels:
            axes.set_xscale("log")
        if parameter.name == SEED:
            axes.set_xticks([])
        else:
            _ticks(axes, parameter, default)
        unit = f" ({parameter.unit})" if parameter.unit else ""
        axes.set_xlabel(f"{parameter.name}{unit}", fontsize=9)
        axes.tick_params(labelsize=7)
        if k % COLUMNS == 0:
            unit = f" ({output.unit})" if output.unit else ""
            axes.set_ylabel(f"{output.name}{unit}", fontsize=9)
    figure.tight_layout()
    return figure


def mean_curve(
    runs: "pd.DataFrame", block: int, parameter: str, output: str
) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
    """Places of one parameter and the mean over the objects that have a value at all of them."""
    own = runs[runs.block == block].sort_values(["object_id", "run"])
    objects = own.object_id.nunique()
    places = own[parameter].to_numpy().reshape(objects, -1)[0]
    values = own[output].to_numpy().reshape(objects, -1)
    whole = values[~np.isnan(values).any(axis=1)]
    return places, whole.mean(axis=0) if len(whole) else np.full(len(places), np.nan)


def figures(
    method: str,
    parameters: Sequence[Parameter],
    indices: Mapping[str, Indices],
    runs: "pd.DataFrame",
) -> dict[str, "Figure"]:
    """All pictures of a study, by name.

    Args:
        method: Of the study.
        parameters: Of the study.
        indices: By output, of all objects together.
        runs: Of the study.
    """
    found = {
        f"tornado_{output.name}": draw_tornado(method, output, indices[output.name])
        for output in OUTPUTS
    }
    if method == "oat":
        found |= {
            f"curves_{output.name}": draw_curves(output, parameters, runs) for output in OUTPUTS
        }
    return found


def _ticks(axes: "Axes", parameter: Parameter, default: float) -> None:
    """Ticks at the range's ends, and at the default where it is not too close to them."""
    marks = [parameter.low, default, parameter.high]
    low, at, high = marks if parameter.scale == "linear" else np.log(marks)
    if not 0.1 < (at - low) / (high - low) < 0.9:
        del marks[1]
    axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
    axes.minorticks_off()


def _noun(output: Output) -> str:
    return {
        "success": "success rate",
        "force": "push-out force",
        "moved": "object's shift during closing",
        "rotation": "object's rotation during closing",
        "stability": "object's rotation in the lift",
    }[output.name]
