"""What charts are made of: a grid of panels, keys of colours, intervals."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.pictures.figure import INK, DrawConfig, new_figure

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

COLUMNS = 4  # of a grid of panels


def panels(
    count: int, *, height: int, margin: int, share_y: bool = False
) -> tuple["Figure", list["Axes"]]:
    """A figure with `count` panels, `COLUMNS` in a row.

    Args:
        count: Of panels.
        height: Of each, pixels.
        margin: Above all of them, pixels.
        share_y: All have one vertical axis.
    """
    rows = -(-count // COLUMNS)
    figure = new_figure(DrawConfig(width=1200, height=margin + height * rows))
    grid: list[Axes] = list(figure.subplots(rows, COLUMNS, squeeze=False, sharey=share_y).flat)
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure, grid[:count]


def label_panels(grid: Sequence["Axes"], below: str, beside: str) -> None:
    """Axis labels where a grid ends: under the last panel of a column, left of a row."""
    for k, axes in enumerate(grid):
        if k % COLUMNS == 0:
            axes.set_ylabel(beside, fontsize=8)
        if k + COLUMNS >= len(grid):
            axes.set_xlabel(below, fontsize=8)


def key(color: str, label: str, *, marker: str = "") -> "Line2D":
    """An entry of a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, label=label, marker=marker)


def legend_above(figure: "Figure", entries: Sequence["Artist"]) -> None:
    """One legend for all of a figure, in a row at its top."""
    figure.legend(handles=entries, loc="upper center", ncols=len(entries), frameon=False,
                  fontsize=10, labelcolor=INK)  # fmt: skip


def whiskers(
    axes: "Axes",
    at: Float[Array, "d"],
    half: Float[Array, "d"],
    rows: Float[Array, "d"],
    *,
    least: float = -np.inf,
) -> None:
    """Horizontal intervals; those that are not known are left out.

    Args:
        axes: Where.
        at: Their middles.
        half: Half their lengths.
        rows: Their heights.
        least: That there can be: no interval reaches below it.
    """
    known = np.isfinite(at) & np.isfinite(half)
    at, half = at[known], half[known]
    reach = np.stack([np.clip(half, 0.0, np.maximum(at - least, 0.0)), half])
    axes.errorbar(at, rows[known], xerr=reach, fmt="none", color=INK, capsize=3, linewidth=1)
