"""Meshes as manifold solids, and back."""

import manifold3d
import numpy as np

from gmdx.arrays import Array, Float, Int


def to_manifold(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> manifold3d.Manifold:
    """A solid for Boolean operations; its `status()` says whether it is one."""
    return manifold3d.Manifold(
        manifold3d.Mesh64(
            np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64)
        )
    )


def from_manifold(
    solid: manifold3d.Manifold,
) -> tuple[Float[Array, "v 3"], Int[Array, "f 3"]]:
    """Vertices and faces of a solid."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], float), np.array(mesh.tri_verts, np.int64)


def unite(solids: list[manifold3d.Manifold]) -> manifold3d.Manifold:
    """The union of solids."""
    return manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add)


def without_voids(solid: manifold3d.Manifold) -> manifold3d.Manifold:
    """The solid with every closed-off empty space in it filled."""
    return without_specks(solid, smallest=0.0)


def without_specks(solid: manifold3d.Manifold, *, smallest: float) -> manifold3d.Manifold:
    """The solid without its voids, and without separate parts of up to the volume `smallest`."""
    return unite([part for part in solid.decompose() if part.volume() > smallest])
