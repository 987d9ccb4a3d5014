"""Quasi-static stable poses on a plane: on which faces a body can rest, and how often it does."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.geometry import matrix_quaternion
from gmdx.objects.model import StablePoses


@dataclass(frozen=True)
class StableConfig:
    """When two hull facets, and when two poses, count as one."""

    coplanar: float = 1e-4  # rad, between facets that are one face
    merge: float = 0.175  # rad (10 degrees), between resting faces that are told as one pose


@dataclass(frozen=True)
class _Facets:
    """The faces of a convex hull, seen from the centre of mass."""

    normals: Float[Array, "f 3"]  # outward
    heights: Float[Array, "f"]  # m, of the centre of mass above the face
    shares: Float[Array, "f"]  # of the full solid angle
    stable: Bool[Array, "f"]
    next: Int[Array, "f"]  # where an unstable face topples to; itself if stable


def stable_poses(
    points: Float[Array, "n 3"], center: Float[Array, "3"], config: StableConfig | None = None
) -> StablePoses:
    """Stable poses of the convex hull of points with its centre of mass at `center`.

    Dropped in a random orientation and moving without inertia, a body first touches with a face
    as often as that face's share of the solid angle around the centre of mass. If the centre of
    mass is not above the face, the body rolls over the edge that it is farthest beyond, and so
    on, always downwards, until it rests (Goldberg et al. 1999, quasi-static approximation).
    Resting faces within `config.merge` of a more probable one are counted with it, so a round
    side made of many narrow facets is a few poses with a weight, not many without.

    Args:
        points: Any points whose hull is the body's, m.
        center: Centre of mass, inside the hull, m.
        config: What counts as one facet, and as one pose.
    """
    config = StableConfig() if config is None else config
    facets = _facets(points, center, config.coplanar)
    probability = facets.shares.copy()
    for f in np.argsort(-facets.heights, kind="stable"):
        if not facets.stable[f]:
            probability[facets.next[f]] += probability[f]
            probability[f] = 0.0
    chosen: list[int] = []
    merged: list[float] = []
    resting = np.flatnonzero(facets.stable)
    for f in resting[np.argsort(-probability[resting], kind="stable")]:
        like = facets.normals[chosen] @ facets.normals[f] if chosen else np.zeros(0)
        if len(like) and like.max() > np.cos(config.merge):
            merged[int(np.argmax(like))] += float(probability[f])
        else:
            chosen.append(int(f))
            merged.append(float(probability[f]))
    order = np.argsort(-np.array(merged), kind="stable")
    picked = np.array(chosen)[order]
    probabilities = np.array(merged)[order]
    return StablePoses(
        quaternions=np.array([_facing_down(n) for n in facets.normals[picked]]),
        heights=facets.heights[picked],
        probabilities=probabilities / probabilities.sum(),
    )


def _facets(points: Array, center: Array, coplanar: float) -> _Facets:
    """Faces of the hull, coplanar triangles merged."""
    hull = ConvexHull(points)
    corners = points[hull.simplices] - center
    normals = hull.equations[:, :3]
    n = len(normals)
    mine, theirs = np.repeat(np.arange(n), 3), hull.neighbors.ravel()
    flat = np.linalg.norm(normals[mine] - normals[theirs], axis=1) < coplanar
    graph = coo_array((np.ones(flat.sum(), np.int8), (mine[flat], theirs[flat])), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    facet_normal = np.zeros((count, 3))
    np.add.at(facet_normal, label, normals * area[:, None])
    facet_normal /= np.linalg.norm(facet_normal, axis=1, keepdims=True)
    height = np.zeros(count)
    np.maximum.at(height, label, np.einsum("tki,ti->tk", corners, facet_normal[label]).max(axis=1))
    shares = np.bincount(label, _solid_angles(corners), minlength=count)

    # How far the centre of mass is beyond each edge between two facets: neighbour k of a
    # triangle lies across the edge opposite to its corner k.
    start, end = corners[:, [1, 2, 0]].reshape(-1, 3), corners[:, [2, 0, 1]].reshape(-1, 3)
    outward = np.cross(end - start, facet_normal[label[mine]])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
    inner = ((corners.reshape(-1, 3) - start) * outward).sum(axis=1)
    beyond = -(start * outward).sum(axis=1) * np.where(inner > 0, -1.0, 1.0)
    border = np.flatnonzero(label[mine] != label[theirs])
    border = border[np.lexsort((border, -beyond[border], label[mine[border]]))]
    facet, first = np.unique(label[mine[border]], return_index=True)
    worst = border[first]
    scale = float(np.abs(corners).max())
    to = np.arange(count)
    to[facet] = label[theirs[worst]]
    stable = np.ones(count, bool)
    stable[facet] = beyond[worst] <= 1e-9 * scale
    stable |= height[to] >= height  # flat to rounding: nowhere lower to roll to
    return _Facets(facet_normal, height, shares / shares.sum(), stable, np.where(stable, -1, to))


def _solid_angles(triangles: Float[Array, "t 3 3"]) -> Float[Array, "t"]:
    """Solid angle of each triangle seen from the origin (Van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    determinant = np.abs((a * np.cross(b, c)).sum(axis=1))
    divisor = (
        la * lb * lc
        + (a * b).sum(axis=1) * lc
        + (b * c).sum(axis=1) * la
        + (c * a).sum(axis=1) * lb
    )
    angles: Array = 2.0 * np.arctan2(determinant, divisor)
    return angles


def _facing_down(normal: Float[Array, "3"]) -> Float[Array, "4"]:
    """The least rotation (wxyz) that turns a direction to -z."""
    axis = np.cross(normal, [0.0, 0.0, -1.0])
    sine, cosine = float(np.linalg.norm(axis)), -float(normal[2])
    if sine < 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0] if cosine > 0 else [0.0, 1.0, 0.0, 0.0])
    x, y, z = axis / sine
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return matrix_quaternion(np.eye(3) + sine * K + (1.0 - cosine) * (K @ K))
