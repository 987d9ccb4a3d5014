"""Stationary directions of the support function to machine precision."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.metrics.epsilon._local import unit
from gmdx.metrics.epsilon.wrench import WrenchCones, contact_supports, support

_ACTIVE = (3e-3, 1e-4, 5e-2, 1e-6)  # how near to the largest an active support may be
_APEX = 0.05  # |B_i^T u| / |B_i| below which a contact may be at its apex
_ITERATIONS = 7
_LONGEST = 0.3  # rad, of a step
_ALIKE = 1e-11  # relative difference of two values that are the same minimum
_CONVERGED = 1e-7  # rad: Newton's next error is its square


@dataclass(frozen=True)
class _Stationary:
    direction: Float[Array, "6"]
    admissible: bool  # converged, with pushing forces only


def polish(cones: WrenchCones, start: Float[Array, "6"]) -> Float[Array, "6"]:
    """The stationary direction next to `start` to machine precision, or `start` if none is lower.

    Newton's method on the conditions of optimality. Contacts whose support is nearly the
    largest are taken to be active; an active contact may sit at its apex (B_i^T u = 0).
    """
    best, best_value = start, float(support(cones, start))
    for active, apexes in _guesses(cones, start):
        found = _stationary(cones, start, active, apexes)
        value = float(support(cones, found.direction))
        if value < best_value:
            best, best_value = found.direction, value
        if found.admissible and value <= best_value + _ALIKE * abs(best_value):
            break
    return best


def _guesses(
    cones: WrenchCones, u: Float[Array, "6"]
) -> Iterator[tuple[Bool[Array, "k"], Bool[Array, "k"]]]:
    """Which contacts may be active, and which of them at their apexes, the likeliest first."""
    h = contact_supports(cones, u)
    slip = np.linalg.norm(cones.spreads @ u, axis=-1)
    size = np.linalg.norm(cones.spreads, axis=(1, 2))
    pointed = slip <= 1e-9 * size
    seen: set[bytes] = set()
    for tolerance in _ACTIVE:
        active = h >= h.max() - tolerance * max(abs(h.max()), 1e-9)
        if active.sum() > 7 or active.tobytes() in seen:
            continue
        seen.add(active.tobytes())
        yield active, active & pointed
        for i in np.flatnonzero(active & ~pointed & (slip < _APEX * size)):
            yield active, (active & pointed) | (np.arange(len(h)) == i)


def _stationary(
    cones: WrenchCones,
    start: Float[Array, "6"],
    active: Bool[Array, "k"],
    apexes: Bool[Array, "k"],
) -> _Stationary:
    """A few Newton steps for u, the forces a_i (and x_i at an apex), nu and the value h.

    sum_i a_i grad h_i(u) = nu u, h_i(u) = h, sum_i a_i = 1, |u| = 1; at an apex a_i s_i = x_i
    is free and B_i^T u = 0.
    """
    smooth, pointed = np.flatnonzero(active & ~apexes), np.flatnonzero(apexes)
    n, m = len(smooth), len(smooth) + len(pointed)
    spreads = cones.spreads[smooth]
    grams = np.swapaxes(spreads, 1, 2) @ spreads
    rounded = cones.centers[smooth]
    tips = np.concatenate([cones.centers[pointed], cones.spreads[pointed].reshape(-1, 6)])
    f = n + len(tips)
    u = start
    jacobian = np.zeros((8 + f, 8 + f))  # unknowns: u, a (and x), nu, h
    jacobian[6 : 6 + m, 7 + f] = -1.0
    jacobian[7 + f, 6 : 6 + m] = 1.0
    forces, nu, level = np.zeros(f), 0.0, float(support(cones, u))
    admissible = False
    for iteration in range(_ITERATIONS):
        pull = grams @ u
        length = np.sqrt(np.maximum(pull @ u, 0.0))
        if not (length > 1e-12).all():
            break
        slopes = np.concatenate([rounded + pull / length[:, None], tips])
        if iteration == 0:
            start_system = np.zeros((7, f + 1))
            start_system[:6, :f] = slopes.T
            start_system[:6, f] = -u
            start_system[6, :m] = 1.0
            first = np.linalg.lstsq(start_system, np.eye(7)[6], rcond=None)[0]
            forces, nu = first[:f], float(first[f])
        unit_pull = pull / length[:, None]
        weights = forces[:n] / length
        curved = np.tensordot(weights, grams, axes=1) - (unit_pull.T * weights) @ unit_pull
        jacobian[:6, :6] = curved - nu * np.eye(6)
        jacobian[:6, 6 : 6 + f] = slopes.T
        jacobian[6 : 6 + f, :6] = slopes
        jacobian[:6, 6 + f] = -u
        jacobian[6 + f, :6] = u
        residual = np.zeros(8 + f)
        residual[:6] = slopes.T @ forces - nu * u
        residual[6 : 6 + f] = slopes @ u  # h_i is homogeneous: h_i = grad h_i . u
        residual[6 : 6 + m] -= level
        residual[6 + f] = 0.5 * (u @ u - 1.0)
        residual[7 + f] = forces[:m].sum() - 1.0
        step = _solved(jacobian, -residual)
        turn = float(np.linalg.norm(step[:6]))
        if not np.isfinite(step).all():
            break
        step = step * min(1.0, _LONGEST / max(turn, 1e-300))
        u = unit(u + step[:6])
        forces, nu, level = forces + step[6 : 6 + f], nu + step[6 + f], level + step[7 + f]
        if turn < _CONVERGED:
            admissible = bool((forces[:m] > -1e-6).all())
            break
        if turn > _LONGEST and iteration >= 2:
            break
    return _Stationary(u, admissible)


def _solved(matrix: Float[Array, "n n"], rhs: Float[Array, "n"]) -> Float[Array, "n"]:
    """Newton's step; the shortest one where equal contacts leave it undetermined."""
    try:
        step: Array = np.linalg.solve(matrix, rhs)
    except np.linalg.LinAlgError:
        step = np.linalg.lstsq(matrix, rhs, rcond=1e-13)[0]
    return step
