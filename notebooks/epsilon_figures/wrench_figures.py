"""Pictures of wrench spaces: a cut with epsilon's ball inside, and how hulls approach it."""

from typing import TYPE_CHECKING

import numpy as np

from epsilon_figures.stage import towards_viewer
from epsilon_figures.wrench_space import HullErrors, WrenchSection, WrenchSlice
from gmdx.arrays import Array, Bool, Float
from gmdx.pictures.figure import INK, DrawConfig, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

_SPACE, _BALL, _WORST = "#7f9fc4", "#e0a030", "#b3202a"
_CONES, _SURFACES, _CERTIFIED = "#c8553d", "#6a51a3", "#1b8a3a"
_ELEVATION, _AZIMUTH = 24.0, -62.0  # degrees, of the viewer
_LIGHT = np.array([0.25, -0.55, 0.80])
_SLICE_SIZE = DrawConfig(width=1100, height=340)
_ERRORS_SIZE = DrawConfig(width=1100, height=440)


def draw_wrench_slice(
    cut: WrenchSlice, section: WrenchSection, *, config: DrawConfig | None = None
) -> "Figure":
    """A pair's wrench space in three dimensions with the ball inside, and a plane through both.

    Wrenches are (force, torque / torque_scale) for a grip of 1, so all axes have no unit.

    Args:
        cut: The space in three dimensions.
        section: The same grasp in the plane of the first two of them.
        config: Size of the picture.
    """
    figure = new_figure(_SLICE_SIZE if config is None else config)
    axes: Axes3D = figure.add_axes((0.0, 0.0, 0.52, 0.84), projection="3d", computed_zorder=False)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_proj_type("ortho")
    # The worst direction points up; the body's own axes are (worst, torque, torque).
    body = np.roll(cut.surface, -1, axis=-1)
    radius = cut.epsilon.upper
    ball = radius * np.roll(cut.directions, -1, axis=-1)
    _show_body(axes, body, color=_SPACE, alpha=0.95, front=False, zorder=1)
    _show_axes(axes, body, zorder=2)
    _show_body(axes, ball, color=_BALL, alpha=1.0, front=True, zorder=3)
    _show_body(axes, body, color=_SPACE, alpha=0.28, front=True, zorder=4)
    axes.plot([0, 0], [0, 0], [0, radius], color=_WORST, linewidth=2.2, zorder=6)
    axes.plot([0], [0], [radius], "o", color=_WORST, markersize=6, zorder=6)
    axes.text(
        0.35 * radius, 0, 1.25 * radius, r"$\varepsilon\,u^*$", color=_WORST, fontsize=14, zorder=7
    )
    figure.text(0.02, 0.92, "cut by three of the six dimensions", fontsize=12.5, color=INK)
    figure.text(
        0.02, 0.04, r"$u^*$: worst direction;  $\tau_1$, $\tau_2$: torques across the closing line",
        fontsize=11, color=INK,
    )  # fmt: skip
    flat = figure.add_axes((0.59, 0.42, 0.39, 0.46))
    _show_section(flat, section)
    figure.text(0.59, 0.92, r"in the plane of $u^*$ and $\tau_1$", fontsize=12.5, color=INK)
    figure.legend(
        *flat.get_legend_handles_labels(), loc="lower left", bbox_to_anchor=(0.575, -0.01), ncols=2,
        fontsize=11, frameon=False, labelcolor=INK,
    )  # fmt: skip
    return figure


def draw_hull_errors(errors: HullErrors, *, config: DrawConfig | None = None) -> "Figure":
    """Error against the number of wrenches a contact, and against the time that it takes.

    Lines are medians over the grasps, bands on the left the middle eighty per cent. On the
    right is also what `gmdx.epsilon` proves: the median gap between its bounds, and the worst.

    Args:
        errors: Of at least one grasp.
        config: Size of the picture.
    """
    figure = new_figure(_ERRORS_SIZE if config is None else config)
    counts, times = (
        figure.add_axes((0.07, 0.13, 0.405, 0.76)),
        figure.add_axes((0.575, 0.13, 0.405, 0.76)),
    )
    curves = (
        ("linearised cones, by edges", errors.edges, errors.linearised_ms, errors.linearised,
         _CONES, "o"),
        ("limit surface, by points", errors.samples, errors.sampled_ms, errors.sampled,
         _SURFACES, "s"),
    )  # fmt: skip
    for name, number, milliseconds, error, color, marker in curves:
        percent = 100 * np.maximum(error, 1e-12)
        low, middle, high = np.percentile(percent, (10, 50, 90), axis=1)
        for axes, x in ((counts, number), (times, milliseconds)):
            axes.plot(x, middle, color=color, marker=marker, markersize=5, label=name)
        counts.fill_between(number, low, high, color=color, alpha=0.16, linewidth=0)
    gap = 100 * np.maximum(errors.gap, 1e-9)
    middle = float(np.median(gap))
    spread = np.array([[0.0], [gap.max() - middle]])
    times.errorbar(
        [errors.certified_ms], [middle], yerr=spread, color=_CERTIFIED, marker="D", markersize=7,
        capsize=4, linestyle="none", label="gap that gmdx.epsilon proves: median, bar to the worst",
    )  # fmt: skip
    counts.text(
        0.03, 0.04, f"gmdx.epsilon is proved within {gap.max():.0e} %, far below",
        transform=counts.transAxes, fontsize=11, color=_CERTIFIED,
    )  # fmt: skip
    for axes, lowest in ((counts, 1.0), (times, 1e-8)):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(lowest, 150 if axes is counts else 1e3)
        axes.grid(color="0.9", linewidth=0.7)
        axes.set_axisbelow(True)
        _plain(axes)
    counts.set_xticks(errors.edges)
    counts.set_xticks([], minor=True)
    counts.xaxis.set_major_formatter("{x:.0f}")
    for axis in (counts.yaxis, times.xaxis):
        axis.set_major_formatter("{x:g}")
    counts.set_xlabel("edges or points a contact", fontsize=11, color=INK)
    times.set_xlabel("processor time a grasp (ms)", fontsize=11, color=INK)
    counts.set_ylabel(r"relative error of $\varepsilon$ (%)", fontsize=11, color=INK)
    times.set_ylabel("relative error, or proved gap (%)", fontsize=11, color=INK)
    handles, names = times.get_legend_handles_labels()
    figure.legend(
        handles, names, loc="lower left", bbox_to_anchor=(0.06, 0.90), ncols=3, fontsize=11,
        frameon=False, labelcolor=INK,
    )  # fmt: skip
    return figure


def _show_body(
    axes: "Axes3D", grid: Float[Array, "r c 3"], *, color: str, alpha: float, front: bool,
    zorder: int,
) -> None:  # fmt: skip
    """The faces of a convex body that face the viewer, or those that face away."""
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    corners = np.stack([grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]], axis=2)
    normals = np.cross(
        corners[..., 2, :] - corners[..., 0, :], corners[..., 3, :] - corners[..., 1, :]
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    outward = np.sign(np.einsum("rca,rca->rc", normals, corners.mean(axis=2)))
    normals *= outward[..., None]
    shown = (normals @ towards_viewer(axes) > 0) == front
    light = _LIGHT / np.linalg.norm(_LIGHT)
    lit = normals @ light if front else -(normals @ light)
    shade = 0.62 + 0.38 * np.clip(lit[shown], 0, 1)
    colors = np.column_stack([shade[:, None] * np.array(to_rgb(color)), np.full(len(shade), alpha)])
    axes.add_collection3d(
        Poly3DCollection(
            corners[shown],
            facecolors=colors,
            linewidths=0,
            antialiased=False,
            zorder=zorder,
            clip_on=False,
        )
    )
    lines = _edges(grid, shown)
    axes.add_collection3d(
        Line3DCollection(lines, colors=(0.1, 0.15, 0.25), alpha=0.35 if front else 0.2,
                         linewidths=0.5, zorder=zorder, clip_on=False)
    )  # fmt: skip


def _edges(grid: Float[Array, "r c 3"], shown: Bool[Array, "p q"]) -> Float[Array, "n 2 3"]:
    """Every fourth meridian and parallel where the faces beside them are shown."""
    along = np.stack([grid[:-1, :-1], grid[1:, :-1]], axis=2)[:, ::4][shown[:, ::4]]
    around = np.stack([grid[:-1, :-1], grid[:-1, 1:]], axis=2)[::4][shown[::4]]
    return np.concatenate([along, around])


def _show_axes(axes: "Axes3D", body: Float[Array, "r c 3"], *, zorder: int) -> None:
    """Three lines through 0 with their names, one scale for all, and no box."""
    low, high = body.min(axis=(0, 1)), body.max(axis=(0, 1))
    half = np.maximum(-low, high)
    reach = max(half[0], half[1], 2.0 * high[2], -2.6 * low[2])  # room above and below
    starts, tips = -1.12 * half, 1.12 * half
    starts[2], tips[2] = 1.12 * low[2], high[2] + 0.35 * reach
    for i, name in enumerate((r"$\tau_1 / L$", r"$\tau_2 / L$", "$u^*$")):
        ends = np.zeros((2, 3))
        ends[:, i] = starts[i], tips[i]
        axes.plot(*ends.T, color="0.35", linewidth=0.9, zorder=zorder, clip_on=False)
        place = ends[1].copy()
        place[i] += 0.09 * reach
        axes.text(*place, name, fontsize=13, color=INK, zorder=9)
    for set_limits in (axes.set_xlim, axes.set_ylim, axes.set_zlim):
        set_limits(-reach, reach)
    axes.set_box_aspect((1, 1, 1), zoom=2.65)
    axes.set_axis_off()


def _show_section(axes: "Axes", section: WrenchSection) -> None:
    """The space, both hulls and the ball; the worst direction points up."""
    from matplotlib.patches import Circle, Polygon

    def outline(reach: Float[Array, "n"]) -> Float[Array, "n 2"]:
        return np.column_stack([reach * np.sin(section.angle), reach * np.cos(section.angle)])

    radius = section.epsilon.upper
    space = outline(section.reach)
    axes.add_patch(
        Polygon(space, facecolor=(_SPACE, 0.35), edgecolor="#34567f", linewidth=2,
                label="wrench space")
    )  # fmt: skip
    axes.plot(
        *outline(section.sampled).T, color=_SURFACES, linewidth=1.3, linestyle=(0, (1, 1.2)),
        label=f"limit surface, {section.samples} points",
    )  # fmt: skip
    axes.plot(
        *outline(section.linearised).T, color=_CONES, linewidth=1.3, linestyle=(0, (5, 2)),
        label=f"linearised cones, {section.edges} edges",
    )  # fmt: skip
    axes.add_patch(
        Circle((0, 0), radius, facecolor=(_BALL, 0.55), edgecolor="#8a5a00", linewidth=1.2,
               label=rf"ball, $\varepsilon$ = {radius:.4f}")
    )  # fmt: skip
    axes.plot([0, 0], [0, radius], color=_WORST, linewidth=1.8)
    axes.plot([0], [radius], "o", color=_WORST, markersize=5, label=r"$\varepsilon\,u^*$")
    wide, high = np.abs(space).max(axis=0)
    axes.set_xlim(-1.08 * wide, 1.08 * wide)
    axes.set_ylim(-1.3 * high, 1.3 * high)
    axes.set_aspect("equal", anchor="NW")
    axes.set_xlabel(r"torque $\tau_1 / L$ (N per newton of grip)", fontsize=11, color=INK)
    axes.set_ylabel("along $u^*$ (N/N)", fontsize=11, color=INK)
    _plain(axes)


def _plain(axes: "Axes") -> None:
    axes.tick_params(labelsize=10, color=INK, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_linewidth(0.6)
