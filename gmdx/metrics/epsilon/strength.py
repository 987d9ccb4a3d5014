"""How much of a given load a grasp resists, with the contact forces that do it.

epsilon asks for the weakest direction; here the direction is given, so that the answer is one
second-order cone programme, exact to the solver's accuracy and bracketed by its dual.
"""

import logging
from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike

from gmdx.arrays import Array, Float
from gmdx.errors import MetricError
from gmdx.metrics.epsilon._arguments import as_float, as_floats, check_proportions
from gmdx.metrics.epsilon._conic import ConicSolution, solve_conic
from gmdx.metrics.epsilon._local import starting_directions, unit
from gmdx.metrics.epsilon.wrench import (
    PrincipalAxes,
    WrenchCones,
    check_contacts,
    principal_axes,
    support,
    tangents,
    wrench_cones,
)
from gmdx.scenes.physics import GRAVITY

_LOG = logging.getLogger("gmdx")
_FLAT = 1e-11  # relative width of directions in which the contacts exert nothing
_NEAR_ZERO = 1e-8  # of the unit force: a strength below it cannot be told from none
_LEAST = 1e-100  # N, of a load
_ZERO = np.zeros(3)
_ZERO.flags.writeable = False
_CORRECTIONS = 3  # of the solver's forces, until they balance to rounding


@dataclass(frozen=True)
class Strength:
    """The load that a grasp resists for each newton of grip, between bounds.

    The grip is the sum of the normal forces: a two-finger gripper that closes with 20 N
    presses with 20 N on either side, so its grip is 40 N and it resists 40 x value x wrench.
    """

    lower: float  # 1/N, of the wrench: `forces` and `moments` balance this much of it
    upper: float  # 1/N, proved by `direction`
    forces: Float[Array, "k 3"]  # N/N, on the object, in the frame of the points
    moments: Float[Array, "k"]  # m (N m/N), on the object, about each contact's inward normal
    imbalance: float  # N/N, left over by the forces, torques divided by the torque scale
    direction: Float[
        Array, "6"
    ]  # unit: normal (force, torque / torque_scale) of a supporting plane

    @property
    def value(self) -> float:
        """The largest multiple of the wrench that is resisted for each newton of grip, 1/N."""
        return self.lower

    @property
    def gap(self) -> float:
        """(upper - lower) / upper; 0 where the grasp does not resist the wrench at all."""
        return max(0.0, self.upper - self.lower) / max(self.upper, 1e-300)


def directional_strength(
    points: ArrayLike,
    normals: ArrayLike,
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: ArrayLike,
    wrench: ArrayLike,
) -> Strength:
    """The largest multiple of a load that a grasp resists, and the contact forces that do it.

    `wrench` is the load, what the surroundings exert *on* the object (gravity, an inertial
    force, a push); the contacts exert its opposite. The value t is the largest number for which
    contact forces within their friction limits, with normal forces that sum to at most 1 N,
    balance t x wrench. Multiplied by the grip (the sum of the normal forces, N) it is the
    largest multiple of the wrench that the grasp resists; a value of at least 1 / grip means
    that the wrench itself is resisted. It is 0 where no forces oppose the wrench at all.

    With h the support function of the grasp wrench space and e the wrench,
    t = min over u with u . (-e) = 1 of max(h(u), 0): the primal gives `lower` and the forces,
    the dual's u gives `upper`. Of a wrench whose (force, torque / torque_scale) is of unit
    length t is never less than epsilon; at the opposite of epsilon's worst direction it equals
    epsilon. The value does not depend on `torque_scale`, which only sets the length of wrenches.

    Args:
        points: Contact points, shape (k, 3), k >= 1, m.
        normals: Unit normals into the object, shape (k, 3).
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma: torsional moment a unit normal force resists, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, shape (3,), m.
        wrench: Load on the object, shape (6,): force, N, and torque about `origin`, N m;
            `gravity_wrench` makes that of its weight.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    p, n = as_floats(points, "points"), as_floats(normals, "normals")
    o, load = as_floats(origin, "origin"), as_floats(wrench, "wrench")
    mu, gamma = as_float(friction, "friction"), as_float(torsion, "torsion")
    scale = as_float(torque_scale, "torque_scale")
    check_contacts(p, n, friction=mu, torsion=gamma, torque_scale=scale, origin=o)
    check_proportions(p, friction=mu, torsion=gamma, torque_scale=scale, origin=o)
    if p.ndim != 2:
        raise MetricError(f"points must have shape (k, 3), not {p.shape}")
    if load.shape != (6,) or not np.isfinite(load).all():
        raise MetricError(f"wrench must be six finite numbers, force and torque, not {load}")
    if not load.any():
        raise MetricError("wrench is zero: any multiple of it is resisted")
    with np.errstate(over="ignore", under="ignore"):
        opposed = -load / np.repeat([1.0, scale], 3)
        size = float(np.linalg.norm(opposed))
    if not _LEAST <= size <= 1.0 / _LEAST:
        raise MetricError(f"wrench is out of range: {size:.3g} N, torques over torque_scale")
    cones = wrench_cones(p, n, friction=mu, torsion=gamma, torque_scale=scale, origin=o)
    found = _strongest(cones, opposed / size)
    balance = found.shares.reshape(-1) @ cones.columns - found.lower * opposed / size
    t1, t2 = tangents(n)
    pressed, slip1, slip2, twist = found.shares.T[..., None]
    return Strength(
        lower=found.lower / size,
        upper=found.upper / size,
        forces=pressed * n + mu * (slip1 * t1 + slip2 * t2),
        moments=gamma * twist[:, 0],
        imbalance=float(np.linalg.norm(balance)),
        direction=found.direction,
    )


def gravity_wrench(
    mass: float,
    down: ArrayLike,
    *,
    center_of_mass: ArrayLike = _ZERO,
    origin: ArrayLike = _ZERO,
    gravity: float = GRAVITY,
) -> Float[Array, "6"]:
    """The weight of an object as a load for `directional_strength`.

    Args:
        mass: kg.
        down: Which way gravity pulls in the frame of the contacts, shape (3,), of any length.
        center_of_mass: Where it acts, shape (3,), m; in an `ObjectModel`'s frame the origin.
        origin: Point about which the torque is taken, shape (3,), m.
        gravity: Acceleration, m/s^2.

    Returns:
        Force, N, and torque about `origin`, N m.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    vectors = {"down": down, "center_of_mass": center_of_mass, "origin": origin}
    checked = {name: as_floats(value, name) for name, value in vectors.items()}
    for name, vector in checked.items():
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise MetricError(f"{name} must be three finite coordinates, not {vector}")
    if not checked["down"].any():
        raise MetricError("down is zero: say which way gravity pulls")
    for name, value in (("mass", mass), ("gravity", gravity)):
        if not 0 < as_float(value, name) < np.inf:
            raise MetricError(f"{name} must be a finite number > 0, not {value}")
    force = mass * gravity * checked["down"] / np.linalg.norm(checked["down"])
    return np.concatenate([force, np.cross(checked["center_of_mass"] - checked["origin"], force)])


@dataclass(frozen=True)
class _Strongest:
    """How far K (with 0) reaches along a unit direction."""

    lower: float
    upper: float
    shares: Float[Array, "k 4"]  # a_i, x_i with |x_i| <= a_i, sum a_i <= 1
    direction: Float[Array, "6"]  # unit u, upper = max(h(u), 0) / (u . d)


def _strongest(cones: WrenchCones, d: Float[Array, "6"]) -> _Strongest:
    """Maximise t with sum_i a_i c_i + B_i x_i = t d, |x_i| <= a_i, sum_i a_i <= 1."""
    principal = principal_axes(cones)
    nothing = np.zeros((len(cones.centers), 4))
    exerted = principal.widths > _FLAT * principal.widths[-1]
    across = principal.axes[:, ~exerted]
    beyond = across @ (across.T @ d)
    if np.linalg.norm(beyond) > _NEAR_ZERO:
        return _bounded(cones, d, nothing, unit(beyond)[None])
    # In coordinates in which K is round the programme is well-posed.
    rounding = (principal.axes / np.where(exerted, principal.widths, 1.0))[:, exerted]
    reach = float(np.linalg.norm(d @ rounding))
    columns = cones.columns @ rounding
    found = _solution(columns, d @ rounding / reach)
    x, z = found.x, found.z
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        _LOG.warning("directional strength: the solver failed, so its bounds are wide")
        return _bounded(cones, d, nothing, starting_directions(cones, 400))
    shares = _balanced(_admissible(x[1:].reshape(-1, 4)), cones, principal, d)
    normal = rounding @ z[: columns.shape[1]]
    return _bounded(cones, d, shares, np.stack([normal, -normal]))


def _bounded(
    cones: WrenchCones,
    d: Float[Array, "6"],
    shares: Float[Array, "k 4"],
    normals: Float[Array, "m 6"],
) -> _Strongest:
    """What forces and normals of supporting planes prove."""
    along = normals @ d
    facing = unit(normals[along > 0]) if (along > 0).any() else d[None]
    bounds = np.maximum(support(cones, facing), 0.0) / (facing @ d)
    upper, direction = float(bounds.min()), facing[int(bounds.argmin())]
    lower = float(shares.reshape(-1) @ cones.columns @ d)
    if upper <= _NEAR_ZERO * np.abs(cones.columns).max() or lower <= 0:
        lower, shares = 0.0, np.zeros_like(shares)
    return _Strongest(lower, max(upper, lower), shares, direction)


def _solution(columns: Float[Array, "r d"], target: Float[Array, "d"]) -> ConicSolution:
    """(t, a_1, x_1, ...), with the multipliers of the balance, of the sum and of the limits."""
    r, d = columns.shape
    balance = np.concatenate([-target[:, None], columns.T], axis=1)
    total = np.zeros((1, 1 + r))
    total[0, 1::4] = 1.0
    forces = np.concatenate([np.zeros((r, 1)), -np.eye(r)], axis=1)
    b = np.zeros(d + 1 + r)
    b[d] = 1.0
    q = np.zeros(1 + r)
    q[0] = -1.0
    return solve_conic(
        q,
        scipy.sparse.csc_matrix(np.concatenate([balance, total, forces])),
        b,
        [clarabel.ZeroConeT(d), clarabel.NonnegativeConeT(1)]
        + [clarabel.SecondOrderConeT(4)] * (r // 4),
        tol=1e-11,
        feasibility=1e-11,
        absolute=1e-11,
    )


def _balanced(
    shares: Float[Array, "k 4"],
    cones: WrenchCones,
    principal: PrincipalAxes,
    d: Float[Array, "6"],
) -> Float[Array, "k 4"]:
    """The forces, corrected where they bear most until they exert nothing but along d."""
    for _ in range(_CORRECTIONS):
        wrench = shares.reshape(-1) @ cones.columns
        weights = np.repeat(shares[:, 0], 4) + 1e-300
        basis = np.concatenate([cones.columns, -d[None]]) * np.append(weights, 1.0)[:, None]
        scaled = basis @ principal.rounding
        left = (wrench - (wrench @ d) * d) @ principal.rounding
        change = np.linalg.lstsq(scaled.T, -left, rcond=1e-13)[0][:-1] * weights
        shares = _admissible(shares + change.reshape(-1, 4))
    return shares


def _admissible(shares: Float[Array, "k 4"]) -> Float[Array, "k 4"]:
    """The nearest forces within the limit surfaces, their normal forces summing to at most 1."""
    pressed = np.maximum(shares[:, :1], 0.0)
    length = np.linalg.norm(shares[:, 1:], axis=1, keepdims=True)
    slip = shares[:, 1:] * np.minimum(1.0, pressed / np.maximum(length, 1e-300))
    both: Array = np.concatenate([pressed, slip], axis=1) / max(float(pressed.sum()), 1.0)
    return both
