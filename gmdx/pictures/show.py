"""The pictures of `gmdx show`: grasps of a scene, and the contacts of one grasp."""

from typing import TYPE_CHECKING, Any

import numpy as np

from gmdx.config import merge
from gmdx.dataset.read import Dataset, grasps_in
from gmdx.errors import UsageError
from gmdx.grasps.contact import closing_contacts
from gmdx.metrics.compute import MetricConfig
from gmdx.metrics.table import METRIC_NAMES
from gmdx.pictures.closeup import draw_closeup
from gmdx.pictures.figure import DrawConfig, metric_named
from gmdx.pictures.scene import draw_scene
from gmdx.scenes.gripper import Gripper, gripper_record, load_gripper
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.run import run_trials

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
        UsageError: There is no such metric or view.
        DatasetError: There is no such object or scene.
    """
    name = metric_named(metric).name
    images = dataset.scene(object_id, scene_id).images
    if not 0 <= view < len(images):
        raise UsageError(f"no view {view}; this scene has the views 0 to {len(images) - 1}")
    rows = dataset.grasps(object_id, scene_id)
    return draw_scene(
        images[view],
        grasps_in(rows),
        rows[name].to_numpy(),
        metric=name,
        title=f"{object_id}, scene {scene_id}",
        config=DrawConfig(most=most, pad_width=dataset.info["gripper"]["pad_size"][0]),
    )


def grasp_picture(
    dataset: Dataset, object_id: str, scene_id: int, grasp_id: int, *, gripper: Gripper
) -> "Figure":
    """One grasp from close up: where the pads would touch, and where they touched in its trial.

    The nominal trial is run again, since contacts are not stored; it ends as it did before.

    Args:
        dataset: Where the grasp is.
        object_id: The object.
        scene_id: Its scene.
        grasp_id: The grasp.
        gripper: The gripper that the dataset was made with.

    Raises:
        UsageError: There is no such grasp, or the gripper is another one.
        DatasetError: There is no such object or scene.
    """
    info = dataset.info
    rows = dataset.grasps(object_id, scene_id)
    known = rows["grasp_id"].to_numpy()
    if grasp_id not in known:
        raise UsageError(
            f"no grasp {grasp_id} in this scene; it has {len(known)} with the ids "
            f"{', '.join(map(str, known[:8]))}{', ...' if len(known) > 8 else ''}"
        )
    if gripper_record(gripper) != info["gripper"]:
        raise UsageError(
            f"the dataset was made with the gripper {info['gripper']['name']!r} and not with "
            f"this {gripper.name!r}: pass its description as --gripper FILE"
        )
    row = rows.slice(int(np.flatnonzero(known == grasp_id)[0]), 1)
    scene, grasp = dataset.scene(object_id, scene_id).scene, grasps_in(row)
    settings: dict[str, Any] = info["configuration"]
    lines = merge(MetricConfig(), settings["metric"]).lines
    trials = run_trials(
        scene,
        grasp,
        info["engine"],
        trials=1,
        gripper=gripper,
        config=merge(TrialConfig(), settings["trial"]),
    )
    return draw_closeup(
        scene,
        grasp,
        analytical=closing_contacts(scene, grasp, gripper=gripper, config=lines).pads,
        simulated=trials.contacts,
        metrics={name: row[name][0].as_py() for name in METRIC_NAMES},
        pad_size=(float(gripper.pad_size[0]), float(gripper.pad_size[1])),
        title=f"{object_id}, scene {scene_id}, {row['outcome'][0]}",
    )


def shipped_gripper(dataset: Dataset) -> Gripper:
    """The gripper that a dataset names, where it is a shipped one.

    Raises:
        GripperError: It is not.
    """
    return load_gripper(str(dataset.info["gripper"]["name"]))
