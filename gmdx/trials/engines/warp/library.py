"""Several objects in one model of MuJoCo Warp: what they share, and what differs by world.

Every object keeps its own compiled `MjModel`. A library model has their gripper and table and a
fixed number of slots for hulls; the meshes of all objects lie one after the other in its arrays,
and each world is given one object's numbers. Whatever else differs between the compiled models is
found by comparing them field by field, and refused by name.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import UsageError
from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.layout import OBJECT, GraspModel
from gmdx.scenes.physics import PhysicsConfig

SLOTS = (8, 24, 48, 96)  # hulls of an object: few sizes, so that many objects are side by side

# Numbers that a world has of its own, all of them arrays by world in MuJoCo Warp's model.
OF_GEOMS = (
    "geom_size",
    "geom_aabb",
    "geom_rbound",
    "geom_pos",
    "geom_quat",
    "geom_friction",
)
OF_BODIES = (
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_invweight0",
    "dof_invweight0",
)
MESH_OF_GEOM = "geom_dataid"

# A mesh's own numbers, and where in the arrays of all meshes they begin.
_PER_MESH = ("mesh_vertnum", "mesh_polynum")
_MESH_ADDRESSES = {
    "mesh_vertadr": "mesh_vert",
    "mesh_graphadr": "mesh_graph",
    "mesh_polyadr": "mesh_polynormal",
    "mesh_polyvertadr": "mesh_polyvert",
    "mesh_polymapadr": "mesh_polymap",
}
_MESH_CONTENTS = (
    "mesh_vert",
    "mesh_graph",
    "mesh_polynormal",
    "mesh_polyvert",
    "mesh_polymap",
    "mesh_polyvertnum",
    "mesh_polymapnum",
)
LARGEST = ("npolygonmax", "nmeshdegmax")  # of any mesh: sizes of the collision's scratch space

# Names, sizes, drawing, and bounding volumes: no step of MuJoCo Warp reads them.
_UNREAD_PREFIXES = ("mesh_", "bvh_", "body_bvh", "name")
_UNREAD = {
    "signature",
    "geom_sameframe",  # shortcuts of C
    "body_sameframe",
    "dof_M0",
    "dof_length",  # only for sleeping, which is off
    "body_geomadr",  # the library's own are right for it
    "body_geomnum",
    # The sparsity of the inertia matrix: the slots' is full, so it holds any object's.
    "body_simple",
    "dof_simplenum",
    "M_rownnz",
    "M_rowadr",
    "M_colind",
    "mapM2M",
    "mapM2D",
    "mapD2M",
}
_GEOM_REFERENCES = {"sensor_objid": "sensor_objtype", "sensor_refid": "sensor_reftype"}


@dataclass(frozen=True)
class Library:
    """Objects that can be side by side.

    Tables have a row an object and, in a row, one field after the other in the order of
    `columns`, flattened as in the library model.
    """

    model: mujoco.MjModel  # the shared gripper and table, and slots for hulls
    numbers: Float[Array, "m f"]  # of OF_GEOMS and OF_BODIES
    meshes: Int[Array, "m g"]  # of each geom: -1 for none
    columns: dict[str, slice]  # of each field in `numbers`
    mesh_arrays: dict[str, Array]  # by field, of all objects' meshes, one after the other
    largest: dict[str, int]  # LARGEST


def slots_for(model: mujoco.MjModel) -> int:
    """Slots of the smallest library that holds an object's hulls.

    Raises:
        UsageError: The object has too many hulls for any.
    """
    hulls = int(model.body_geomnum[model.body(OBJECT).id])
    for size in SLOTS:
        if hulls <= size:
            return size
    raise UsageError(
        f"an object has {hulls} convex hulls, and warp takes up to {SLOTS[-1]}: prepare it "
        "with fewer, or run it with --engine mujoco"
    )


def build_library(models: Sequence[GraspModel], physics: PhysicsConfig) -> Library:
    """The library of some objects, grasped by one gripper under the same physics.

    Raises:
        UsageError: The compiled models differ in something that worlds cannot have of their own.
    """
    size = max(slots_for(grasp.model) for grasp in models)
    shared = slots_model(models[0].gripper, physics, size)
    joined, offsets = _joined_meshes([grasp.model for grasp in models])
    numbers, meshes = [], []
    for grasp, offset in zip(models, offsets, strict=True):
        own = grasp.model
        rows = _rows(shared, own)
        refuse_differences(shared, own, rows)
        numbers.append(np.concatenate([part.ravel() for part in _own_numbers(shared, own, rows)]))
        ids = np.full(shared.ngeom, -1)
        ids[rows] = np.where(own.geom_dataid >= 0, own.geom_dataid + offset, -1)
        meshes.append(ids)
    # Warp has no such flag: it never puts a diverged trial back to its start.
    shared.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return Library(
        model=shared,
        numbers=np.stack(numbers),
        meshes=np.stack(meshes),
        columns=_columns(shared),
        mesh_arrays=joined,
        largest={
            name: max(largest_mesh(grasp.model)[name] for grasp in models) for name in LARGEST
        },
    )


def largest_mesh(model: mujoco.MjModel) -> dict[str, int]:
    """LARGEST of one model."""
    return {name: int(getattr(model, name)) for name in LARGEST}


def slots_model(gripper: Gripper, physics: PhysicsConfig, size: int) -> mujoco.MjModel:
    """The gripper and table with `size` equal hulls in the object's place."""
    corner = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
    nothing = np.zeros((0, 3))
    placeholder = ObjectModel(
        object_id="slots",
        vertices=nothing,
        faces=nothing.astype(int),
        hulls=(corner,) * size,
        mass=0.1,
        friction=1.0,
        # Not diagonal, so that the inertia matrix has room for any object's.
        inertia=1e-5 * np.array([[3.0, 0.3, 0.2], [0.3, 4.0, 0.1], [0.2, 0.1, 5.0]]),
        scale=1.0,
        box=OrientedBox(np.zeros(3), np.eye(3), np.ones(3)),
        stable_poses=StablePoses(np.eye(4)[:1], np.zeros(1), np.ones(1)),
    )
    return grasp_model(placeholder, gripper, physics).model


def _rows(shared: mujoco.MjModel, own: mujoco.MjModel) -> Int[Array, "g"]:
    """For each geom of an object's model the library's: its hulls take the first slots."""
    body = own.body(OBJECT).id
    first, count = int(own.body_geomadr[body]), int(own.body_geomnum[body])
    rows = np.arange(own.ngeom)
    rows[first + count :] += int(shared.body_geomnum[body]) - count
    return rows


def refuse_differences(shared: mujoco.MjModel, own: mujoco.MjModel, rows: Int[Array, "g"]) -> None:
    """Raise UsageError, naming the fields, where models differ that must not."""
    by_world = {*OF_GEOMS, *OF_BODIES, MESH_OF_GEOM}
    found = [
        name
        for name, value in _arrays(own)
        if name not in by_world and not _agrees(name, shared, value, own, rows)
    ]
    found += [
        f"opt.{name}"
        for name in sorted(dir(own.opt))
        if not name.startswith("_")
        and not np.array_equal(getattr(own.opt, name), getattr(shared.opt, name))
    ]
    if found:
        raise UsageError(
            f"warp cannot put this object beside others: its model differs in "
            f"{', '.join(found)}. Use one gripper and one physics configuration for a batch, or "
            "run it with --engine mujoco"
        )


def _arrays(model: mujoco.MjModel) -> Iterator[tuple[str, Array]]:
    for name in sorted(dir(model)):
        if name.startswith("_") or name.startswith(_UNREAD_PREFIXES) or name in _UNREAD:
            continue
        value = getattr(model, name)
        if isinstance(value, np.ndarray):
            yield name, value


def _agrees(
    name: str, shared: mujoco.MjModel, value: Array, own: mujoco.MjModel, rows: Int[Array, "g"]
) -> bool:
    expected = getattr(shared, name)
    if name.startswith("geom_"):
        expected = expected[rows]
    if name in _GEOM_REFERENCES:
        is_geom = getattr(own, _GEOM_REFERENCES[name]) == mujoco.mjtObj.mjOBJ_GEOM
        value = np.where(is_geom, rows[np.where(is_geom, value, 0)], value)
    return bool(np.array_equal(expected, value))


def _own_numbers(
    shared: mujoco.MjModel, own: mujoco.MjModel, rows: Int[Array, "g"]
) -> Iterator[Array]:
    for name in OF_GEOMS:
        value = np.array(getattr(shared, name), float)
        value[rows] = getattr(own, name)
        yield value
    for name in OF_BODIES:
        yield np.asarray(getattr(own, name), float)


def _columns(shared: mujoco.MjModel) -> dict[str, slice]:
    columns, start = {}, 0
    for name in (*OF_GEOMS, *OF_BODIES):
        stop = start + getattr(shared, name).size
        columns[name] = slice(start, stop)
        start = stop
    return columns


def _joined_meshes(models: Sequence[mujoco.MjModel]) -> tuple[dict[str, Array], Int[Array, "m"]]:
    """All models' meshes one after the other, and how many lie before each model's."""

    def before(name: str) -> Int[Array, "m"]:
        sizes = [len(getattr(model, name)) for model in models]
        return np.concatenate([[0], np.cumsum(sizes)[:-1]])

    joined: dict[str, Any] = {}
    for name in (*_PER_MESH, *_MESH_CONTENTS):
        joined[name] = np.concatenate([getattr(model, name) for model in models])
    for name, target in _MESH_ADDRESSES.items():
        shifted = [
            # A mesh without a graph has the address -1.
            _shift(getattr(model, name), int(offset))
            for model, offset in zip(models, before(target), strict=True)
        ]
        joined[name] = np.concatenate(shifted)
    return joined, before("mesh_vertadr")


def _shift(addresses: Int[Array, "k"], offset: int) -> Int[Array, "k"]:
    return np.where(addresses >= 0, addresses + offset, addresses)
