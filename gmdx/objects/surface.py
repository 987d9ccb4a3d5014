"""A closed surface with its normals and areas, and random points on it."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gmdx.arrays import Array, Float, Int
from gmdx.rng import generator


@dataclass(frozen=True)
class Surface:
    """A closed surface of triangles."""

    vertices: Float[Array, "v 3"]  # m
    faces: Int[Array, "f 3"]  # outward, counter-clockwise
    normals: Float[Array, "f 3"]  # unit, outward
    areas: Float[Array, "f"]  # m^2

    @property
    def top(self) -> float:
        """Height of the highest point, m."""
        return float(self.vertices[:, 2].max())


@dataclass(frozen=True)
class SurfacePoints:
    """Points on a surface."""

    points: Float[Array, "n 3"]  # m
    face: Int[Array, "n"]  # the triangles they lie on


def surface_of(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> Surface:
    """Normals and areas of a closed surface."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    twice = np.linalg.norm(cross, axis=1)
    normals = cross / np.maximum(twice, np.finfo(float).tiny)[:, None]
    return Surface(vertices, faces, normals, 0.5 * twice)


def random_points(surface: Surface, n: int, rng: np.random.Generator) -> SurfacePoints:
    """Draw n points uniformly over the surface."""
    cumulative = np.cumsum(surface.areas)
    face = np.searchsorted(cumulative, rng.random(n) * cumulative[-1], side="right")
    face = np.minimum(face, len(cumulative) - 1)
    u, v = rng.random((2, n))
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points = np.einsum("nk,nkd->nd", weights, surface.vertices[surface.faces[face]])
    return SurfacePoints(points, face)


def surface_samples(
    triangles: Float[Array, "f 3 3"], n: int, rng: np.random.Generator
) -> tuple[Float[Array, "n 3"], Int[Array, "n"]]:
    """Points spread over a surface in proportion to area, and the triangle each lies on.

    Stratified: point i is drawn from the i-th of n equal parts of the cumulated area, so
    the share of every region is met to within one point.
    """
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    cumulated = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    at = (np.arange(n) + rng.random(n)) / n * cumulated[-1]
    owner = np.minimum(np.searchsorted(cumulated, at, side="right"), len(triangles) - 1)
    u, v = rng.random((2, n))
    root = np.sqrt(u)[:, None]
    s, t = root * (1 - v[:, None]), root * v[:, None]
    return a[owner] + s * (b[owner] - a[owner]) + t * (c[owner] - a[owner]), owner


def triangle_distance(
    points: Float[Array, "n 3"], triangles: Float[Array, "n 3 3"]
) -> Float[Array, "n"]:
    """Distance of each point to its own triangle, m."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    best = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        length = np.maximum((edge * edge).sum(axis=1), 1e-300)
        t = np.clip(((points - start) * edge).sum(axis=1) / length, 0.0, 1.0)
        gap = points - start - t[:, None] * edge
        best = np.minimum(best, (gap * gap).sum(axis=1))
    ab, ac, ap = b - a, c - a, points - a
    normal = np.cross(ab, ac)
    square = (normal * normal).sum(axis=1)
    flat = np.maximum(square, 1e-300)
    beta = (np.cross(ap, ac) * normal).sum(axis=1) / flat
    gamma = (np.cross(ab, ap) * normal).sum(axis=1) / flat
    inside = (square > 0) & (beta >= 0) & (gamma >= 0) & (beta + gamma <= 1)
    height = (ap * normal).sum(axis=1) ** 2 / flat
    return np.sqrt(np.where(inside, height, best))


class SurfaceIndex:
    """A surface that points can ask for their distance to it.

    The distance is exact to one of the triangles that own the nearest anchors: points spread
    over the surface, centroids, and points along edges, which belong to the triangles on both
    sides. So it is never too small, and too large only where a nearer triangle owns none.
    """

    def __init__(
        self, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, n: int, seed: int
    ) -> None:
        self.triangles: Float[Array, "f 3 3"] = np.asarray(vertices, float)[faces]
        rng = generator(seed, "surface samples")
        self.samples, owner = surface_samples(self.triangles, n, rng)
        along, beside = _edge_anchors(self.triangles, n)
        anchors = np.concatenate([self.samples, self.triangles.mean(axis=1), along])
        self._owner = np.concatenate([owner, np.arange(len(self.triangles)), beside])
        self._tree = cKDTree(anchors)

    def distance(self, points: Float[Array, "n 3"], *, nearest: int = 8) -> Float[Array, "n"]:
        """Distance of each point to the surface, m."""
        _, hits = self._tree.query(points, k=min(nearest, len(self._owner)))
        best = np.full(len(points), np.inf)
        for column in np.atleast_2d(hits.T):
            triangles = self.triangles[self._owner[column]]
            best = np.minimum(best, triangle_distance(points, triangles))
        return best


def _edge_anchors(
    triangles: Float[Array, "f 3 3"], n: int
) -> tuple[Float[Array, "m 3"], Int[Array, "m"]]:
    """Points along the longer edges, about as dense as n points on the surface, and owners."""
    start = triangles.reshape(-1, 3)
    edge = np.roll(triangles, -1, axis=1).reshape(-1, 3) - start
    length = np.linalg.norm(edge, axis=1)
    area = 0.5 * np.linalg.norm(np.cross(edge[0::3], edge[1::3]), axis=1).sum()
    count = np.minimum(length / np.sqrt(max(area, 1e-300) / n), n).astype(np.int64)
    which = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    share = (step + 0.5) / count[which]
    return start[which] + share[:, None] * edge[which], which // 3
