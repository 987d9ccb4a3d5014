"""Which points of two overlapping convex bodies become contacts, as C MuJoCo chooses them.

Along the direction of least depth each body has a feature: a corner, an edge or a face. Two faces
that are almost parallel meet in a polygon, of which four corners are kept; an edge that is almost
parallel to a face is laid on it, with two contacts; anything else is one contact.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

APART = 1.0  # m, distance of a contact that is none
CONTACTS_A_PAIR = 4
BOX_FACE, HULL_FACE, EDGES = 0, 1, 2  # what parts two bodies
_NARROW = 0.0889  # rad: what is closer is parallel, as in C
_SIN, _COS = float(np.sin(_NARROW)), float(np.cos(_NARROW))
_SAME = 1e-9  # m


class Manifold(NamedTuple):
    """Up to k contacts; `distance` is negative where they press, normals point into the second."""

    distance: Any  # (k) m
    position: Any  # (k 3) m, midway between the surfaces
    normal: Any  # (k 3)


class Hull(NamedTuple):
    """One hull's numbers in a box's frame."""

    vertices: Any  # (v 3) m
    normals: Any  # (f 3)
    offsets: Any  # (f) m
    starts: Any  # (e 3) m, of edges
    ends: Any  # (e 3) m
    left: Any  # (e 3) normals of the faces beside each edge
    right: Any  # (e 3)
    sides: Any  # (e 2) those faces
    corner: Any  # (c) vertex, for every corner of every face
    face: Any  # (c) that face


class Parting(NamedTuple):
    """The direction along which a box and a hull overlap least."""

    gap: Any  # m, negative: depth
    normal: Any  # (3) into the hull
    kind: Any  # BOX_FACE, HULL_FACE or EDGES
    face: Any  # of the hull, where it is one
    edge: Any  # of the hull, where edges cross
    axis: Any  # of the box's edge, where edges cross


def dot(a: Array, b: Array) -> Array:
    """Sums of products along the last axis, never in reduced precision as matrix products are."""
    return jnp.sum(a * b, axis=-1)


def manifold(half: Array, hull: Hull, parting: Parting, single: Array) -> Manifold:
    """The contacts.

    Args:
        half: (3) m, of the box.
        hull: In the box's frame.
        parting: Of the two.
        single: (3) m, the deepest point, midway between the surfaces.
    """
    normal = parting.normal
    deepest = jnp.argmin(dot(hull.vertices, normal))
    faces = _hull_faces(hull, parting, deepest)
    sides = _box_sides(parting)

    facing = -jnp.where(faces[:, None], hull.normals, 0.0) * sides  # (f 3) cosines
    best = jnp.argmax(facing.ravel())
    face, axis = best // 3, best % 3
    parallel = facing.ravel()[best] > _COS
    polygon = _faces_meet(half, hull, face, axis, jnp.sign(normal[axis]))

    on_face, laid_face = _box_edge_on_hull(half, hull, parting, faces)
    on_box, laid_box = _hull_edge_on_box(half, hull, parting, hull.vertices[deepest], sides)

    alone = Manifold(
        jnp.where(jnp.arange(CONTACTS_A_PAIR) == 0, parting.gap, APART),
        jnp.broadcast_to(single, (CONTACTS_A_PAIR, 3)),
        jnp.broadcast_to(normal, (CONTACTS_A_PAIR, 3)),
    )
    box_first = laid_face & (parting.kind != BOX_FACE)
    found = _where(laid_box & (parting.kind != HULL_FACE), on_box, alone)
    found = _where(box_first, on_face, found)
    found = _where(parallel, polygon, found)
    found = _where(jnp.any(found.distance < 0), found, alone)
    return Manifold(jnp.where(parting.gap < 0, found.distance, APART), found.position, found.normal)


def _where(condition: Array, one: Manifold, other: Manifold) -> Manifold:
    return Manifold(*(jnp.where(condition, a, b) for a, b in zip(one, other, strict=True)))


def _hull_faces(hull: Hull, parting: Parting, deepest: Array) -> Array:
    """(f) Faces of the hull at its feature that look at the box."""
    faces = jnp.arange(len(hull.offsets))
    at_corner = _any_at(hull.face, hull.corner == deepest, len(faces))
    at_edge = jnp.any(hull.sides[parting.edge] == faces[:, None], axis=1)
    chosen = jnp.where(parting.kind == EDGES, at_edge, at_corner)
    chosen = jnp.where(parting.kind == HULL_FACE, faces == parting.face, chosen)
    facing: Array = dot(hull.normals, -parting.normal) > _SIN
    return jnp.logical_and(chosen, facing)


def _any_at(index: Array, flags: Array, length: int) -> Array:
    """(length) Whether a flag is up for any entry with that index."""
    return jnp.zeros(length, bool).at[index].max(flags)


def _box_sides(parting: Parting) -> Array:
    """(3) Sides of the box at its feature that look at the hull: +1, -1, or 0 for neither."""
    normal, axes = parting.normal, jnp.arange(3)
    own = jnp.where(parting.kind == BOX_FACE, jnp.abs(normal) > 0.5, axes != parting.axis)
    own = jnp.where(parting.kind == HULL_FACE, True, own)
    return jnp.where(own & (jnp.abs(normal) > _SIN), jnp.sign(normal), 0.0)


def _faces_meet(half: Array, hull: Hull, face: Array, axis: Array, side: Array) -> Manifold:
    """Corners of the polygon in which a face of the box and one of the hull overlap."""
    normal, offset = hull.normals[face], hull.offsets[face]
    lateral = jnp.stack([(axis + 1) % 3, (axis + 2) % 3])
    limits = half[lateral]

    inside = jnp.all(jnp.abs(hull.vertices[:, lateral]) <= limits, axis=1)
    own = _any_at(hull.corner, hull.face == face, len(hull.vertices)) & inside

    signs = jnp.asarray([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]], half.dtype)
    flat = jnp.zeros((4, 3), half.dtype).at[:, lateral].set(signs * limits)
    rise = (offset - dot(flat, normal)) / jnp.where(normal[axis] == 0, 1.0, normal[axis])
    corners = flat.at[:, axis].set(rise)
    beyond = dot(corners[:, None], hull.normals) - hull.offsets
    others = jnp.arange(len(hull.offsets)) != face
    within = jnp.all((beyond <= 0) | ~others, axis=1)

    along = hull.ends - hull.starts
    border = jnp.any(hull.sides == face, axis=1)
    crossings, crossed = [], []
    for one in (0, 1):
        rate = along[:, lateral[one]]
        for sign in (1.0, -1.0):
            level = jnp.abs(rate) < _SAME
            start = hull.starts[:, lateral[one]]
            time = (sign * limits[one] - start) / jnp.where(level, 1.0, rate)
            point = hull.starts + time[:, None] * along
            beside = jnp.abs(point[:, lateral[1 - one]]) <= limits[1 - one]
            crossings.append(point)
            crossed.append(border & ~level & (time >= 0) & (time <= 1) & beside)
    points = jnp.concatenate([hull.vertices, corners, *crossings])
    there = jnp.concatenate([own, within, *crossed])

    depth = half[axis] - side * points[:, axis]
    there = there & (depth > 0)
    chosen, distinct = _quadrilateral(points, there, normal)
    point, deep = points[chosen], depth[chosen]
    on_box = point.at[:, axis].add(deep * side)
    distance = deep * side * normal[axis]  # along the hull's normal, negative
    middle = on_box - 0.5 * distance[:, None] * normal
    return Manifold(
        jnp.where(distinct, distance, APART), middle, jnp.broadcast_to(-normal, middle.shape)
    )


def _quadrilateral(points: Array, there: Array, normal: Array) -> tuple[Array, Array]:
    """Four of the points that span about the largest area, and whether each is one more."""

    def widest(measure: Array) -> Array:
        return jnp.argmax(jnp.where(there, measure, -jnp.inf))

    def away(index: Array) -> Array:
        gap = points - points[index]
        return dot(gap, gap)

    a = widest(away(jnp.argmax(there)))
    b = widest(away(a))
    base = points[b] - points[a]
    length = jnp.sqrt(dot(base, base))
    lateral = dot(jnp.cross(normal, base), points - points[a]) / jnp.where(length > 0, length, 1.0)
    c, d = widest(lateral), widest(-lateral)
    chosen = jnp.stack([a, b, c, d])
    distinct = jnp.stack([there[a], length > 1e-6, lateral[c] > 1e-6, -lateral[d] > 1e-6])
    return chosen, distinct & there[chosen]


def _pair(points: Array, depth: Array, cut: Array, normal: Array, toward: Array) -> Manifold:
    """Contacts at the two ends of an edge on a face.

    An end beyond the face has none; where the face's border cut the other end off, C counts that
    one twice.

    Args:
        points: (2 3) m, the ends.
        depth: (2) m, below the face.
        cut: (2) whether the face's border cut that end off.
        normal: (3) of the contacts.
        toward: (3) direction from the edge to the face.
    """
    deep = depth > 0
    other = jnp.stack([1, 0])
    double = ~deep & deep[other] & cut[other]
    point = jnp.where(double[:, None], points[other], points)
    size = jnp.where(double, depth[other], depth)
    distance = jnp.where(deep | double, -size, APART)
    middle = point + 0.5 * size[:, None] * toward
    none = jnp.full(CONTACTS_A_PAIR - 2, APART, point.dtype)
    return Manifold(
        jnp.concatenate([distance, none]),
        jnp.concatenate([middle, middle]),
        jnp.broadcast_to(normal, (CONTACTS_A_PAIR, 3)),
    )


def _hull_edge_on_box(
    half: Array, hull: Hull, parting: Parting, deepest: Array, sides: Array
) -> tuple[Manifold, Array]:
    """An edge of the hull laid on a face of the box, and whether there is such a pair."""
    along = hull.ends - hull.starts
    long = jnp.sqrt(dot(along, along))
    cosines = jnp.abs(along) / jnp.where(long > 0, long, 1.0)[:, None]

    def at(points: Array) -> Array:
        gap = points - deepest
        return dot(gap, gap) < _SAME**2

    at_corner = at(hull.starts) | at(hull.ends)
    own = jnp.where(parting.kind == EDGES, jnp.arange(len(long)) == parting.edge, at_corner)
    measure = jnp.where(own[:, None] & (sides != 0), cosines, jnp.inf).ravel()
    best = jnp.argmin(measure)
    edge, axis = best // 3, best % 3
    side = sides[axis]

    start, way = hull.starts[edge], along[edge]
    level = jnp.abs(way) < 1e-12
    rate = jnp.where(level, 1.0, way)
    one, two = (-half - start) / rate, (half - start) / rate
    beside = jnp.arange(3) == axis
    enter = jnp.where(level | beside, -jnp.inf, jnp.minimum(one, two)).max()
    leave = jnp.where(level | beside, jnp.inf, jnp.maximum(one, two)).min()
    missed = jnp.any(level & ~beside & (jnp.abs(start) > half))
    low, high = jnp.maximum(enter, 0.0), jnp.minimum(leave, 1.0)
    points = jnp.stack([start + low * way, start + high * way])
    normal = jnp.where(beside, side, 0.0)
    depth = half[axis] - side * points[:, axis]
    cut = jnp.stack([enter > 0, leave < 1])
    found = _pair(points, depth, cut, normal, normal)
    return found, (measure[best] < _SIN) & (low <= high) & ~missed


def _box_edge_on_hull(
    half: Array, hull: Hull, parting: Parting, faces: Array
) -> tuple[Manifold, Array]:
    """An edge of the box laid on a face of the hull, and whether there is such a pair."""
    axes = jnp.where(parting.kind == EDGES, jnp.arange(3) == parting.axis, True)
    usable = faces[:, None] & axes & (jnp.abs(hull.normals) < _SIN)
    flattest = jnp.argmin(jnp.where(usable, jnp.abs(hull.normals), jnp.inf).ravel())
    best = jnp.where(parting.kind == EDGES, jnp.argmax(usable.ravel()), flattest)  # the first in C
    face, axis = best // 3, best % 3
    normal, offset = hull.normals[face], hull.offsets[face]

    corner = jnp.where(parting.normal < 0, -half, half)
    way = jnp.where(jnp.arange(3) == axis, 2 * half, 0.0)
    start = jnp.where(jnp.arange(3) == axis, -half, corner)

    border = jnp.any(hull.sides == face, axis=1)
    outward = jnp.cross(hull.ends - hull.starts, normal)
    weights = jnp.where(border, 1.0, 0.0)
    middle = jnp.sum(hull.starts * weights[:, None], axis=0) / jnp.maximum(weights.sum(), 1.0)
    inner = dot(outward, middle - hull.starts)
    outward = jnp.where(inner[:, None] > 0, -outward, outward)
    rate, gap = dot(outward, way), dot(outward, hull.starts - start)
    level = jnp.abs(rate) < 1e-15
    time = gap / jnp.where(level, 1.0, rate)
    leave = jnp.where(border & (rate > 0) & ~level, time, jnp.inf).min()
    enter = jnp.where(border & (rate < 0) & ~level, time, -jnp.inf).max()
    missed = jnp.any(border & level & (gap < 0))
    low, high = jnp.maximum(enter, 0.0), jnp.minimum(leave, 1.0)
    points = jnp.stack([start + low * way, start + high * way])
    depth = offset - dot(points, normal)
    cut = jnp.stack([enter > 0, leave < 1])
    found = _pair(points, depth, cut, -normal, normal)
    return found, jnp.any(usable) & (low <= high) & ~missed
