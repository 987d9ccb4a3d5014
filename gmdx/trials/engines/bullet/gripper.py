"""A gripper as PyBullet builds it: links and shapes, from the compiled MuJoCo model."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pybullet

from gmdx.errors import GripperError
from gmdx.geometry import matrix_quaternion
from gmdx.scenes.layout import MOUNT, PREFIX, GraspModel

FIXED = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]  # a frame that is its parent's: m, xyzw


@dataclass(frozen=True)
class Link:
    """One link of the gripper: a mover, or a geom that is fixed to it."""

    parent: int  # -1: the world
    position: list[float]  # m, in the tool's frame at joint positions 0
    orientation: list[float]  # xyzw
    mass: float = 0.0  # kg
    axis: list[float] | None = None  # that it slides along
    pad: int | None = None  # which pad it is
    shape: dict[str, Any] | None = None  # arguments of `createCollisionShape`


def gripper_links(scene: GraspModel) -> list[Link]:
    """Movers and geoms, depth first, as Bullet numbers them."""
    model, names = scene.model, scene.gripper.pads
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)  # fingers at 0, the tool point at the origin
    pads = [model.geom(PREFIX + name).id for name in names]
    carriers = [_mover(scene, int(body)) for body in model.geom_bodyid]
    masses = _masses(scene)

    links = [Link(-1, *FIXED, mass=masses[0], axis=[0.0, 0.0, 1.0])]
    for mover, axis in ((1, [1.0, 0.0, 0.0]), (2, [-1.0, 0.0, 0.0]), (0, None)):
        parent = 0
        if axis is not None:
            parent = len(links)
            links.append(Link(0, *FIXED, mass=masses[mover], axis=axis))
        for geom in np.flatnonzero(np.array(carriers) == mover).tolist():
            w, x, y, z = matrix_quaternion(data.geom_xmat[geom].reshape(3, 3)).tolist()
            links.append(
                Link(
                    parent,
                    data.geom_xpos[geom].tolist(),
                    [x, y, z, w],
                    pad=pads.index(geom) if geom in pads else None,
                    shape=_geometry(scene, geom),
                )
            )
    return links


def _mover(scene: GraspModel, body: int) -> int:
    """What carries a body of the compiled model: 0 the tool, 1 and 2 the fingers, -1 nothing."""
    model = scene.model
    fingers = [int(model.joint(PREFIX + name).bodyid[0]) for name in scene.gripper.joints]
    while body:
        if body in fingers:
            return 1 + fingers.index(body)
        if body == model.body(MOUNT).id:
            return 0
        body = int(model.body_parentid[body])
    return -1


def _geometry(scene: GraspModel, geom: int) -> dict[str, Any]:
    model, kind, p = scene.model, mujoco.mjtGeom, pybullet
    size = model.geom_size[geom].tolist()
    match kind(model.geom_type[geom]):
        case kind.mjGEOM_BOX:
            return {"shapeType": p.GEOM_BOX, "halfExtents": size}
        case kind.mjGEOM_SPHERE:
            return {"shapeType": p.GEOM_SPHERE, "radius": size[0]}
        case kind.mjGEOM_CAPSULE:
            return {"shapeType": p.GEOM_CAPSULE, "radius": size[0], "height": 2 * size[1]}
        case kind.mjGEOM_CYLINDER:
            return {"shapeType": p.GEOM_CYLINDER, "radius": size[0], "height": 2 * size[1]}
        case kind.mjGEOM_MESH:
            mesh = model.mesh(int(model.geom_dataid[geom]))
            vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
            return {"shapeType": p.GEOM_MESH, "vertices": vertices.tolist()}
        case other:
            raise GripperError(
                f"gripper {scene.gripper.name}: geom '{model.geom(geom).name}' is a "
                f"{other.name}; the engine bullet knows box, sphere, capsule, cylinder and mesh"
            )


def _masses(scene: GraspModel) -> list[float]:
    """Of the tool and of both fingers, kg; a finger's includes its drive's reflected inertia."""
    model = scene.model
    masses = [0.0, 0.0, 0.0]
    for body in range(model.nbody):
        mover = _mover(scene, body)
        if mover >= 0:
            masses[mover] += float(model.body_mass[body])
    for mover, name in enumerate(scene.gripper.joints, start=1):
        masses[mover] += float(model.dof_armature[model.joint(PREFIX + name).dofadr[0]])
    return masses


def finger_limits(scene: GraspModel) -> list[tuple[float, float]]:
    """Each finger's range, closing positive, m."""
    found = []
    for name, sign in zip(scene.gripper.joints, scene.gripper.signs, strict=True):
        joint = scene.model.joint(PREFIX + name)
        low, high = joint.range if scene.model.jnt_limited[joint.id] else (-1.0, 1.0)
        found.append((min(sign * low, sign * high), max(sign * low, sign * high)))
    return found
