"""The pictures of `gmdx show`: grasps of a scene, and the contacts of one grasp."""

from typing import TYPE_CHECKING

import numpy as np

from gmdx.dataset.contacts import contacts_in
from gmdx.dataset.read import Dataset, grasps_in
from gmdx.errors import UsageError
from gmdx.metrics.table import METRIC_NAMES
from gmdx.pictures.closeup import draw_closeup
from gmdx.pictures.figure import DrawConfig, metric_named
from gmdx.pictures.scene import draw_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def scene_picture(
    dataset: Dataset,
    object_id: str,
    scene_id: int,
    *,
    metric: str = "sim_success",
    view: int = 0,
    most: int | None = DrawConfig().most,
) -> "Figure":
    """The depth image of a scene with its grasps, coloured by a metric.

    Args:
        dataset: Where the scene is.
        object_id: The object.
        scene_id: Its scene.
        metric: Name of the metric.
        view: Which of the scene's images.
        most: Grasps drawn at most, spread over the scene; None: all.

    Raises:
        UsageError: There is no such metric, object, scene or view.
        DatasetError: A file is damaged.
    """
    name = metric_named(metric).name
    image = dataset.image(object_id, scene_id, view)
    rows = dataset.grasps(object_id, scene_id)
    return draw_scene(
        image,
        grasps_in(rows),
        rows[name].to_numpy(),
        metric=name,
        title=f"{object_id}, scene {scene_id}",
        config=DrawConfig(most=most, pad_width=dataset.info["gripper"]["pad_size"][0]),
    )


def grasp_picture(dataset: Dataset, object_id: str, scene_id: int, grasp_id: int) -> "Figure":
    """One grasp from close up: where the pads would touch, and where they touched in its trial.

    Args:
        dataset: Where the grasp is.
        object_id: The object.
        scene_id: Its scene.
        grasp_id: The grasp.

    Raises:
        UsageError: There is no such grasp.
        DatasetError: There is no such object or scene, or its files are damaged.
    """
    rows = dataset.grasps(object_id, scene_id)
    known = rows["grasp_id"].to_numpy()
    if grasp_id not in known:
        raise UsageError(
            f"no grasp {grasp_id} in this scene; it has {len(known)} with the ids "
            f"{', '.join(map(str, known[:8]))}{', ...' if len(known) > 8 else ''}"
        )
    row = rows.slice(int(np.flatnonzero(known == grasp_id)[0]), 1)
    grasp = grasps_in(row)
    contacts = dataset.contacts(object_id, scene_id, grasp_id=grasp_id)
    return draw_closeup(
        dataset.scene(object_id, scene_id).scene,
        grasp,
        analytical=contacts_in(contacts, grasp.grasp_id, "analytical"),
        simulated=contacts_in(contacts, grasp.grasp_id, "simulative"),
        metrics={name: row[name][0].as_py() for name in METRIC_NAMES},
        pad_size=tuple(dataset.info["gripper"]["pad_size"]),
        title=f"{object_id}, scene {scene_id}, {row['outcome'][0]}",
    )
