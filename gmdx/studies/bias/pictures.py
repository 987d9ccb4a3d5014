"""Pictures of one grasp's end in two engines: the object between the pads, side by side."""

from typing import TYPE_CHECKING

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.dataset.read import grasps_in
from gmdx.geometry import quaternion_matrix
from gmdx.pictures.figure import INK, DrawConfig, new_figure
from gmdx.studies.bias.pairs import trial_lists
from gmdx.trials.results import Snapshot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gmdx.studies.bias.result import BiasStudy

_MOMENTS = {
    Snapshot.START: "before the approach",
    Snapshot.CLOSING: "before closing",
    Snapshot.CLOSED: "after closing, its last record",
    Snapshot.HELD: "after the hold",
}
_PADS = ("#1f6fb2", "#c8553d")  # colours of pad 0 and pad 1
_SURFACE = np.array([0.93, 0.90, 0.85])
_LIGHT = np.array([-0.40, -0.77, 0.50])  # unit, towards the light
_THICKNESS = 6.0  # mm, of a pad as drawn
_REACH = 62.0  # mm, from the tool point to the edge of a picture


def disputed_picture(study: "BiasStudy", row: int) -> "Figure":
    """The last pose that each engine recorded of a grasp's nominal trial, from the side.

    Args:
        study: Which has run it.
        row: Of the study's grasps.
    """
    index = study.choice.index
    k = int(index[row])
    object_id = study.choice.objects[k]
    local = study.choice.rows[k][row - int(np.searchsorted(index, k))]
    rows = study.dataset.grasps(object_id).slice(local, 1)
    grasp, scene_id = grasps_in(rows), int(rows["scene_id"][0].as_py())
    obj = study.dataset.object(object_id)
    figure = new_figure(DrawConfig(width=1000, height=570))
    title = f"{object_id}, scene {scene_id}, grasp {int(grasp.grasp_id[0])}"
    figure.suptitle(title, fontsize=12, color=INK)
    for axes, run in zip(figure.subplots(1, 2, sharey=True), study.runs[:2], strict=True):
        found = study.rows[run.name]
        pose, tool = found.poses[row], found.tool[row]
        known = np.flatnonzero(np.isfinite(pose).all(axis=1) & np.isfinite(tool).all(axis=1))
        moment = Snapshot(int(known[-1]))
        width = found.values["sim_width"][row]
        opened = moment < Snapshot.CLOSED or not np.isfinite(width)
        _show(
            axes,
            obj.vertices[obj.faces],
            pose[moment],
            tool[moment],
            angle=float(grasp.angle[0]),
            opening=1e3 * float(grasp.width[0] if opened else width),
            pad_height=1e3 * float(study.gripper.pad_size[1]),
        )
        axes.set_title(
            f"{study.engines.first if run.name == 'a' else study.engines.second}, "
            f"{_MOMENTS[moment]}\n{trial_lists(found.outcomes[row])}",
            fontsize=9.5, color=INK,
        )  # fmt: skip
        axes.set_xlabel("along the closing axis (mm)", fontsize=9)
        if run.name == "a":
            axes.set_ylabel("above the tool point (mm)", fontsize=9)
    figure.tight_layout()
    return figure


def _show(
    axes: "Axes",
    triangles: Float[Array, "f 3 3"],
    pose: Float[Array, "7"],
    tool: Float[Array, "3"],
    *,
    angle: float,
    opening: float,
    pad_height: float,
) -> None:
    """The shaded surface in the tool's frame, far triangles first, the pads and the table.

    Args:
        axes: In mm.
        triangles: m, in the object's frame.
        pose: Of the object in the world: m, wxyz.
        tool: m, the tool point in the world.
        angle: rad, of the closing axis.
        opening: mm, between the pads.
        pad_height: mm, of a pad's face.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Rectangle

    cos, sin = np.cos(angle), np.sin(angle)
    to_tool = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    seen = 1e3 * ((triangles @ quaternion_matrix(pose[3:]).T + pose[:3] - tool) @ to_tool.T)
    normals = np.cross(seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0])
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    facing = np.flatnonzero(normals[:, 1] < 0)  # seen against tool y
    order = facing[np.argsort(-seen[facing, :, 1].mean(axis=1), kind="stable")]
    shade = 0.62 + 0.38 * np.clip(normals[order] @ _LIGHT, 0, 1)
    colors = shade[:, None] * _SURFACE
    axes.add_collection(
        PolyCollection(list(seen[order][:, :, [0, 2]]), facecolors=colors, edgecolors=colors,
                       linewidths=0.6),
        autolim=False,
    )  # fmt: skip
    table = -1e3 * tool[2]
    if table > -_REACH:
        axes.axhspan(-2 * _REACH, table, facecolor="0.8", zorder=0)
        axes.axhline(table, color="0.4", linewidth=1)
    for side, color in zip((-1, 1), _PADS, strict=True):
        left = 0.5 * opening if side > 0 else -0.5 * opening - _THICKNESS
        axes.add_patch(
            Rectangle((left, -0.5 * pad_height), _THICKNESS, pad_height, facecolor=color,
                      alpha=0.85, zorder=6)
        )  # fmt: skip
    axes.set_xlim(-_REACH, _REACH)
    axes.set_ylim(-_REACH, _REACH)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=8)
