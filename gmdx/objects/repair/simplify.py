"""Fewer triangles for a surface that has more than physics and rendering need."""

from dataclasses import dataclass, replace

import fast_simplification
import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import MeshError
from gmdx.objects.manifold import from_manifold, to_manifold
from gmdx.objects.repair.read import is_closed, is_consistent
from gmdx.objects.repair.solid import misfit
from gmdx.objects.surface import SurfaceIndex, surface_samples
from gmdx.rng import generator

_SAMPLES = 5_000  # points at which the deviation is measured
_CARE = 3  # collapses edges in small steps: slower, and closer to the surface than the default 5


@dataclass(frozen=True)
class Simplified:
    """A surface with fewer triangles, and what that changed."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    method: str  # "quadrics" or "vertex removal"
    deviation: float  # largest distance of points of the dense surface, in the vertices' unit
    volume_ratio: float | None  # simplified / dense, None where there is no volume


def simplify_closed(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, max_faces: int, bound: float
) -> Simplified:
    """A closed surface with `max_faces` triangles if no point need move by more than `bound`.

    Quadric edge collapse keeps most with few triangles; where it deviates too far, or spoils
    the surface, vertices are taken out within a tolerance that is doubled until there are few
    enough or it would pass the bound. The number is a wish, the bound is kept.

    Raises:
        MeshError: The surface is not that of a solid.
    """
    solid = to_manifold(vertices, faces)
    if solid.is_empty():
        raise MeshError(f"the surface of {len(faces)} triangles is closed but not a manifold")
    quadric = simplify_open(vertices, faces, max_faces=max_faces)
    if quadric.deviation <= bound and is_closed(quadric.faces) and is_consistent(quadric.faces):
        ratio = float(to_manifold(quadric.vertices, quadric.faces).volume()) / float(solid.volume())
        if misfit(quadric.vertices, quadric.faces) == 0.0:
            return replace(quadric, volume_ratio=ratio)
    tolerance = bound / 64
    simple = solid.simplify(tolerance)
    while simple.num_tri() > max_faces and 2 * tolerance <= bound:
        tolerance *= 2
        simple = solid.simplify(tolerance)
    fewer_vertices, fewer_faces = from_manifold(simple)
    return Simplified(
        fewer_vertices,
        fewer_faces,
        "vertex removal",
        _deviation(vertices, faces, fewer_vertices, fewer_faces),
        float(simple.volume()) / float(solid.volume()),
    )


def simplify_open(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, max_faces: int
) -> Simplified:
    """Any surface with `max_faces` triangles, by quadric edge collapse (Garland and Heckbert)."""
    points, fewer = fast_simplification.simplify(vertices, faces, target_count=max_faces, agg=_CARE)
    points, fewer = np.asarray(points, float), np.asarray(fewer, np.int64)
    return Simplified(points, fewer, "quadrics", _deviation(vertices, faces, points, fewer), None)


def _deviation(
    vertices: Float[Array, "v 3"],
    faces: Int[Array, "f 3"],
    simple_vertices: Float[Array, "w 3"],
    simple_faces: Int[Array, "g 3"],
) -> float:
    """Largest distance of points of a surface from its simplified copy."""
    points, _ = surface_samples(vertices[faces], _SAMPLES, generator(0, "deviation"))
    index = SurfaceIndex(simple_vertices, simple_faces, n=4 * _SAMPLES, seed=0)
    return float(index.distance(points).max())
