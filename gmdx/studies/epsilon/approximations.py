"""The ways in which epsilon is usually approximated: hulls of chosen wrenches, random directions.

They are here to be compared with `gmdx.epsilon`, which needs none of them. A convex hull of
wrenches that the contacts can exert lies inside the grasp wrench space, so its epsilon is too
small; a minimum over some directions is too large. Neither says by how much.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from gmdx.arrays import Array, Float
from gmdx.errors import MetricError
from gmdx.metrics.epsilon import WrenchCones, check_contacts, support, wrench_cones
from gmdx.rng import generator


@dataclass(frozen=True)
class HullEpsilon:
    """Epsilon of the convex hull of some wrenches."""

    value: float  # radius of the largest ball about 0 inside the hull; 0 if 0 is outside
    vertices: Float[Array, "m 6"]  # (force, torque / torque_scale) for unit normal force
    facets: Float[Array, "f 7"]  # outward unit normals; minus their planes' distances from 0


@dataclass(frozen=True)
class DirectionBound:
    """The least support over some directions: an upper bound of epsilon."""

    value: float
    direction: Float[Array, "6"]  # unit


def linearised_epsilon(
    points: Float[Array, "k 3"],
    normals: Float[Array, "k 3"],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
    edges: int = 8,
    free_torsion: bool = False,
) -> HullEpsilon:
    """Epsilon with friction cones of so many edges and torsion as two more wrenches a contact.

    The limit surface becomes a bipyramid: tangential force and torsion share the friction
    linearly, |f_t| / friction + |tau_n| / torsion <= f_n, and not as an ellipse. More edges
    round its base and leave its slopes.

    Args:
        points: Contact points, m.
        normals: Unit normals into the object.
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, m.
        edges: Edges of each friction cone, at least 3.
        free_torsion: Whether torsion needs no normal force, as in the grasp matrix of Dex-Net
            2.0 (Mahler et al. 2017). The hull may then leave the grasp wrench space, and its
            epsilon be too large.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    if edges < 3:
        raise MetricError(f"edges must be at least 3, not {edges}")
    cones = _cones(points, normals, friction, torsion, torque_scale, origin)
    turn = 2.0 * np.pi * np.arange(edges) / edges
    rim = _exerted(cones, np.column_stack([np.cos(turn), np.sin(turn), np.zeros(edges)]))
    poles = np.stack([cones.spreads[:, 2], -cones.spreads[:, 2]], axis=1)
    if not free_torsion:
        poles = cones.centers[:, None] + poles
    return _hull(np.concatenate([rim, poles], axis=1).reshape(-1, 6))


def sampled_epsilon(
    points: Float[Array, "k 3"],
    normals: Float[Array, "k 3"],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
    samples: int = 16,
) -> HullEpsilon:
    """Epsilon with so many points of each contact's elliptic limit surface.

    Args:
        points: Contact points, m.
        normals: Unit normals into the object.
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, m.
        samples: Points a contact, at least 4, along a spherical spiral.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    if samples < 4:
        raise MetricError(f"samples must be at least 4, not {samples}")
    cones = _cones(points, normals, friction, torsion, torque_scale, origin)
    return _hull(_exerted(cones, _spiral(samples)).reshape(-1, 6))


def random_direction_bound(
    points: Float[Array, "k 3"],
    normals: Float[Array, "k 3"],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
    directions: int = 100_000,
    seed: int = 0,
) -> DirectionBound:
    """The least support over evenly random directions of the six-dimensional sphere.

    Args:
        points: Contact points, m.
        normals: Unit normals into the object.
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, m.
        directions: How many.
        seed: Of the directions.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    if directions < 1:
        raise MetricError(f"directions must be at least 1, not {directions}")
    cones = _cones(points, normals, friction, torsion, torque_scale, origin)
    u = _directions(directions, seed)
    h = support(cones, u)
    return DirectionBound(float(h.min()), u[h.argmin()])


def _cones(
    points: Float[Array, "k 3"],
    normals: Float[Array, "k 3"],
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
) -> WrenchCones:
    parameters = {"friction": friction, "torsion": torsion, "torque_scale": torque_scale}
    check_contacts(points, normals, **parameters, origin=origin)
    return wrench_cones(points, normals, **parameters, origin=origin)


def _exerted(cones: WrenchCones, s: Float[Array, "m 3"]) -> Float[Array, "k m 6"]:
    """Each contact's wrenches c + B s."""
    wrenches: Array = cones.centers[:, None] + np.einsum("mr,krj->kmj", s, cones.spreads)
    return wrenches


def _hull(wrenches: Float[Array, "m 6"]) -> HullEpsilon:
    # Joggled: merging Qhull's coplanar facets fails on wrenches, which lie in few flats.
    hull = ConvexHull(wrenches, qhull_options="QJ Pp")
    value = float((-hull.equations[:, -1]).min())
    return HullEpsilon(max(0.0, value), wrenches, hull.equations)


@lru_cache(maxsize=1)
def _directions(count: int, seed: int) -> Float[Array, "m 6"]:
    """Unit vectors, evenly random; kept for the next grasp."""
    u: Array = generator(seed, "random directions").normal(size=(count, 6))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u


def _spiral(count: int) -> Float[Array, "m 3"]:
    """Points spread evenly over the unit sphere: Fibonacci's spiral about the third axis."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
