"""Solids from surfaces that are not closed, by exact Boolean operations (Manifold library)."""

from dataclasses import dataclass

import manifold3d
import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.errors import MeshError
from gmdx.objects.manifold import from_manifold, to_manifold, unite, without_specks, without_voids
from gmdx.objects.repair.read import patches
from gmdx.objects.repair.winding import consistent_faces
from gmdx.objects.surface import surface_samples
from gmdx.rng import generator

# Where a triangle's two sides are looked at: its middle, and near its corners and edges.
_SAMPLES = np.array(
    [[1, 1, 1], [8, 1, 1], [1, 8, 1], [1, 1, 8], [5, 5, 1], [5, 1, 5], [1, 5, 5]], float
)
_SAMPLES /= _SAMPLES.sum(axis=1, keepdims=True)
_SHARPEST = 0.4  # cosine between a corner and its faces, below which it is not drawn out more
_CASTS = 20_000_000  # triangles times points at which a surface is tested for misfit
_OVERLAP = 1.02  # walls reach a little into the space that they close, so that no gap is left


@dataclass(frozen=True)
class Solid:
    """What became of a surface that was not closed."""

    vertices: Float[Array, "v 3"]
    faces: Int[Array, "f 3"]
    filled: int  # spaces that the surface had closed off, now full
    sheet_share: float  # part of the surface's area with open space on both sides, now shells


def misfit(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> float:
    """Share of a closed surface's area that does not part outside (0) from inside (1).

    Where a surface passes through itself or through another part, or is inside out, the winding
    numbers just off it are others than 0 and 1. Estimated at 50 to 400 points, by counting along a
    ray from each how often the surface is left and entered.
    """
    solid = to_manifold(vertices, faces)
    if solid.is_empty():
        return 1.0
    rng = generator(0, "misfit")
    n = int(np.clip(_CASTS / len(faces), 50, 400))
    points, owner = surface_samples(vertices[faces], n, rng)
    a, b, c = np.moveaxis(vertices[faces[owner]], 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    far = rng.standard_normal((n, 3))
    far *= 2 * diagonal / np.linalg.norm(far, axis=1, keepdims=True)
    wrong = 0
    for point, step, ray in zip(points, 1e-6 * diagonal * normal, far, strict=True):
        outside, inside = _crossings(solid, point + step, ray), _crossings(solid, point - step, ray)
        wrong += (outside, inside) != (0, 1)
    return wrong / n


def _crossings(solid: manifold3d.Manifold, start: Array, ray: Array) -> int:
    """How often a ray leaves a surface, less how often it enters: the winding number."""
    hits = solid.ray_cast(start.tolist(), (start + ray).tolist())
    return sum(1 if np.dot(hit.normal, ray) > 0 else -1 for hit in hits)


def thicken(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, thickness: float) -> Solid:
    """A solid from any triangles: closed-off space is filled, what is open becomes a shell.

    Every triangle is thickened to a prism, the convex hull of its two copies that are moved by
    half the thickness along the normals of its patch. The union of all prisms is a solid; the
    spaces it closes off are the inside of the object. Triangles with such a space on one side
    are then walls: they are thickened only towards it, so the surface stays where it was.
    Triangles with open space on both sides (the bowl of a glass, a fin) keep the full prism.

    Windings need not agree, and triangles may meet, cross and dangle as they like. Gaps wider
    than the thickness leave the space behind them open.

    Args:
        vertices: Of the triangles.
        faces: Triangles with an area.
        thickness: Of the shells, in the unit of the vertices.

    Raises:
        MeshError: The result is no solid.
    """
    half = 0.5 * thickness
    faces, _ = consistent_faces(faces)
    normals = _corner_normals(vertices, faces)
    corners = vertices[faces]
    above, below = corners + half * normals, corners - half * normals
    prisms = unite(_prisms(above, below))
    filled = without_voids(prisms)
    space = filled - prisms
    space_above, space_below = _sides(corners, space, half)
    open_above, open_below = _sides(corners, filled, half)
    # Triangles that pass through others can be wall in one place and inside in another; what is
    # too much of a wall then lies inside, and what is inside with space on both sides needs none.
    sheet = open_above & open_below
    wall_above = np.any(space_above & ~space_below, axis=1)
    wall_below = np.any(space_below & ~space_above, axis=1)
    inner = _OVERLAP * half * normals
    solid = unite(
        [
            space,
            *_prisms(corners, corners + inner, select=wall_above),
            *_prisms(corners, corners - inner, select=wall_below),
            *_prisms(above, below, select=np.any(sheet, axis=1)),
        ]
    ).simplify(0.01 * thickness)
    solid = without_specks(solid, smallest=1e-3 * thickness**3)
    if solid.is_empty() or solid.volume() <= 0:
        raise MeshError("thickening the open surface gave no solid")
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    out_vertices, out_faces = from_manifold(solid)
    return Solid(
        vertices=out_vertices,
        faces=out_faces,
        filled=sum(part.volume() > thickness**3 for part in space.decompose()),
        sheet_share=float((area * sheet.mean(axis=1)).sum() / area.sum()),
    )


def _corner_normals(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]
) -> Float[Array, "f 3 3"]:
    """At each corner of each face, where it goes if all faces of its patch there move out by 1."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    face_normal = np.cross(b - a, c - a)
    face_normal /= np.maximum(np.linalg.norm(face_normal, axis=1, keepdims=True), 1e-300)
    key = faces + len(vertices) * patches(faces)[:, None]
    _, corner = np.unique(key, return_inverse=True)
    corner = corner.reshape(-1, 3)
    total = np.zeros((int(corner.max()) + 1, 3))
    weight = np.zeros(len(total))
    for i in range(3):  # weighted by the angle, so that the triangulation of a plane is no matter
        u = vertices[faces[:, (i + 1) % 3]] - vertices[faces[:, i]]
        v = vertices[faces[:, (i + 2) % 3]] - vertices[faces[:, i]]
        angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(axis=1))
        np.add.at(total, corner[:, i], angle[:, None] * face_normal)
        np.add.at(weight, corner[:, i], angle)
    mean = total / np.maximum(weight, 1e-300)[:, None]
    # |mean| is the cosine between it and the faces: lengthened so that they move by 1
    mean /= np.maximum((mean * mean).sum(axis=1), _SHARPEST**2)[:, None]
    result = mean[corner]
    against = (result * face_normal[:, None]).sum(axis=2) < 0.2  # a spike: the mean is sideways
    return np.where(against[:, :, None], face_normal[:, None], result)


def _prisms(
    above: Float[Array, "f 3 3"], below: Float[Array, "f 3 3"], *, select: Array | None = None
) -> list[manifold3d.Manifold]:
    """The convex hulls of pairs of triangles, flat ones left out."""
    points = np.concatenate([above, below], axis=1)
    if select is not None:
        points = points[select]
    hulls = [manifold3d.Manifold.hull_points(p) for p in points]
    return [hull for hull in hulls if not hull.is_empty()]


def _sides(
    corners: Float[Array, "f 3 3"], solid: manifold3d.Manifold, half: float
) -> tuple[Bool[Array, "f 7"], Bool[Array, "f 7"]]:
    """Whether a boundary of a solid is close above, and close below, points of each triangle."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    points = np.einsum("sk,fki->fsi", _SAMPLES, corners).reshape(-1, 3)
    offset = 1.5 * half * np.repeat(normal, len(_SAMPLES), axis=0)
    above = [_hits(solid, p, p + d) for p, d in zip(points, offset, strict=True)]
    below = [_hits(solid, p, p - d) for p, d in zip(points, offset, strict=True)]
    shape = (len(corners), len(_SAMPLES))
    return np.reshape(above, shape), np.reshape(below, shape)


def _hits(solid: manifold3d.Manifold, start: Array, end: Array) -> bool:
    return len(solid.ray_cast(start.tolist(), end.tolist())) > 0
