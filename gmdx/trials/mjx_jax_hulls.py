"""Convex hulls of objects in arrays of fixed shapes, so that objects share a compiled step.

Nothing is moved: vertices, faces and edges that are missing are filled up with repeated ones,
which changes no distance and no contact, and hulls that are missing are switched off.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import UsageError
from gmdx.geometry import quaternion_matrix
from gmdx.scenes.build import GraspModel

_HULLS = (2, 8, 16, 32, 64, 128)
_VERTICES = (16, 32, 64, 128, 256)


@dataclass(frozen=True)
class Bucket:
    """Bounds that objects of one compiled step share."""

    hulls: int
    vertices: int  # of a hull

    @property
    def faces(self) -> int:
        """Most triangles of a convex hull with that many vertices."""
        return 2 * self.vertices - 4

    @property
    def edges(self) -> int:
        """Most edges of a convex hull with that many vertices."""
        return 3 * self.vertices - 6

    @property
    def corners(self) -> int:
        """Most corners of its faces together."""
        return 2 * self.edges


class Hulls(NamedTuple):
    """Hulls of an object, in its frame; leading axes may run over objects.

    A face is a half-space that holds the whole hull: normal . x <= offset.
    """

    vertices: Any  # (h v 3) m
    normals: Any  # (h f 3)
    offsets: Any  # (h f) m
    edges: Any  # (h e 2) vertices of each edge
    edge_faces: Any  # (h e 2) faces on its two sides
    center: Any  # (h 3) m, of the bounding box
    half: Any  # (h 3) m, of the bounding box
    used: Any  # (h) bool
    middle: Any  # (h 3) m, of the mesh
    corner: Any  # (h c) vertex, for every corner of every face
    face: Any  # (h c) that face
    support: Any  # (h c 3) vertices that span the face with that corner


@dataclass(frozen=True)
class _Hull:
    vertices: Float[Array, "v 3"]
    normals: Float[Array, "f 3"]
    offsets: Float[Array, "f"]
    edges: Int[Array, "e 2"]
    edge_faces: Int[Array, "e 2"]
    middle: Float[Array, "3"]
    corner: Int[Array, "c"]
    face: Int[Array, "c"]
    support: Int[Array, "c 3"]


def bucket(model: GraspModel) -> Bucket:
    """The bounds that an object falls under: objects of one bucket share one compiled step.

    Raises:
        UsageError: The object has more hulls, or more vertices a hull, than any bucket.
    """
    hulls = _object_meshes(model)
    sizes = [len(_corners(model.model, mesh)) for mesh in hulls]
    return Bucket(
        _at_least(len(hulls), _HULLS, "convex hulls"),
        _at_least(max(sizes), _VERTICES, "vertices in a convex hull"),
    )


def object_hulls(model: GraspModel, bounds: Bucket) -> Hulls:
    """An object's hulls, filled up to the bounds of its bucket.

    Raises:
        UsageError: The object does not fit under the bounds.
    """
    geoms = _object_geoms(model)
    hulls = [_hull(model.model, geom) for geom in geoms]
    most = max(len(hull.vertices) for hull in hulls)
    if len(hulls) > bounds.hulls or most > bounds.vertices:
        raise UsageError(
            f"an object of {len(hulls)} convex hulls with up to {most} vertices does not fit "
            f"under {bounds}: prepare it with fewer"
        )
    low = np.stack([hull.vertices.min(axis=0) for hull in hulls])
    high = np.stack([hull.vertices.max(axis=0) for hull in hulls])

    def filled(name: str, length: int) -> Array:
        rows = [_repeat(getattr(hull, name), length) for hull in hulls]
        return _repeat(np.stack(rows), bounds.hulls)

    return Hulls(
        vertices=filled("vertices", bounds.vertices),
        normals=filled("normals", bounds.faces),
        offsets=filled("offsets", bounds.faces),
        edges=filled("edges", bounds.edges).astype(np.int32),
        edge_faces=filled("edge_faces", bounds.edges).astype(np.int32),
        center=_repeat(0.5 * (low + high), bounds.hulls),
        half=_repeat(0.5 * (high - low), bounds.hulls),
        used=np.arange(bounds.hulls) < len(hulls),
        middle=_repeat(np.stack([hull.middle for hull in hulls]), bounds.hulls),
        corner=filled("corner", bounds.corners).astype(np.int32),
        face=filled("face", bounds.corners).astype(np.int32),
        support=filled("support", bounds.corners).astype(np.int32),
    )


def _at_least(count: int, ladder: Sequence[int], what: str) -> int:
    for size in ladder:
        if count <= size:
            return size
    raise UsageError(
        f"an object with {count} {what} is more than the JAX implementation holds "
        f"({ladder[-1]}): prepare it with fewer, or run it on another implementation"
    )


def _repeat(values: Array, length: int) -> Array:
    """Fill up with copies of the first entry."""
    missing = np.repeat(values[:1], length - len(values), axis=0)
    filled: Array = np.concatenate([values, missing])
    return filled


def _object_geoms(model: GraspModel) -> list[int]:
    m = model.model
    return [
        geom
        for geom in range(m.ngeom)
        if m.geom_bodyid[geom] == model.object_body and m.geom_contype[geom]
    ]


def _object_meshes(model: GraspModel) -> list[int]:
    m = model.model
    geoms = _object_geoms(model)
    if any(m.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH for geom in geoms) or not geoms:
        raise UsageError("the JAX implementation needs an object made of convex meshes")
    return [int(m.geom_dataid[geom]) for geom in geoms]


def _corners(m: mujoco.MjModel, mesh: int) -> Int[Array, "v"]:
    """Vertices of a mesh that are corners of its hull's faces."""
    return np.unique(np.concatenate(_rings(m, mesh)))


def _rings(m: mujoco.MjModel, mesh: int) -> list[Array]:
    """The corners of every face of a mesh's hull, in order around it, as MuJoCo merged them."""
    first, count = int(m.mesh_polyadr[mesh]), int(m.mesh_polynum[mesh])
    begins, sizes = m.mesh_polyvertadr, m.mesh_polyvertnum
    return [
        np.array(m.mesh_polyvert[begins[face] : begins[face] + sizes[face]], int)
        for face in range(first, first + count)
    ]


def _hull(m: mujoco.MjModel, geom: int) -> _Hull:
    """The hull that MuJoCo collides, in the frame of its body."""
    mesh = int(m.geom_dataid[geom])
    turn = quaternion_matrix(m.geom_quat[geom])
    corners, rings = _corners(m, mesh), _rings(m, mesh)
    local = np.asarray(m.mesh_vert[int(m.mesh_vertadr[mesh]) + corners], float)
    vertices = m.geom_pos[geom] + local @ turn.T
    rings = [np.searchsorted(corners, ring) for ring in rings]
    first = int(m.mesh_polyadr[mesh])
    normals = np.asarray(m.mesh_polynormal[first : first + len(rings)], float) @ turn.T
    edges, sides = _edges(rings)
    sizes = [len(ring) for ring in rings]
    return _Hull(
        vertices=vertices,
        normals=normals,
        # The hull's own reach, so that a sliver's uncertain normal still bounds the hull.
        offsets=(vertices @ normals.T).max(axis=0),
        edges=edges,
        edge_faces=sides,
        middle=np.array(m.geom_pos[geom]),
        corner=np.concatenate(rings),
        face=np.repeat(np.arange(len(rings)), sizes),
        support=np.array(
            [
                ring[_quadrilateral(local[ring], anchor)]
                for ring in rings
                for anchor in range(len(ring))
            ]
        ),
    )


def _edges(rings: Sequence[Array]) -> tuple[Int[Array, "e 2"], Int[Array, "e 2"]]:
    """Edges between two faces, and those faces."""
    pairs = np.sort(
        np.concatenate([np.column_stack([ring, np.roll(ring, -1)]) for ring in rings]), axis=1
    )
    owner = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    order = np.lexsort((owner, pairs[:, 1], pairs[:, 0]))
    pairs, owner = pairs[order], owner[order]
    twin = np.flatnonzero(np.all(pairs[:-1] == pairs[1:], axis=1))
    return pairs[twin], np.stack([owner[twin], owner[twin + 1]], axis=1)


def _quadrilateral(points: Float[Array, "n 3"], anchor: int) -> list[int]:
    """Three corners of a convex polygon that follow `anchor` around a large quadrilateral."""
    count = len(points)
    chosen = [(anchor + k) % count for k in range(4)]
    if count <= 4:
        return [*chosen[1:count], *[chosen[count - 1]] * (4 - count)]

    def area(b: int, c: int, d: int) -> float:
        across, along = points[chosen[0]] - points[c], points[b] - points[d]
        return float(np.linalg.norm(np.cross(across, along)))

    def grows(which: int) -> bool:
        """Move one corner on, if that makes the area larger."""
        moved = chosen[1:]
        moved[which] = (moved[which] + 1) % count
        if area(*moved) <= area(*chosen[1:]):
            return False
        chosen[1:] = moved
        return True

    while grows(2):
        for which in (1, 0):
            while grows(which):
                pass
    return chosen[1:]
