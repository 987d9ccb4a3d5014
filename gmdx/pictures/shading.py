"""An object between the pads as the pictures show it: shaded, from above or from the side."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PADS = ("#1f6fb2", "#c8553d")  # colours of pad 0 and pad 1
PAD_THICKNESS = 0.006  # m, of a pad as drawn
_SURFACE = np.array([0.93, 0.90, 0.85])  # RGB, in full light


@dataclass(frozen=True)
class View:
    """A direction to look from, in the gripper's tool frame."""

    label: str
    up: int  # tool axis that points up in the picture; the closing axis points right
    towards: Float[Array, "3"]  # the viewer
    light: Float[Array, "3"]  # unit, towards the light
    up_label: str

    def flat(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Points of the tool frame (m) in the picture, mm."""
        seen: Array = 1e3 * points[..., [0, self.up]]
        return seen


TOP = View(
    "from above", 1, np.array([0.0, 0.0, 1.0]), np.array([-0.40, 0.50, 0.77]),
    "across the pads (mm)",
)  # fmt: skip
SIDE = View(
    "from the side", 2, np.array([0.0, -1.0, 0.0]), np.array([-0.40, -0.77, 0.50]),
    "above the tool point (mm)",
)  # fmt: skip


@dataclass(frozen=True)
class ToolFrame:
    """From the object's frame to the tool's: the closing axis is x, up is z."""

    rotation: Float[Array, "3 3"]  # object to tool
    origin: Float[Array, "3"]  # m, the tool point in the object's frame

    def points(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Points of the object's frame in the tool's, m."""
        placed: Array = (points - self.origin) @ self.rotation.T
        return placed

    def directions(self, vectors: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Directions of the object's frame in the tool's."""
        turned: Array = vectors @ self.rotation.T
        return turned


def tool_frame(
    rotation: Float[Array, "3 3"],
    position: Float[Array, "3"],
    *,
    tool: Float[Array, "3"],
    axis: Float[Array, "3"],
) -> ToolFrame:
    """The tool's frame of a grasp on an object.

    Args:
        rotation: Of the object, to the world.
        position: Of the object's origin in the world, m.
        tool: The tool point in the world, m.
        axis: The closing axis in the world, unit, horizontal.
    """
    up = np.array([0.0, 0.0, 1.0])
    return ToolFrame(
        np.stack([axis, np.cross(up, axis), up]) @ rotation, (tool - position) @ rotation
    )


def draw_surface(axes: "Axes", view: View, triangles: Float[Array, "f 3 3"]) -> None:
    """Triangles (tool frame, m) that face the viewer, shaded, far ones first."""
    from matplotlib.collections import PolyCollection

    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    facing = np.flatnonzero(normals @ view.towards > 0)
    order = facing[np.argsort(triangles[facing].mean(axis=1) @ view.towards)]
    shade = 0.62 + 0.38 * np.clip(normals[order] @ view.light, 0, 1)
    colors = shade[:, None] * _SURFACE
    axes.add_collection(
        PolyCollection(
            list(view.flat(triangles[order])), facecolors=colors, edgecolors=colors, linewidths=0.8
        ),
        autolim=False,
    )


def draw_table(axes: "Axes", height: float) -> None:
    """The table seen from the side, down to the picture's lower edge.

    Args:
        axes: With their limits set, mm.
        height: m, of the tool point above the table.
    """
    low, table = axes.get_ylim()[0], -1e3 * height
    if table > low:
        axes.axhspan(low - 1, table, facecolor="0.8", zorder=2)
        axes.axhline(table, color="0.4", linewidth=1, zorder=3)


def draw_pads(axes: "Axes", view: View, opening: float, pad_size: tuple[float, float]) -> None:
    """The pads as boxes.

    Args:
        axes: In mm.
        view: From where.
        opening: m, between the pads' faces.
        pad_size: m, of a face along tool y and tool z.
    """
    from matplotlib.patches import Rectangle

    half, height, thickness = 0.5e3 * opening, 1e3 * pad_size[view.up - 1], 1e3 * PAD_THICKNESS
    for side, color in zip((-1, 1), PADS, strict=True):
        corner = (half if side > 0 else -half - thickness, -0.5 * height)
        axes.add_patch(
            Rectangle(
                corner, thickness, height, facecolor=color, edgecolor=color, alpha=0.85, zorder=6
            )
        )
