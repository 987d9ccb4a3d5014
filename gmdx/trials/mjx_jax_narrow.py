"""The depth of one box in one convex hull, in fixed shapes.

Two convex bodies that overlap are parted along the direction of least depth, found among the
face normals of both and the cross products of their edges (separating axis test, with the Gauss
map of Gregorius, GDC 2013). Along that direction the depth of the overlap is a concave function
of the lateral position whose vertices are the hull's vertices, the box's corners and the
crossings of their edges.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from gmdx.trials.mjx_jax_hulls import Hulls
from gmdx.trials.mjx_jax_manifold import (
    APART,
    BOX_FACE,
    EDGES,
    HULL_FACE,
    Hull,
    Manifold,
    Parting,
    dot,
    manifold,
)

_TIE = 1e-6  # m: faces are preferred to edges, and the box's to the hull's, by this, as C does
_PARALLEL = 1e-9


def turn(matrix: Array, vectors: Array) -> Array:
    """Vectors (n 3), or one (3), turned by a matrix (3 3)."""
    return jnp.sum(vectors[..., None, :] * matrix, axis=-1)


def hull_in_box(
    hulls: Hulls,
    which: tuple[Array, ...],
    place: Float[Array, "3"],
    axes: Float[Array, "3 3"],
    position: Float[Array, "3"],
    rotation: Float[Array, "3 3"],
) -> Hull:
    """A hull of an object at `place` with `axes`, in the frame of a box.

    Args:
        hulls: Of an object, or of several.
        which: Index of the hull along the leading axes of `hulls`.
        place: m, of the object.
        axes: Of the object, as columns.
        position: m, of the box.
        rotation: Axes of the box, as columns.
    """
    to_box = jnp.sum(rotation[:, :, None] * axes[:, None, :], axis=0)
    shift = turn(rotation.T, place - position)
    vertices = shift + turn(to_box, hulls.vertices[which])
    normals = turn(to_box, hulls.normals[which])
    edges, sides = hulls.edges[which], hulls.edge_faces[which]
    return Hull(
        vertices=vertices,
        normals=normals,
        offsets=hulls.offsets[which] + dot(normals, shift),
        starts=vertices[edges[:, 0]],
        ends=vertices[edges[:, 1]],
        left=normals[sides[:, 0]],
        right=normals[sides[:, 1]],
        sides=sides,
        corner=hulls.corner[which],
        face=hulls.face[which],
    )


def box_hull(half: Float[Array, "3"], hull: Hull) -> Manifold:
    """Contacts of a box with a hull, in the box's frame; normals point into the hull."""
    parting = _parting(half, hull)
    depth, surface = _depths(half, hull, parting.normal)
    deepest = jnp.argmax(depth)
    single = surface[deepest] - 0.5 * jnp.maximum(depth[deepest], 0.0) * parting.normal
    return manifold(half, hull, parting, single)


def _parting(half: Array, hull: Hull) -> Parting:
    """The widest gap between box and hull, and its direction."""
    eye = jnp.eye(3, dtype=half.dtype)
    gaps = jnp.concatenate([hull.vertices.min(axis=0) - half, -hull.vertices.max(axis=0) - half])
    best = jnp.argmax(gaps)
    gap, normal = gaps[best], jnp.concatenate([eye, -eye])[best]

    gaps = -dot(jnp.abs(hull.normals), half) - hull.offsets
    face = jnp.argmax(gaps)
    better = gaps[face] > gap + _TIE
    gap = jnp.where(better, gaps[face], gap)
    normal = jnp.where(better, -hull.normals[face], normal)
    kind = jnp.where(better, HULL_FACE, BOX_FACE)

    along = hull.ends - hull.starts
    axes = jnp.cross(along[:, None, :], eye[None])
    length = jnp.sqrt(dot(axes, axes))
    usable = length > 1e-3 * jnp.sqrt(dot(along, along))[:, None]
    axes = axes / jnp.where(usable, length, 1.0)[..., None]
    left, right, along = hull.left[:, None], hull.right[:, None], along[:, None]
    axes = jnp.where(dot(axes, left + right)[..., None] < 0, -axes, axes)
    bend = dot(jnp.cross(left, right), along)
    between = (dot(jnp.cross(left, axes), along) * bend >= 0) & (
        dot(jnp.cross(axes, right), along) * bend >= 0
    )
    gaps = -dot(jnp.abs(axes), half) - dot(axes, hull.starts[:, None])
    gaps = jnp.where(usable & between, gaps, -jnp.inf).ravel()
    best = jnp.argmax(gaps)
    better = gaps[best] > gap + _TIE
    return Parting(
        gap=jnp.where(better, gaps[best], gap),
        normal=jnp.where(better, -axes.reshape(-1, 3)[best], normal),
        kind=jnp.where(better, EDGES, kind),
        face=face,
        edge=best // 3,
        axis=best % 3,
    )


# Corners of the face across each axis, in order around it.
_FACES = np.array(
    [
        [[1, 1, 1], [1, -1, 1], [1, -1, -1], [1, 1, -1]],
        [[1, 1, 1], [-1, 1, 1], [-1, 1, -1], [1, 1, -1]],
        [[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]],
    ]
)


def _depths(half: Array, hull: Hull, normal: Array) -> tuple[Array, Array]:
    """Depth along the normal at every vertex of the overlap, and its point on the box's surface."""
    axis = jnp.argmax(jnp.abs(normal))
    facing = jnp.where((jnp.arange(3) == axis) & (normal[axis] < 0), -1.0, 1.0)
    corners = jnp.asarray(_FACES, half.dtype)[axis] * facing * half

    at_vertices = _out_of_box(half, hull.vertices, normal)
    under_vertices = hull.vertices + at_vertices[:, None] * normal
    at_corners = _out_of_hull(hull, corners, normal)
    at_crossings, crossings = _crossings(corners, hull, normal)
    depth = jnp.concatenate([at_vertices, at_corners, at_crossings])
    return depth, jnp.concatenate([under_vertices, corners, crossings])


def _out_of_box(half: Array, points: Array, normal: Array) -> Array:
    """How far points of the hull must go along the normal to leave the box; -APART beside it."""
    level = jnp.abs(normal) < _PARALLEL
    slope = jnp.where(level, 1.0, normal)
    side = jnp.sign(slope) * half
    leave = jnp.where(level, jnp.inf, (side - points) / slope).min(axis=-1)
    enter = jnp.where(level, -jnp.inf, (-side - points) / slope).max(axis=-1)
    beside = jnp.any(level & (jnp.abs(points) > half), axis=-1)
    return jnp.where((leave >= enter) & ~beside, leave, -APART)


def _out_of_hull(hull: Hull, points: Array, normal: Array) -> Array:
    """How far points of the box must go against the normal to leave the hull."""
    rate = -dot(hull.normals, normal)
    slack = hull.offsets - dot(points[:, None], hull.normals)
    level = jnp.abs(rate) < _PARALLEL
    time = slack / jnp.where(level, 1.0, rate)
    leave = jnp.where(rate >= _PARALLEL, time, jnp.inf).min(axis=-1)
    enter = jnp.where(rate <= -_PARALLEL, time, -jnp.inf).max(axis=-1)
    beside = jnp.any(level & (slack < 0), axis=-1)
    return jnp.where((leave >= enter) & ~beside, leave, -APART)


def _crossings(corners: Array, hull: Hull, normal: Array) -> tuple[Array, Array]:
    """Where edges of the box's face and of the hull cross, seen along the normal."""
    start = corners[:, None]
    side = jnp.roll(corners, -1, axis=0)[:, None] - start
    along = (hull.ends - hull.starts)[None]
    between = hull.starts[None] - start
    across = dot(jnp.cross(side, along), normal)
    level = jnp.abs(across) < _PARALLEL * jnp.sqrt(dot(side, side) * dot(along, along))
    across = jnp.where(level, 1.0, across)
    on_box = dot(jnp.cross(between, along), normal) / across
    on_hull = dot(jnp.cross(between, side), normal) / across
    meets = ~level & (on_box >= 0) & (on_box <= 1) & (on_hull >= 0) & (on_hull <= 1)
    points = start + on_box[..., None] * side
    depth = dot(points - (hull.starts[None] + on_hull[..., None] * along), normal)
    return jnp.where(meets, depth, -APART).ravel(), points.reshape(-1, 3)
