"""The epsilon quality of Ferrari and Canny, with exact soft-finger friction and proved bounds.

epsilon is the radius of the largest ball about 0 inside the grasp wrench space K, the convex
hull of what each contact can exert with normal forces that sum to 1; without force closure it
is minus the distance from 0 to K. It is the least value of K's support function h over unit
directions: any direction bounds it from above, while a bound from below needs a proof.

Sources: Ferrari and Canny, "Planning optimal grasps" (1992), the L1 form; Howe and Cutkosky,
"Practical force-motion models for sliding manipulation" (1996), the elliptic limit surface.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gmdx.arrays import Array, Bool, Float
from gmdx.errors import MetricError
from gmdx.metrics._certify import NEAR_ZERO, ContactSet, Method, certify
from gmdx.metrics.wrench import check_contacts, wrench_cones


@dataclass(frozen=True)
class Epsilon:
    """A grasp's epsilon quality between proved bounds."""

    lower: float  # proved
    upper: float  # h(direction), reached by an explicit wrench
    direction: Float[Array, "6"]  # unit: the wrench (force, torque / torque_scale) resisted least
    closure: bool  # whether force closure is proved (lower > 0)
    method: Method  # what proved `lower`

    @property
    def gap(self) -> float:
        """(upper - lower) / |upper|, relative to at least 1e-6."""
        return max(0.0, self.upper - self.lower) / max(abs(self.upper), 1e-6)

    def certified(self, rtol: float = 1e-4) -> bool:
        """Whether the bounds agree to `rtol`, or, near 0, to 1e-8 of the unit force."""
        return self.upper - self.lower <= max(rtol * abs(self.upper), NEAR_ZERO)


@dataclass(frozen=True)
class EpsilonBatch:
    """The epsilon qualities of n grasps; NaN for a grasp without contacts."""

    lower: Float[Array, "n"]  # proved
    upper: Float[Array, "n"]
    direction: Float[Array, "n 6"]  # unit; NaN where none was sought
    closure: Bool[Array, "n"]
    method: Array  # (n,) of Method


def epsilon(
    points: ArrayLike,
    normals: ArrayLike,
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: ArrayLike,
    rtol: float = 1e-4,
    most_points: int = 800,
) -> Epsilon:
    """Epsilon quality of one grasp, signed, between proved bounds.

    Args:
        points: Contact points, shape (k, 3), k >= 1, m.
        normals: Unit normals into the object, shape (k, 3).
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma: torsional moment a unit normal force resists, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, shape (3,), m.
        rtol: Relative gap to reach. Where it is not reached, the bounds say so.
        most_points: Most vertices of the inner polytope, the last resort for the lower bound;
            its time grows with more than their square (100: some 0.05 s, 800: seconds).

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    p, n, o = _floats(points, "points"), _floats(normals, "normals"), _floats(origin, "origin")
    parameters = {"friction": friction, "torsion": torsion, "torque_scale": torque_scale}
    check_contacts(p, n, **parameters, origin=o)
    _check_effort(rtol, most_points)
    if p.ndim != 2:
        raise MetricError(f"points must have shape (k, 3), not {p.shape}: use epsilon_batch")
    contacts = ContactSet(
        cones=wrench_cones(p, n, **parameters, origin=o),
        points=p / torque_scale,
        normals=n,
        friction=friction,
        torsion=torsion,
        rtol=rtol,
        most_points=most_points,
    )
    found = certify(contacts, signed=True)
    return Epsilon(found.lower, found.upper, found.direction, found.lower > 0, found.method)


def epsilon_batch(
    points: Float[Array, "n k 3"],
    normals: Float[Array, "n k 3"],
    valid: Bool[Array, "n k"],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
    rtol: float = 1e-4,
    signed: bool = False,
    most_points: int = 150,
) -> EpsilonBatch:
    """Epsilon qualities of n grasps with up to k contacts each.

    Args:
        points: Contact points, m; ignored where not valid.
        normals: Unit normals into the object; ignored where not valid.
        valid: Which contacts exist; a grasp without any gets NaN.
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, m.
        rtol: Relative gap to reach.
        signed: Whether to measure how far grasps without force closure are from it. If not,
            both their bounds are 0, the quality a dataset stores, and no direction is sought.
        most_points: As in `epsilon`; by default a grasp takes at most some 0.1 s.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    parameters = {"friction": friction, "torsion": torsion, "torque_scale": torque_scale}
    if valid.any():
        check_contacts(points[valid], normals[valid], **parameters, origin=origin)
    _check_effort(rtol, most_points)
    points, normals = (np.where(valid[..., None], a, 0.0) for a in (points, normals))
    cones = wrench_cones(points, normals, **parameters, origin=origin)
    n = len(points)
    lower, upper, direction = np.full(n, np.nan), np.full(n, np.nan), np.full((n, 6), np.nan)
    method = np.full(n, "no contact", dtype="<U12")
    for i in np.flatnonzero(valid.any(axis=1)):
        contacts = ContactSet(
            cones=cones[i][valid[i]],
            points=points[i, valid[i]] / torque_scale,
            normals=normals[i, valid[i]],
            friction=friction,
            torsion=torsion,
            rtol=rtol,
            most_points=most_points,
        )
        found = certify(contacts, signed=signed)
        lower[i], upper[i], direction[i] = found.lower, found.upper, found.direction
        method[i] = found.method
    return EpsilonBatch(lower, upper, direction, lower > 0, method)


def _floats(value: ArrayLike, name: str) -> Array:
    try:
        array: Array = np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise MetricError(f"{name} must be an array of numbers: {error}") from error
    return array


def _check_effort(rtol: float, most_points: int) -> None:
    if not 1e-7 <= rtol <= 0.5:
        raise MetricError(f"rtol must be between 1e-7 and 0.5, not {rtol}")
    if most_points < 0:
        raise MetricError(f"most_points must be at least 0, not {most_points}")
