"""The prepared object: what physics, sampling, metrics and rendering all see."""

from dataclasses import dataclass, field
from typing import Any

from gmdx.arrays import Array, Float, Int


@dataclass(frozen=True)
class OrientedBox:
    """The minimum-volume box around an object, in the object's frame."""

    center: Float[Array, "3"]  # m
    axes: Float[Array, "3 3"]  # columns are the box's axes, in the order of the extents
    extents: Float[Array, "3"]  # m, edge lengths, longest first


@dataclass(frozen=True)
class StablePoses:
    """Quasi-static resting poses on a plane, most probable first."""

    quaternions: Float[Array, "p 4"]  # wxyz, object to world
    heights: Float[Array, "p"]  # m, of the centre of mass above the table
    probabilities: Float[Array, "p"]


@dataclass(frozen=True)
class ObjectModel:
    """One rigid body. The origin of its frame is its centre of mass."""

    object_id: str
    vertices: Float[Array, "v 3"]  # m, closed surface
    faces: Int[Array, "f 3"]  # outward, counter-clockwise
    hulls: tuple[Float[Array, "_ 3"], ...]  # m, vertices of each convex hull
    mass: float  # kg
    friction: float  # sliding coefficient
    inertia: Float[Array, "3 3"]  # kg m^2, about the centre of mass
    scale: float  # prepared length / source length
    box: OrientedBox
    stable_poses: StablePoses
    report: dict[str, Any] = field(default_factory=dict)  # JSON: source, repair, decomposition

    @property
    def radius(self) -> float:
        """Largest distance of a vertex from the centre of mass, m."""
        return float((self.vertices**2).sum(axis=1).max() ** 0.5)
