"""Constructive solid geometry on solids and outlines, by manifold3d."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gmdx_assets.parametric.solids import Floats, Solid
from gmdx_assets.parametric.tidy import tidy


def _manifold(solid: Solid) -> Any:
    import manifold3d

    # An identity for each face keeps manifold3d from merging coplanar triangles into long ones.
    identity = np.arange(len(solid.faces), dtype=np.uint64)
    mesh = manifold3d.Mesh64(
        solid.vertices.astype(np.float64), solid.faces.astype(np.uint64), face_id=identity
    )
    return manifold3d.Manifold(mesh)


def combine(
    add: Sequence[Solid], subtract: Sequence[Solid] = (), *, shortest: float, tolerance: float
) -> Solid:
    """The union of some solids, less some others, without slivers where they meet.

    Args:
        add: Solids to unite.
        subtract: Solids to take away from the union.
        shortest: Shorter edges are collapsed where the surface allows it, m.
        tolerance: How far that may move the surface, m.
    """
    import manifold3d

    result = manifold3d.Manifold.batch_boolean([_manifold(s) for s in add], manifold3d.OpType.Add)
    for solid in subtract:
        result = result - _manifold(solid)
    mesh = result.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, float)[:, :3]
    faces = np.asarray(mesh.tri_verts, np.int64)
    return tidy(Solid(vertices, faces), shortest=shortest, tolerance=tolerance)


def outline(
    add: Sequence[Floats], subtract: Sequence[Floats] = (), *, fillet: float, detail: float
) -> list[Floats]:
    """Loops around a union of polygons less some others, with inner corners rounded.

    Args:
        add: (k, 2) counter-clockwise polygons to unite, m.
        subtract: Polygons to take away, m.
        fillet: Radius of the rounding where the united polygons meet, m.
        detail: Features smaller than this are dropped, m.

    Returns:
        Closed loops, (k, 2) each: outlines counter-clockwise, holes clockwise.
    """
    import manifold3d

    kind = manifold3d.JoinType.Round
    positive = manifold3d.FillRule.Positive
    united = manifold3d.CrossSection([np.asarray(p, float) for p in add], positive)
    united = united.offset(fillet, kind, 2.0, 48).offset(-fillet, kind, 2.0, 48)
    for polygon in subtract:
        united = united - manifold3d.CrossSection([np.asarray(polygon, float)], positive)
    return [np.asarray(loop, float) for loop in united.simplify(detail).to_polygons()]
