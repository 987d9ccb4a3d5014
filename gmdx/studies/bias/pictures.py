"""Pictures of one grasp's end in two engines: the object between the pads, side by side."""

from typing import TYPE_CHECKING

import numpy as np

from gmdx.dataset.read import grasps_in
from gmdx.geometry import quaternion_matrix
from gmdx.pictures.figure import INK, DrawConfig, new_figure
from gmdx.pictures.shading import SIDE, draw_pads, draw_surface, draw_table, tool_frame
from gmdx.studies.bias.pairs import trial_lists
from gmdx.trials.results import Snapshot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gmdx.studies.bias.result import BiasStudy

_MOMENTS = {
    Snapshot.START: "before the approach",
    Snapshot.CLOSING: "before closing",
    Snapshot.CLOSED: "after closing, its last record",
    Snapshot.HELD: "after the hold",
}
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
    pads = study.gripper.pad_size
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
        frame = tool_frame(
            quaternion_matrix(pose[moment, 3:]),
            pose[moment, :3],
            tool=tool[moment],
            axis=grasp.axis[0],
        )
        axes.set_xlim(-_REACH, _REACH)
        axes.set_ylim(-_REACH, _REACH)
        axes.set_aspect("equal")
        draw_surface(axes, SIDE, frame.points(obj.vertices)[obj.faces])
        draw_table(axes, float(tool[moment, 2]))
        opening = float(grasp.width[0] if opened else width)
        draw_pads(axes, SIDE, opening, (float(pads[0]), float(pads[1])))
        axes.tick_params(labelsize=8)
        axes.set_title(
            f"{study.engines.first if run.name == 'a' else study.engines.second}, "
            f"{_MOMENTS[moment]}\n{trial_lists(found.outcomes[row])}",
            fontsize=9.5, color=INK,
        )  # fmt: skip
        axes.set_xlabel("along the closing axis (mm)", fontsize=9)
        if run.name == "a":
            axes.set_ylabel(SIDE.up_label, fontsize=9)
    figure.tight_layout()
    return figure
