"""Metric 7: whether the open gripper at a grasp touches the object or the table."""

import mujoco
import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.geometry import quaternion_matrix, quaternion_multiply, yaw_quaternion
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.layout import HEIGHT_QPOS, OBJECT_QPOS, GraspModel
from gmdx.scenes.scene import Scene


def collides(
    scene: Scene,
    grasps: PlanarGrasp,
    *,
    gripper: Gripper,
    model: GraspModel | None = None,
) -> Bool[Array, "n"]:
    """Whether the gripper, open to each grasp's width and placed there, touches anything.

    The geoms and hulls are those of the trials, and so is the collision detection.

    Args:
        scene: The object at rest.
        grasps: n grasps of that scene.
        gripper: The hand that is placed.
        model: The compiled gripper with this object, where the caller has it already.
    """
    if model is None:
        model = grasp_model(scene.object, gripper, scene.physics)
    positions, quaternions = object_in_gripper(scene, grasps.center, grasps.angle)
    fingers = gripper.finger_positions(grasps.width)
    body = model.model.geom_bodyid
    hand = (body != 0) & (body != model.object_body)
    data = mujoco.MjData(model.model)
    found = np.zeros(len(grasps), bool)
    for i in range(len(grasps)):
        data.qpos[OBJECT_QPOS] = np.concatenate([positions[i], quaternions[i]])
        data.qpos[HEIGHT_QPOS] = grasps.center[i, 2]
        data.qpos[list(model.finger_qpos)] = fingers[i]
        mujoco.mj_fwdPosition(model.model, data)
        found[i] = hand[data.contact.geom].any()
    return found


def object_in_gripper(
    scene: Scene, center: Float[Array, "n 3"], angle: Float[Array, "n"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 4"]]:
    """The object's positions (m) and quaternions in the frames of n grasps.

    A frame has the gripper's axes; its origin is on the table below the tool point.

    Args:
        scene: The object at rest.
        center: Tool points in the world, m.
        angle: Closing axes about the world's z, rad.
    """
    turn = yaw_quaternion(-angle)
    offset = scene.position - center * np.array([1.0, 1.0, 0.0])
    positions = np.einsum("nij,nj->ni", quaternion_matrix(turn), offset)
    quaternions = quaternion_multiply(turn, np.broadcast_to(scene.quaternion, turn.shape))
    return positions, quaternions
