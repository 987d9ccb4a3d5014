"""What a sampler needs to know of a gripper's shape, read off its compiled model."""

from dataclasses import dataclass

import mujoco
import numpy as np

from gmdx.arrays import Array, Float
from gmdx.scenes.layout import HEIGHT_QPOS, GraspModel


@dataclass(frozen=True)
class HandShape:
    """Boxes around a gripper's fingers and palm, relative to its tool point."""

    thickness: float  # m, of a finger along the closing axis, behind its pad's face
    half_span: float  # m, of a finger across the closing axis
    palm: float  # m, the palm's height above the tool point; infinite without a palm


def hand_shape(grasp_model: GraspModel) -> HandShape:
    """Bounds of the fingers and of everything else that the gripper consists of."""
    model, gripper = grasp_model.model, grasp_model.gripper
    data = mujoco.MjData(model)
    data.qpos[HEIGHT_QPOS] = 0.0
    data.qpos[list(grasp_model.finger_qpos)] = gripper.finger_positions(np.array(gripper.gap))
    mujoco.mj_kinematics(model, data)
    joints = [list(model.jnt_qposadr).index(address) for address in grasp_model.finger_qpos]
    fingers = [int(model.jnt_bodyid[joint]) for joint in joints]
    reach, span, palm = 0.0, 0.0, np.inf
    for geom in range(model.ngeom):
        chain = _ancestors(model, int(model.geom_bodyid[geom]))
        if grasp_model.object_body in chain or chain == [0]:
            continue
        low, high = _bounds(model, data, geom)
        if set(fingers) & set(chain):
            side = 1.0 if fingers[1] in chain else -1.0
            reach = max(reach, float(max(side * low[0], side * high[0])))
            span = max(span, float(max(-low[1], high[1])))
        else:
            palm = min(palm, float(low[2]))
    return HandShape(thickness=reach - 0.5 * gripper.gap, half_span=span, palm=palm)


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """The body and those it hangs from, up to the world (left out unless it is the body)."""
    chain = [body]
    while (body := int(model.body_parentid[body])) != 0:
        chain.append(body)
    return chain


def _bounds(
    model: mujoco.MjModel, data: mujoco.MjData, geom: int
) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Corners of a geom's axis-aligned box in the world, m."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    center = data.geom_xpos[geom] + rotation @ model.geom_aabb[geom, :3]
    half = np.abs(rotation) @ model.geom_aabb[geom, 3:]
    return center - half, center + half
