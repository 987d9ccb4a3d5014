"""A closed surface with its normals and areas, and random points on it."""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float, Int


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
