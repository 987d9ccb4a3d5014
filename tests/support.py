"""Objects and scenes of known shape, made without the preparation that other tests check."""

from dataclasses import replace

import numpy as np
import trimesh

from gmdx.geometry import matrix_quaternion, quaternion_matrix, quaternion_multiply, yaw_quaternion
from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def mesh_object(
    mesh: trimesh.Trimesh,
    *,
    object_id: str = "mesh",
    mass: float = 0.1,
    friction: float = 0.8,
    hulls: list[np.ndarray] | None = None,
    box: OrientedBox | None = None,
) -> ObjectModel:
    """A closed mesh as an object; one convex hull and the bounding box unless others are given."""
    center = mesh.center_mass
    vertices = np.asarray(mesh.vertices, float) - center
    if box is None:
        to_origin, extents = trimesh.bounds.oriented_bounds(mesh)
        to_box = np.linalg.inv(to_origin)
        order = np.argsort(-extents)
        box = OrientedBox(to_box[:3, 3] - center, to_box[:3, :3][:, order], extents[order])
    if hulls is None:
        hulls = [np.asarray(mesh.convex_hull.vertices, float)]
    return ObjectModel(
        object_id=object_id,
        vertices=vertices,
        faces=np.asarray(mesh.faces, int),
        hulls=tuple(hull - center for hull in hulls),
        mass=mass,
        friction=friction,
        inertia=np.asarray(mesh.moment_inertia) * (mass / mesh.volume),
        scale=1.0,
        box=box,
        stable_poses=StablePoses(UPRIGHT[None], np.array([-vertices[:, 2].min()]), np.array([1.0])),
    )


def box_object(extents: tuple[float, float, float], **options: object) -> ObjectModel:
    """A cuboid with edges `extents` m along its own x, y and z."""
    order = np.argsort(-np.array(extents), kind="stable")
    box = OrientedBox(np.zeros(3), np.eye(3)[:, order], np.array(extents)[order])
    options = {"object_id": "box", "box": box} | options
    return mesh_object(trimesh.creation.box(extents), **options)  # type: ignore[arg-type]


def sphere_object(radius: float, *, subdivisions: int = 4, **options: object) -> ObjectModel:
    """A ball of `radius` m, as a fine polyhedron whose vertices lie on the sphere."""
    box = OrientedBox(np.zeros(3), np.eye(3), np.full(3, 2 * radius))
    options = {"object_id": "sphere", "box": box} | options
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return mesh_object(mesh, **options)  # type: ignore[arg-type]


def cylinder_object(radius: float, height: float, **options: object) -> ObjectModel:
    """An upright cylinder of 64 sides."""
    options = {"object_id": "cylinder"} | options
    mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=64)
    return mesh_object(mesh, **options)  # type: ignore[arg-type]


def resting_scene(
    obj: ObjectModel,
    *,
    quaternion: np.ndarray = UPRIGHT,
    yaw: float = 0.0,
    scene_id: int = 0,
    seed: int = 0,
    physics: PhysicsConfig | None = None,
) -> Scene:
    """The object in the given orientation, then turned by `yaw` rad, its lowest point on z = 0."""
    turned = quaternion_multiply(yaw_quaternion(np.array(yaw)), np.asarray(quaternion, float))
    lowest = float((obj.vertices @ quaternion_matrix(turned).T)[:, 2].min())
    physics = PhysicsConfig() if physics is None else physics
    return Scene(obj, scene_id, seed, np.array([0.0, 0.0, -lowest]), turned, 0.0, physics)


def scaled_object(obj: ObjectModel, factor: float) -> ObjectModel:
    """The same object, `factor` times as large, with the same mass."""
    return replace(
        obj,
        vertices=obj.vertices * factor,
        hulls=tuple(hull * factor for hull in obj.hulls),
        inertia=obj.inertia * factor**2,
        scale=obj.scale * factor,
        box=OrientedBox(obj.box.center * factor, obj.box.axes, obj.box.extents * factor),
        stable_poses=replace(obj.stable_poses, heights=obj.stable_poses.heights * factor),
    )


def turned_quaternion(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """Quaternion (wxyz) of a rotation by `angle` rad about `axis`."""
    matrix = trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]
    return matrix_quaternion(matrix)
