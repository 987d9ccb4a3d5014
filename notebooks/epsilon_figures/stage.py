"""The stage for pictures of loads: an object with the contacts of a pair, and arrows on it."""

from typing import TYPE_CHECKING, Any

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import MetricError
from gmdx.metrics.epsilon.wrench import tangents
from gmdx.pictures.closeup import cone_points
from gmdx.pictures.figure import INK
from gmdx.scenes.scene import Scene
from gmdx.studies.epsilon import Contacts

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

PADS = ("#1f6fb2", "#c8553d")  # colours of contacts 0 and 1
_SURFACE = np.array([0.80, 0.77, 0.71])
_AHEAD = 28.0  # degrees, of the viewer above the table
_ASIDE = 62.0  # degrees, of the viewer from the closing line
_HEAD = 0.007  # m, length of an arrow's head at most


def draw_stage(
    figure: "Figure", box: tuple[float, float, float, float], scene: Scene, contacts: Contacts
) -> "Axes3D":
    """The object in its pose with contacts, friction cones and closing line; no axes.

    Args:
        figure: Where to draw.
        box: Left, bottom, width and height, as shares of the figure.
        scene: The object as it lies.
        contacts: Two, in the object's frame.

    Raises:
        MetricError: There are not two contacts.
    """
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axes: Axes3D = figure.add_axes(box, projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    line = scene.rotation @ closing_line(contacts)
    azimuth = float(np.degrees(np.arctan2(line[1], line[0]))) + _ASIDE
    axes.view_init(elev=_AHEAD, azim=azimuth)
    towards = towards_viewer(axes)
    triangles = (scene.object.vertices @ scene.rotation.T)[scene.object.faces]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    light = towards + np.array([0.0, 0.0, 0.6])
    light += 0.5 * np.cross([0.0, 0.0, 1.0], towards)
    shade = 0.6 + 0.4 * np.abs(normals @ light) / np.linalg.norm(light)
    for front, alpha in ((False, 0.55), (True, 0.42)):
        shown = (normals @ towards > 0) == front
        colors = np.column_stack([shade[shown, None] * _SURFACE, np.full(shown.sum(), alpha)])
        axes.add_collection3d(
            Poly3DCollection(
                triangles[shown], facecolors=colors, linewidths=0, antialiased=False, zorder=1,
                clip_on=False,
            )
        )  # fmt: skip
    points = contacts.points @ scene.rotation.T
    axes.plot(*points.T, color=INK, linewidth=1.0, linestyle=(0, (6, 3)), zorder=3, clip_on=False)
    inward = contacts.normals @ scene.rotation.T
    for point, normal, color in zip(points, inward, PADS, strict=True):
        rim = cone_points(point, normal, contacts.friction)
        sides = np.stack(
            [np.broadcast_to(point, rim[1:].shape), rim[1:], np.roll(rim[1:], -1, 0)], 1
        )
        axes.add_collection3d(
            Poly3DCollection(sides, facecolors=color, alpha=0.22, linewidths=0, zorder=2)
        )
        axes.plot(
            *point[:, None], "o", color=color, markersize=7, markeredgecolor="white", zorder=6
        )
    axes.plot([0], [0], [0], "o", color="white", markeredgecolor=INK, markersize=8, zorder=7)
    axes.plot([0], [0], [0], "+", color=INK, markersize=8, zorder=8)
    reach = scene.object.radius
    for set_limits in (axes.set_xlim, axes.set_ylim, axes.set_zlim):
        set_limits(-reach, reach)
    axes.set_box_aspect((1, 1, 1), zoom=1.3)
    axes.set_axis_off()
    return axes


def draw_arrow(
    axes: "Axes3D", start: Float[Array, "3"], vector: Float[Array, "3"], *, color: str
) -> None:
    """A straight arrow with a cone for its head."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    length = float(np.linalg.norm(vector))
    if length == 0.0:
        return
    along = vector / length
    head = min(_HEAD, 0.45 * length)
    tip, base = start + vector, start + vector - head * along
    t1, t2 = tangents(along)
    turn = np.linspace(0.0, 2.0 * np.pi, 25)[:, None]
    rim = base + 0.38 * head * (np.cos(turn) * t1 + np.sin(turn) * t2)
    axes.plot(*np.stack([start, base]).T, color=color, linewidth=2.6, zorder=5, clip_on=False)
    cone = np.stack([np.broadcast_to(tip, rim[1:].shape), rim[:-1], rim[1:]], axis=1)
    axes.add_collection3d(
        Poly3DCollection(cone, facecolors=color, edgecolors=color, linewidths=0.4, zorder=5,
                         clip_on=False)
    )  # fmt: skip


def draw_turning(axes: "Axes3D", vector: Float[Array, "3"], *, color: str) -> None:
    """A torque: its axis through 0, and an arrow around it that turns as the torque does."""
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        return
    along = vector / length
    front = np.cross(np.cross(along, towards_viewer(axes)), along)
    size = float(np.linalg.norm(front))
    # Its head is where the viewer sees it from the side; seen end on, anywhere.
    t1 = front / size if size > 1e-9 else tangents(along)[0]
    t2 = np.cross(along, t1)
    axes.plot(
        *np.stack([-0.9 * vector, 0.9 * vector]).T, color=color, linewidth=1.2,
        linestyle=(0, (8, 2, 1, 2)), zorder=5, clip_on=False,
    )  # fmt: skip
    turn = np.linspace(-1.4 * np.pi, 0.1 * np.pi, 80)[:, None]
    middle, radius = 0.78 * vector, 0.2 * length
    arc = middle + radius * (np.cos(turn) * t1 + np.sin(turn) * t2)
    axes.plot(*arc.T, color=color, linewidth=2.6, zorder=5, clip_on=False)
    ahead = arc[-1] - arc[-2]
    draw_arrow(axes, arc[-2], _HEAD * ahead / np.linalg.norm(ahead), color=color)


def towards_viewer(axes: "Axes3D") -> Float[Array, "3"]:
    """The direction of the viewer."""
    up, turn = np.deg2rad(axes.elev), np.deg2rad(axes.azim)
    return np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])


def draw_legend(figure: "Figure", loads: dict[str, str]) -> None:
    """Names of what is on the stage, and of loads by their colours."""
    from matplotlib.legend_handler import HandlerTuple
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    dots = [Line2D([], [], color=c, marker="o", linestyle="none", markersize=7) for c in PADS]
    handles: dict[str, Any] = {
        "contacts": tuple(dots),
        "friction cones": tuple(Patch(color=color, alpha=0.3) for color in PADS),
        "closing line": Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (6, 3))),
        **{name: Line2D([], [], color=color, linewidth=2.6) for name, color in loads.items()},
        "centre of mass": Line2D(
            [], [], color="white", marker="o", markeredgecolor=INK, linestyle="none", markersize=8
        ),
    }
    figure.legend(
        list(handles.values()), list(handles), loc="upper left", bbox_to_anchor=(0.01, 1.0),
        ncols=3, fontsize=10.5, frameon=False, labelcolor=INK, columnspacing=1.2,
        handler_map={tuple: HandlerTuple(ndivide=None, pad=0.2)},
    )  # fmt: skip


def closing_line(contacts: Contacts) -> Float[Array, "3"]:
    """The direction from contact 0 to contact 1.

    Raises:
        MetricError: There are not two contacts.
    """
    if len(contacts.points) != 2:
        raise MetricError(f"this picture shows a pair, not {len(contacts.points)} contacts")
    line: Array = contacts.points[1] - contacts.points[0]
    return line / float(np.linalg.norm(line))
