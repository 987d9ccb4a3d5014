"""How well a set of convex hulls stands for a surface: volumes, and distances both ways."""

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.objects.surface import SurfaceIndex


@dataclass(frozen=True)
class FidelityConfig:
    """How finely distances are measured, and what counts as within bounds."""

    samples: int = 10_000  # points on each of the two surfaces
    seed: int = 0  # of the points at which distances are measured
    distance: float = 1e-3  # m, bound on the 95th percentile, both directions
    volume: float = 0.05  # bound on |volume of the union / volume of the mesh - 1| of solids


@dataclass(frozen=True)
class Distances:
    """Distances of area-uniform points on one surface to another surface."""

    mean: float  # m
    p95: float  # m
    max: float  # m


@dataclass(frozen=True)
class Fidelity:
    """The union of the hulls compared with the mesh that it stands for."""

    volume_ratio: float  # volume of the union / volume of the mesh
    to_surface: Distances  # from the boundary of the union to the mesh
    from_surface: Distances  # from the mesh to the boundary of the union


def union_of_hulls(
    hulls: Sequence[Float[Array, "_ 3"]],
) -> tuple[Float[Array, "v 3"], Int[Array, "f 3"], float]:
    """Boundary of the union of convex hulls: vertices (m), outward faces, and volume (m^3)."""
    parts = [manifold3d.Manifold.hull_points(np.ascontiguousarray(h, float)) for h in hulls]
    union = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add)
    mesh = union.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], float)
    return vertices, np.array(mesh.tri_verts, np.int64), float(union.volume())


def measure_fidelity(
    hulls: Sequence[Float[Array, "_ 3"]],
    surface: SurfaceIndex,
    volume: float,
    *,
    config: FidelityConfig = FidelityConfig(),
) -> Fidelity:
    """Compare the union of hulls with a closed surface that encloses `volume` m^3."""
    vertices, faces, filled = union_of_hulls(hulls)
    boundary = SurfaceIndex(vertices, faces, n=config.samples, seed=config.seed)
    return Fidelity(
        volume_ratio=filled / volume,
        to_surface=_summary(surface.distance(boundary.samples)),
        from_surface=_summary(boundary.distance(surface.samples)),
    )


def _summary(distances: Float[Array, "n"]) -> Distances:
    return Distances(
        mean=float(distances.mean()),
        p95=float(np.percentile(distances, 95)),
        max=float(distances.max()),
    )
