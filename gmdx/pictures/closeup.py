"""A close-up of one grasp: the object between the pads, the contacts, their friction cones."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import DatasetError
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.metrics.epsilon import hull_corners
from gmdx.metrics.table import METRICS
from gmdx.pictures.figure import INK, DrawConfig, metric_named, new_figure
from gmdx.pictures.shading import (
    PAD_THICKNESS,
    PADS,
    SIDE,
    TOP,
    ToolFrame,
    View,
    draw_pads,
    draw_surface,
    draw_table,
    tool_frame,
)
from gmdx.scenes.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TRIAL = "#1b8a3a"
_SECTION = "0.25"
_CONE = 0.008  # m, height of a friction cone as drawn
_NORMAL = 0.004  # m, length of a normal as drawn
_MARGIN = 0.004  # m, around what must be seen


def draw_closeup(
    scene: Scene,
    grasp: PlanarGrasp,
    *,
    analytical: PadContacts,
    simulated: PadContacts | None = None,
    metrics: Mapping[str, float] | None = None,
    pad_size: tuple[float, float] = (0.02, 0.02),
    title: str = "",
    config: DrawConfig | None = None,
) -> "Figure":
    """One grasp in the gripper's tool frame, from above and from the side, with its numbers.

    The object is shown as it lay before closing, with its section through the tool point in
    bold. Contacts are where they are on the object. A pad's friction cone stands on the mean
    of its contact points, around the mean of their normals.

    Args:
        scene: The object at rest.
        grasp: A batch of one.
        analytical: Its contacts by intersection-line analysis, in the object's frame.
        simulated: Its contacts in the trial, in the object's frame.
        metrics: Values by name, for the text beside the pictures.
        pad_size: Of a pad's face along tool y and tool z, m.
        title: Of the picture.
        config: Size of the picture.

    Raises:
        UsageError: A metric is unknown.
        DatasetError: A batch does not hold exactly one grasp.
    """
    config = DrawConfig() if config is None else config
    counts = [len(grasp), len(analytical), *([] if simulated is None else [len(simulated)])]
    if set(counts) != {1}:
        sizes = ", ".join(map(str, counts))
        raise DatasetError(f"a close-up shows one grasp; got batches of {sizes}")
    values = {metric_named(name).name: value for name, value in (metrics or {}).items()}
    frame = tool_frame(scene.rotation, scene.position, tool=grasp.center[0], axis=grasp.axis[0])
    opening, height = float(grasp.width[0]), float(grasp.center[0, 2])

    figure = new_figure(config)
    box_width, box_height = (0.57 if values else 0.89), 0.355
    ranges = [_vertical(view, frame, scene, pad_size, height) for view in (TOP, SIDE)]
    across = opening + 2 * (PAD_THICKNESS + _MARGIN)
    # One scale for both pictures: millimetres per pixel.
    scale = 1e3 * max(
        across / (box_width * config.width),
        *((high - low) / (box_height * config.height) for low, high in ranges),
    )
    for view, vertical, bottom in zip((TOP, SIDE), ranges, (0.51, 0.08), strict=True):
        box = (0.075, bottom, box_width, box_height)
        axes = figure.add_axes(box)
        _frame_picture(axes, view, vertical, scale, box, config)
        _show_object(axes, view, frame, scene, height)
        _show_gripper(axes, view, opening, pad_size)
        friction = scene.object.friction
        _show_contacts(axes, view, frame, analytical, friction, colors=PADS, marker="o")
        if simulated is not None:
            _show_contacts(axes, view, frame, simulated, friction, colors=(_TRIAL,) * 2, marker="D")
    _legend(figure, scene.object.friction, with_trial=simulated is not None)
    heading = ", ".join(part for part in (title, f"grasp {int(grasp.grasp_id[0])}") if part)
    figure.text(0.075, 0.95, heading, fontsize=15, color=INK)
    if values:
        figure.text(
            0.68, 0.868, _numbers(values), family="monospace", fontsize=9.5, va="top",
            linespacing=1.32, color=INK,
        )  # fmt: skip
    return figure


def _vertical(
    view: View, frame: ToolFrame, scene: Scene, pad_size: tuple[float, float], height: float
) -> tuple[float, float]:
    """What the picture must show upwards: the pad, and around it the object down to the table."""
    pad = pad_size[view.up - 1]
    reached = frame.points(scene.object.vertices)[:, view.up]
    low = max(float(reached.min()), -1.2 * pad)
    if view is SIDE:
        low = max(-height, -1.6 * pad)
    high = min(float(reached.max()), 1.2 * pad)
    return min(low, -0.5 * pad) - _MARGIN, max(high, 0.5 * pad) + _MARGIN


def _frame_picture(
    axes: "Axes", view: View, vertical: tuple[float, float], scale: float,
    box: tuple[float, float, float, float], config: DrawConfig,
) -> None:  # fmt: skip
    """Limits, labels and ticks; `scale` is in mm a pixel."""
    half_width = 0.5 * scale * box[2] * config.width
    half_height = 0.5 * scale * box[3] * config.height
    middle = 0.5e3 * sum(vertical)
    axes.set_xlim(-half_width, half_width)
    axes.set_ylim(middle - half_height, middle + half_height)
    axes.set_facecolor("white")
    axes.set_ylabel(view.up_label, fontsize=11, color=INK)
    if view is SIDE:
        axes.set_xlabel("along the closing axis (mm)", fontsize=11, color=INK)
    axes.tick_params(labelsize=10, color=INK, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
    axes.text(
        0.012, 0.965, view.label, transform=axes.transAxes, va="top", fontsize=11.5, color=INK,
        zorder=20, bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 2},
    )  # fmt: skip


def _show_object(axes: "Axes", view: View, frame: ToolFrame, scene: Scene, height: float) -> None:
    """The shaded surface, the table where it is seen, and the section in bold."""
    from matplotlib.collections import LineCollection

    triangles = frame.points(scene.object.vertices)[scene.object.faces]
    draw_surface(axes, view, triangles)
    if view is SIDE:
        draw_table(axes, height)
    section = section_lines(triangles, 3 - view.up)
    axes.add_collection(
        LineCollection(
            list(view.flat(section)), colors=_SECTION, linewidths=1.8, capstyle="round", zorder=4
        ),
        autolim=False,
    )


def section_lines(triangles: Float[Array, "f 3 3"], axis: int) -> Float[Array, "m 2 3"]:
    """Where the plane through the origin across an axis cuts triangles: the ends of each cut."""
    start, end = triangles, np.roll(triangles, -1, axis=1)
    below, next_below = start[:, :, axis] < 0, end[:, :, axis] < 0
    cut = below != next_below
    step = np.where(cut, start[:, :, axis] - end[:, :, axis], 1.0)
    points = start + (start[:, :, axis] / step)[..., None] * (end - start)
    # A plane meets two edges of a triangle or none.
    lines: Array = points[cut].reshape(-1, 2, 3)
    return lines


def _show_gripper(axes: "Axes", view: View, opening: float, pad_size: tuple[float, float]) -> None:
    """The open pads as boxes, and the lines along which they close."""
    draw_pads(axes, view, opening, pad_size)
    half, pad = 0.5e3 * opening, 1e3 * pad_size[view.up - 1]
    axes.plot([-half, half], [0, 0], color=INK, linewidth=1.0, linestyle=(0, (6, 3)), zorder=6)
    for edge in (-0.5 * pad, 0.5 * pad):
        axes.plot(
            [-half, half], [edge, edge], color=INK, linewidth=0.8, linestyle=(0, (1, 3)), zorder=6
        )


def _show_contacts(
    axes: "Axes", view: View, frame: ToolFrame, contacts: PadContacts, friction: float, *,
    colors: tuple[str, ...], marker: str,
) -> None:  # fmt: skip
    """Contact points with their normals, and one friction cone a pad."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Polygon

    for pad, color in enumerate(colors):
        valid = contacts.valid[0, pad]
        if not valid.any():
            continue
        points = frame.points(contacts.points[0, pad][valid])
        normals = frame.directions(contacts.normals[0, pad][valid])
        mean = normals.mean(axis=0)
        length = float(np.linalg.norm(mean))
        if length > 1e-6:
            outline = view.flat(cone_points(points.mean(axis=0), mean / length, friction))
            cone = Polygon(
                outline[hull_corners(outline)], facecolor=color, alpha=0.22, edgecolor="none",
                zorder=5,
            )  # fmt: skip
            axes.add_patch(cone)
        flat = view.flat(points)
        arrows = np.stack([flat, view.flat(points + _NORMAL * normals)], axis=1)
        axes.add_collection(
            LineCollection(list(arrows), colors=color, linewidths=1.2, zorder=7), autolim=False
        )
        axes.scatter(
            flat[:, 0], flat[:, 1], s=30, marker=marker, facecolor=color, edgecolor="white",
            linewidth=0.7, zorder=8,
        )  # fmt: skip


def cone_points(
    apex: Float[Array, "3"], normal: Float[Array, "3"], friction: float
) -> Float[Array, "m 3"]:
    """The apex and the rim of a friction cone, m; its half angle is arctan(friction)."""
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)
    turn = 2 * np.pi * np.arange(64)[:, None] / 64
    rim = normal + friction * (np.cos(turn) * first + np.sin(turn) * second)
    return np.concatenate([apex[None], apex + _CONE * rim])


def _legend(figure: "Figure", friction: float, *, with_trial: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    def dot(color: str, marker: str) -> Line2D:
        return Line2D([], [], color=color, marker=marker, markersize=6, linewidth=1.2)

    handles = {
        "pad 0": Patch(color=PADS[0], alpha=0.85),
        "pad 1": Patch(color=PADS[1], alpha=0.85),
        "first touch, normal": dot(PADS[0], "o"),
    }
    if with_trial:
        handles["touched in the trial"] = dot(_TRIAL, "D")
    handles[f"friction cone ({friction:g})"] = Patch(color=PADS[0], alpha=0.22)
    handles["closing line"] = Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (6, 3)))
    handles["section"] = Line2D([], [], color=_SECTION, linewidth=1.8)
    figure.legend(
        list(handles.values()), list(handles), loc="lower left", bbox_to_anchor=(0.068, 0.898),
        ncols=len(handles), fontsize=10, frameon=False, borderpad=0, borderaxespad=0,
        handlelength=1.6, handletextpad=0.5, columnspacing=1.2, labelcolor=INK,
    )  # fmt: skip


def _numbers(values: Mapping[str, float]) -> str:
    """The metrics under their kinds, a line each; "-" for what does not exist."""
    lines: list[str] = []
    for kind in ("priori", "posteriori", "comparative"):
        rows = [m for m in METRICS if m.kind == kind and m.name in values]
        if rows:
            lines += ["", kind] if lines else [kind]
        for metric in rows:
            value = values[metric.name]
            number = f"{value:.4g}" if np.isfinite(value) else "-"
            lines.append(f"  {metric.name:<22}{number:>10} {metric.unit}")
    return "\n".join(lines)
