"""The picture of a scene: its depth image with grasps as rectangles, coloured by a metric."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float, UInt8
from gmdx.errors import DatasetError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.pictures.figure import (
    INK,
    DrawConfig,
    check_colormap,
    metric_named,
    new_figure,
    with_unit,
)
from gmdx.scenes.camera import OBJECT, DepthImage

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHARES = frozenset({"g_coll", "sim_coll", "sim_success"})  # coloured from 0 to 1, whatever occurs
_NO_VALUE = "0.42"
_AXES = (0.07, 0.165, 0.775, 0.705)  # of the image: left, bottom, width, height in the figure
_BAR_LENGTHS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # m


def project(points: Float[Array, "*n 3"], image: DepthImage) -> Float[Array, "*n 2"]:
    """Where the image shows points of the world: (u, v), pixels.

    Raises:
        DatasetError: A point lies behind the camera.
    """
    seen = (points - image.pose[:3, 3]) @ image.pose[:3, :3] @ image.intrinsics.T
    if seen.size and float(seen[..., 2].min()) <= 0:
        raise DatasetError("a grasp lies behind the camera: the camera's pose is wrong")
    pixels: Array = seen[..., :2] / seen[..., 2:]
    return pixels


def grasp_rectangles(grasps: PlanarGrasp, pad_width: float) -> Float[Array, "n 4 3"]:
    """Corners of each grasp in the world, m: its width along the closing axis, the pad's across.

    The edge from corner 0 to 1 is pad 0, that from 2 to 3 is pad 1.
    """
    axis = grasps.axis
    across = np.cross([0.0, 0.0, 1.0], axis)
    along = 0.5 * grasps.width[:, None] * axis
    aside = 0.5 * pad_width * across
    offsets = np.stack([-along + aside, -along - aside, along - aside, along + aside], axis=1)
    corners: Array = grasps.center[:, None] + offsets
    return corners


def draw_scene(
    image: DepthImage,
    grasps: PlanarGrasp,
    values: Float[Array, "n"],
    *,
    metric: str,
    title: str = "",
    highlight: Sequence[int] = (),
    config: DrawConfig | None = None,
) -> "Figure":
    """The depth image of a scene with grasps drawn as rectangles and coloured by a metric.

    Thick edges are the pads, thin ones the opening between them (as in the Cornell and
    Jacquard data sets). Grasps without a value are grey and dashed, and are counted. Of many
    grasps, `config.most` are drawn, spread over places and angles; the title says so.

    Args:
        image: One view of the scene.
        grasps: n grasps of that scene.
        values: The metric of each; NaN where it does not exist.
        metric: Its name, one of the 36.
        title: Of the picture, for example object and scene.
        highlight: Grasp ids to be outlined in black and named.
        config: Size and style.

    Raises:
        UsageError: The metric is unknown, or a grasp to highlight is not there.
        DatasetError: Grasps and values differ in number, or a grasp lies behind the camera.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    config = DrawConfig() if config is None else config
    described = metric_named(metric)
    if len(values) != len(grasps):
        raise DatasetError(f"{len(values)} values of {metric} for {len(grasps)} grasps")
    missing = sorted(set(highlight) - set(grasps.grasp_id.tolist()))
    if missing:
        raise UsageError(
            f"no grasp {missing[0]} in this scene; it has the grasps {_spans(grasps.grasp_id)}"
        )
    check_colormap(config.colormap)
    total, without = len(grasps), int((~np.isfinite(values)).sum())
    limits = _limits(metric, values[np.isfinite(values)])
    if config.most is not None and total > config.most:
        chosen = _spread(grasps, max(config.most, len(set(highlight))), highlight)
        grasps, values = grasps[chosen], values[chosen]
    finite = np.isfinite(values)
    corners = project(grasp_rectangles(grasps, config.pad_width), image)

    figure = new_figure(config)
    axes = figure.add_axes(_AXES)
    window = _window(image.segmentation, corners, config, _AXES[2] / _AXES[3])
    _show_depth(figure, axes, image, window)
    colors = ScalarMappable(Normalize(*limits), config.colormap)
    rgba = colors.to_rgba(np.where(finite, values, 0.0))
    order = [
        *np.flatnonzero(~finite),
        *np.argsort(np.where(finite, values, np.inf))[: finite.sum()],
    ]
    _show_grasps(axes, corners[order], rgba[order], finite[order])
    for grasp_id in highlight:
        _show_highlight(axes, corners[grasps.grasp_id == grasp_id][0], grasp_id)

    bar = figure.colorbar(colors, cax=figure.add_axes((0.868, _AXES[1], 0.022, _AXES[3])))
    bar.set_label(with_unit(described), fontsize=13, color=INK)
    bar.ax.tick_params(labelsize=11, color=INK, labelcolor=INK)
    bar.outline.set_linewidth(0.6)
    count = f"{total} grasp{'' if total == 1 else 's'}"
    if without:
        count += f", {without} without a value (grey)"
    if len(grasps) < total:
        count += f", {len(grasps)} drawn"
    heading = ", ".join(part for part in (title, count) if part)
    figure.text(_AXES[0], 0.945, heading, fontsize=15, color=INK)
    figure.text(_AXES[0], 0.9, f"{metric}: {described.definition}", fontsize=11, color="0.35")
    return figure


def _spread(grasps: PlanarGrasp, count: int, first: Sequence[int]) -> Array:
    """Indices of `count` grasps far from each other, those with the ids `first` among them.

    Each further one is the farthest from all before; half a turn counts as much as the largest
    distance between two grasps.
    """
    places = grasps.center[:, :2] - grasps.center[:, :2].mean(axis=0)
    turn = 2 * grasps.angle
    reach = max(float(np.linalg.norm(places, axis=1).max()), 1e-9)
    points = np.column_stack([places / reach, np.cos(turn), np.sin(turn)])
    chosen = [int(np.flatnonzero(grasps.grasp_id == grasp_id)[0]) for grasp_id in set(first)]
    chosen = chosen if chosen else [0]
    gap = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
    while len(chosen) < count:
        gap[chosen] = -1.0
        chosen.append(int(gap.argmax()))
        gap = np.minimum(gap, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.sort(chosen)


def _spans(ids: Array) -> str:
    """Numbers in short: "0 to 63", or a list of the first ones."""
    listed = sorted(ids.tolist())
    if not listed:
        return "none"
    if listed == list(range(listed[0], listed[-1] + 1)):
        return f"{listed[0]} to {listed[-1]}"
    return ", ".join(map(str, listed[:12])) + (", ..." if len(listed) > 12 else "")


def _limits(metric: str, values: Float[Array, "n"]) -> tuple[float, float]:
    """What the ends of the colour bar stand for."""
    if metric in _SHARES or not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    if high - low > 1e-9 * max(abs(low), abs(high)):
        return low, high
    # All alike: the one value lies in the middle of the bar.
    spread = 0.1 * abs(high) if high else 0.1
    return low - spread, high + spread


def _window(
    segmentation: UInt8[Array, "H W"], corners: Float[Array, "n 4 2"], config: DrawConfig,
    share: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Left, right, top, bottom of what is shown, pixels, in the shape of the axes."""
    height, width = segmentation.shape
    rows, columns = np.nonzero(segmentation == OBJECT)
    points = np.concatenate([np.column_stack([columns, rows]), corners.reshape(-1, 2)])
    if not config.crop or not len(points):
        return -0.5, width - 0.5, height - 0.5, -0.5
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, 1.16 * np.maximum(high - low, 20.0)
    aspect = share * config.width / config.height
    half_width = 0.5 * max(size[0], aspect * size[1])
    half_height = half_width / aspect
    # Stay on the image, or on what reaches beyond it, where there is room.
    half = np.array([half_width, half_height])
    first = np.minimum(low - 0.04 * size, -0.5)
    last = np.maximum(high + 0.04 * size, np.array([width, height]) - 0.5)
    roomy = 2 * half <= last - first
    u, v = np.where(
        roomy, np.minimum(np.maximum(middle, first + half), last - half), 0.5 * (first + last)
    )
    return u - half_width, u + half_width, v + half_height, v - half_height


def _show_depth(
    figure: "Figure", axes: "Axes", image: DepthImage, window: tuple[float, float, float, float]
) -> None:
    """The depth image in grey, near dark, with its own scale, the object's outline and a ruler."""
    from matplotlib.colors import LinearSegmentedColormap

    left, right, bottom, top = window
    height, width = image.depth.shape
    rows = slice(max(0, int(np.floor(top))), min(height, int(np.ceil(bottom)) + 1))
    columns = slice(max(0, int(np.floor(left))), min(width, int(np.ceil(right)) + 1))
    visible = image.depth[rows, columns]
    if not visible.size:
        visible = image.depth
    greys = LinearSegmentedColormap.from_list("near_dark", ["0.42", "0.97"])
    low, high = float(visible.min()), float(visible.max())
    shown = axes.imshow(
        image.depth, cmap=greys, vmin=low, vmax=max(high, low + 1e-3), interpolation="nearest"
    )
    mask = (image.segmentation == OBJECT).astype(float)
    if 0 < mask.sum() < mask.size:
        axes.contour(mask, levels=[0.5], colors=[INK], linewidths=0.8)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_facecolor("0.9")
    axes.set_xlabel("u (pixels)", fontsize=11, color=INK)
    axes.set_ylabel("v (pixels)", fontsize=11, color=INK)
    axes.tick_params(labelsize=10, color=INK, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
    bar = figure.colorbar(
        shown, cax=figure.add_axes((_AXES[0], 0.075, 0.27, 0.016)), orientation="horizontal"
    )
    bar.ax.text(
        1.03, 0.5, "depth (m)", transform=bar.ax.transAxes, va="center", fontsize=11, color=INK
    )
    bar.ax.tick_params(labelsize=10, color=INK, labelcolor=INK)
    bar.outline.set_linewidth(0.6)
    table = image.depth[image.segmentation != OBJECT]
    _show_ruler(axes, image, float(np.median(table)) if table.size else high)


def _show_ruler(axes: "Axes", image: DepthImage, depth: float) -> None:
    """A bar of a round length in the lower right corner, true at that depth."""
    left, right = axes.get_xlim()
    bottom, top = axes.get_ylim()
    per_metre = image.intrinsics[0, 0] / depth
    fitting = [length for length in _BAR_LENGTHS if length * per_metre < 0.22 * (right - left)]
    length = fitting[-1] if fitting else _BAR_LENGTHS[0]
    end = right - 0.035 * (right - left)
    start = end - length * per_metre
    v = bottom - 0.04 * (bottom - top)
    axes.plot([start, end], [v, v], color="white", linewidth=7, solid_capstyle="butt", zorder=8)
    axes.plot([start, end], [v, v], color=INK, linewidth=4, solid_capstyle="butt", zorder=9)
    axes.text(
        end, v - 0.015 * (bottom - top), f"{length * 1e3:g} mm on the table",
        ha="right", va="bottom", fontsize=11, color=INK, zorder=9,
        bbox={"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 1.5},
    )  # fmt: skip


def _show_grasps(
    axes: "Axes",
    corners: Float[Array, "n 4 2"],
    rgba: Float[Array, "n 4"],
    finite: Array,
) -> None:
    """Each grasp as four edges over a white casing that sets it off from what lies below."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba

    edges, colors, widths, styles = [], [], [], []
    for corner, color, has_value in zip(corners, rgba, finite, strict=True):
        pads, sides = corner.reshape(2, 2, 2), corner[[[1, 2], [3, 0]]]
        own = tuple(color) if has_value else to_rgba(_NO_VALUE)
        style: str | tuple[float, tuple[float, ...]] = "solid" if has_value else (0, (4, 2))
        edges += [*sides, *pads, *sides, *pads]
        colors += [(1, 1, 1, 0.8)] * 4 + [own] * 4
        widths += [2.6, 2.6, 6.0, 6.0, 1.3, 1.3, 4.2, 4.2]
        styles += ["solid"] * 4 + [style] * 2 + ["solid"] * 2
    lines = LineCollection(
        edges, colors=colors, linewidths=widths, linestyles=styles, capstyle="butt", zorder=5
    )
    axes.add_collection(lines, autolim=False)


def _show_highlight(axes: "Axes", corners: Float[Array, "4 2"], grasp_id: int) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(corners, fill=False, edgecolor="black", linewidth=1.6, zorder=6))
    highest = corners[corners[:, 1].argmin()]
    axes.annotate(
        f"grasp {grasp_id}", highest, xytext=(0, 8), textcoords="offset points", fontsize=12,
        ha="center", color="black", zorder=10,
        bbox={"facecolor": "white", "alpha": 0.85, "linewidth": 0, "pad": 2},
    )  # fmt: skip
