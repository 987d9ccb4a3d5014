"""Smallest rectangles and boxes around points."""

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gmdx.arrays import Array, Float
from gmdx.objects.model import OrientedBox

_MOST_DIRECTIONS = 800  # tried as the normal of a side of the box
_REFINED = 3  # of the best directions are improved continuously


def smallest_rectangle(
    points: Float[Array, "n 2"],
) -> tuple[Float[Array, "2 2"], Float[Array, "2"]]:
    """Axes (rows) and side lengths of the rectangle of least area around points in a plane.

    One side of it lies along an edge of the convex hull (Freeman and Shapira 1975).
    """
    corners = points[ConvexHull(points).vertices]
    edges = np.roll(corners, -1, axis=0) - corners
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    sides = np.stack([np.ptp(edges @ corners.T, axis=1), np.ptp(across @ corners.T, axis=1)], 1)
    best = int(np.argmin(sides.prod(axis=1)))
    return np.stack([edges[best], across[best]]), sides[best]


def smallest_box(points: Float[Array, "n 3"]) -> OrientedBox:
    """The box of least volume around points: longest edge first, right-handed axes.

    Tried as the normal of one side: the normals of the hull's faces, and the common
    perpendiculars of pairs of its edges (O'Rourke 1985: two adjacent sides of a smallest box
    each contain an edge of the hull); for each, the other axes are the best in the plane. The
    best few are then improved by a search over rotations.
    """
    hull = ConvexHull(points)
    corners = points[hull.vertices]
    candidates = _directions(points, hull)
    volumes = np.array([_box_at(corners, d)[1].prod() for d in candidates])
    frames = [_box_at(corners, candidates[i])[0] for i in np.argsort(volumes, kind="stable")]
    best = min((_refine(corners, f) for f in frames[:_REFINED]), key=lambda f: _volume(corners, f))
    along = corners @ best.T
    extents = np.ptp(along, axis=0)
    order = np.argsort(-extents, kind="stable")
    axes = best[order].T
    for k in range(2):  # the sign in which the largest component is positive
        axes[:, k] *= np.sign(axes[np.argmax(np.abs(axes[:, k])), k])
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    along = corners @ axes
    center = axes @ (0.5 * (along.min(axis=0) + along.max(axis=0)))
    return OrientedBox(center=center, axes=axes, extents=np.ptp(along, axis=0))


def _directions(points: Array, hull: ConvexHull) -> Float[Array, "d 3"]:
    """Unit directions to try, without repetition, at most `_MOST_DIRECTIONS`."""
    corners = points[hull.simplices]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = hull.equations[np.argsort(-np.linalg.norm(cross, axis=1), kind="stable"), :3]
    centered = points - points.mean(axis=0)
    principal = np.linalg.svd(centered, full_matrices=False)[2]
    result = np.concatenate([np.eye(3), principal, _distinct(normals)[: _MOST_DIRECTIONS // 2]])
    edges = np.unique(np.sort(hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)
    spans = points[edges[:, 1]] - points[edges[:, 0]]
    spans = _distinct(spans[np.argsort(-np.linalg.norm(spans, axis=1), kind="stable")])[:60]
    i, j = np.triu_indices(len(spans), k=1)
    pairs = np.cross(spans[i], spans[j])
    length = np.linalg.norm(pairs, axis=1)
    pairs = pairs[length > 1e-6]
    return np.concatenate([result, _distinct(pairs)])[:_MOST_DIRECTIONS]


def _distinct(directions: Float[Array, "n 3"]) -> Float[Array, "m 3"]:
    """Unit directions, in order, without those that repeat an earlier one or its opposite."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    leading = np.take_along_axis(unit, np.abs(unit).argmax(axis=1)[:, None], axis=1)
    _, first = np.unique(np.round(unit * np.sign(leading), 3), axis=0, return_index=True)
    return np.take(unit, np.sort(first), axis=0)


def _box_at(corners: Array, normal: Array) -> tuple[Float[Array, "3 3"], Float[Array, "3"]]:
    """Axes (rows) and edges of the smallest box with a side of this normal."""
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u)
    plane = np.stack([u, np.cross(normal, u)])
    axes2, sides = smallest_rectangle(corners @ plane.T)
    return np.vstack([axes2 @ plane, normal]), np.append(sides, np.ptp(corners @ normal))


def _volume(corners: Array, axes: Array) -> float:
    return float(np.ptp(corners @ axes.T, axis=0).prod())


def _refine(corners: Array, axes: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Turn a box a little wherever that makes it smaller."""
    unit = _volume(corners, axes)

    def cost(turn: Array) -> float:
        return _volume(corners, axes @ Rotation.from_rotvec(turn).as_matrix().T) / unit

    start = np.vstack([np.zeros(3), 0.05 * np.eye(3)])
    found = minimize(
        cost, np.zeros(3), method="Nelder-Mead",
        options={"initial_simplex": start, "maxiter": 300, "xatol": 1e-7, "fatol": 1e-10},
    )  # fmt: skip
    if found.fun >= 1.0:
        return axes
    better: Array = axes @ Rotation.from_rotvec(found.x).as_matrix().T
    return better
