"""Upper bounds of epsilon: local maximisation of |v|^2 over the polar of the wrench space.

h(v) <= 1 describes a convex body, the polar of K, and epsilon is 1 / max |v| over it. Each
v on its boundary yields the upper bound h(v / |v|), however it was found.
"""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.metrics.wrench import WrenchCones, contact_supports, support
from gmdx.rng import generator

_LORENTZ = np.array([1.0, -1.0, -1.0, -1.0])
_SAMPLES = 192
_CENTERING = 0.15  # how far each step lowers the barrier
_TO_BOUNDARY = 0.95
_TINY = 1e-300


@dataclass(frozen=True)
class Minima:
    """Local minima of the support function, one for each start, the lowest first."""

    directions: Float[Array, "s 6"]  # unit
    values: Float[Array, "s"]  # h at the directions
    shares: Float[Array, "s k"]  # which part of the balancing wrench each contact bears


def starting_directions(cones: WrenchCones, count: int) -> Float[Array, "s 6"]:
    """The weakest of a fixed set of directions that are spread evenly where K is round."""
    columns = cones.columns
    width, axes = np.linalg.eigh(columns.T @ columns)
    rounding = (axes / np.sqrt(np.maximum(width, 1e-24 * width[-1]))) @ axes.T
    sphere = generator(0, "epsilon", "starts").standard_normal((_SAMPLES // 2, 6))
    u = np.concatenate([sphere @ rounding, axes.T])
    u = unit(np.concatenate([u, -u]))
    return u[np.argsort(support(cones, u), kind="stable")[:count]]


def descend(cones: WrenchCones, starts: Float[Array, "s 6"], *, tol: float, steps: int = 40) -> Minima:
    """Local minima of h on the unit sphere, one from each start.

    A primal-dual interior-point method with Nesterov-Todd scaling on max g . v, h(v) <= 1,
    where g is renewed to v at every step (a linearised convex objective never overshoots).

    Args:
        cones: Contacts.
        starts: Directions with h > 0.
        tol: Relative accuracy at which to stop.
        steps: Most steps to take.
    """
    k, m = len(cones.centers), len(starts)
    G = np.concatenate([cones.centers[:, None], cones.spreads], axis=1)
    rows = G.reshape(4 * k, 6)
    curvature = np.einsum("kra,r,krb->kab", G, _LORENTZ, G).reshape(k, 36)
    v = 0.7 * starts / support(cones, starts)[:, None]
    s = -(v @ rows.T).reshape(m, k, 4)
    s[..., 0] += 1.0
    gap = 0.3 * np.einsum("sa,sa->s", v, v) / k
    y = gap[:, None, None] * s * _LORENTZ / _det(s)[..., None]
    best, best_value, shares = starts, support(cones, starts), y[..., 0]
    for _ in range(steps):
        det_s, det_y = _det(s), _det(y)
        root_s, root_y = np.sqrt(det_s), np.sqrt(det_y)
        ns, ny = s / root_s[..., None], y / root_y[..., None]
        w = ns + _LORENTZ * ny
        w /= np.sqrt(2.0 + 2.0 * np.einsum("skr,skr->sk", ns, ny))[..., None]
        ratio = root_y / root_s
        jw = w * _LORENTZ
        pull = (jw.transpose(1, 0, 2) @ G).transpose(1, 0, 2)
        scaled = pull * np.sqrt(2.0 * ratio)[..., None]
        hessian = scaled.transpose(0, 2, 1) @ scaled - (ratio @ curvature).reshape(m, 6, 6)
        gap = np.einsum("skr,skr->s", s, y) / k
        center = (_CENTERING * gap)[:, None, None] * s * _LORENTZ / det_s[..., None]
        dv = _solve(hessian, v - center.reshape(m, -1) @ rows)
        gdv = (dv @ rows.T).reshape(m, k, 4)
        along = np.einsum("ska,sa->sk", pull, dv)
        dy = center - y + ratio[..., None] * (2.0 * jw * along[..., None] - _LORENTZ * gdv)
        primal = np.minimum(1.0, _TO_BOUNDARY * _reach(s, -gdv, det_s))
        dual = np.minimum(1.0, _TO_BOUNDARY * _reach(y, dy, det_y))
        v = v + primal[:, None] * dv
        s = s - primal[:, None, None] * gdv
        y = y + dual[:, None, None] * dy
        norm = np.sqrt(np.einsum("sa,sa->s", v, v))
        value = support(cones, v) / norm
        better = value < best_value
        best = np.where(better[:, None], v / norm[:, None], best)
        best_value = np.where(better, value, best_value)
        shares = np.where(better[:, None], y[..., 0], shares)
        lead = best_value.argmin()
        if k * gap[lead] <= tol * norm[lead] ** 2 or not value.min() > 0:
            break
        # Rows that have converged to rounding would divide by zero: stop all of them there.
        if not (min(_det(s).min(), _det(y).min() / gap.max()) > 1e-26 and np.isfinite(v).all()):
            break
    order = np.argsort(best_value, kind="stable")
    total = np.maximum(shares.sum(axis=1, keepdims=True), _TINY)
    return Minima(best[order], best_value[order], (shares / total)[order])


def polish(cones: WrenchCones, start: Float[Array, "6"]) -> Float[Array, "6"]:
    """The stationary direction next to `start`, to machine precision, or `start` if none is.

    Newton's method on the conditions of optimality. Contacts whose support is nearly the
    largest are taken to be active; an active contact may sit at its apex (B_i^T u = 0).
    """
    best, best_value = start, float(support(cones, start))
    h = contact_supports(cones, start)
    slip = np.linalg.norm(cones.spreads @ start, axis=-1)
    size = np.linalg.norm(cones.spreads, axis=(1, 2))
    for active in _active_sets(h):
        flat = active & (slip <= 1e-9 * np.maximum(size, 1e-300))
        near = active & (slip < 0.05 * size) & ~flat
        for apexes in [flat, *(flat | (near & (np.arange(len(h)) == i)) for i in np.flatnonzero(near))]:
            u = _stationary(cones, start, active, apexes)
            value = float(support(cones, u))
            if value < best_value:
                best, best_value = u, value
    return best


def unit(u: Float[Array, "*m 6"]) -> Float[Array, "*m 6"]:
    """Directions of length 1."""
    scaled: Array = u / np.linalg.norm(u, axis=-1, keepdims=True)
    return scaled


def _active_sets(h: Float[Array, "k"]) -> list[Bool[Array, "k"]]:
    """Guesses of which contacts are active, without repeats."""
    top = h.max()
    sets: dict[bytes, Array] = {}
    for tolerance in (1e-6, 1e-4, 3e-3, 5e-2):
        active = h >= top - tolerance * max(abs(top), 1e-9)
        if active.sum() <= 7:
            sets.setdefault(active.tobytes(), active)
    return list(sets.values())


def _stationary(
    cones: WrenchCones,
    start: Float[Array, "6"],
    active: Bool[Array, "k"],
    apexes: Bool[Array, "k"],
) -> Float[Array, "6"]:
    """A few Newton steps for u, the forces a_i (and x_i at an apex) and the value h.

    sum_i a_i grad h_i(u) = nu u, h_i(u) = h, sum_i a_i = 1, |u| = 1; at an apex a_i s_i = x_i
    is free and B_i^T u = 0.
    """
    u = start
    smooth = np.flatnonzero(active & ~apexes)
    pointed = np.flatnonzero(apexes)
    order = np.concatenate([smooth, pointed])
    m, n = len(order), len(smooth)
    free = cones.spreads[pointed].reshape(-1, 6)
    multipliers = None
    for _ in range(6):
        slip = np.einsum("kra,a->kr", cones.spreads[smooth], u)
        length = np.linalg.norm(slip, axis=1)
        if (length < 1e-12).any():
            return start
        pull = np.einsum("kr,kra->ka", slip, cones.spreads[smooth])
        slopes = np.concatenate(
            [cones.centers[smooth] + pull / length[:, None], cones.centers[pointed], free]
        )
        supports = contact_supports(cones, u)[order]
        supports[n:] = cones.centers[pointed] @ u
        if multipliers is None:
            system = np.concatenate([slopes, -u[None]]).T
            total = np.zeros(len(slopes) + 1)
            total[:m] = 1.0
            multipliers = np.linalg.lstsq(
                np.concatenate([system, total[None]]), np.array([0.0] * 6 + [1.0]), rcond=None
            )[0]
            level = float(supports.mean())
        a, nu = multipliers[:-1], multipliers[-1]
        curved = (
            np.einsum("kra,krb->kab", cones.spreads[smooth], cones.spreads[smooth])
            - np.einsum("ka,kb->kab", pull, pull) / length[:, None, None] ** 2
        ) / length[:, None, None]
        f = len(slopes)
        jacobian = np.zeros((8 + f, 8 + f))  # unknowns: u, a, nu, h
        jacobian[:6, :6] = np.einsum("k,kab->ab", a[:n], curved) - nu * np.eye(6)
        jacobian[:6, 6 : 6 + f] = slopes.T
        jacobian[6 : 6 + f, :6] = slopes
        jacobian[:6, 6 + f] = -u
        jacobian[6 + f, :6] = u
        jacobian[6 : 6 + m, 7 + f] = -1.0
        jacobian[7 + f, 6 : 6 + m] = 1.0
        residual = np.concatenate(
            [
                slopes.T @ a - nu * u,
                supports - level,
                free @ u,
                [0.5 * (u @ u - 1.0), a[:m].sum() - 1.0],
            ]
        )
        step = np.linalg.lstsq(jacobian, -residual, rcond=1e-13)[0]
        length_u = np.linalg.norm(step[:6])
        step *= min(1.0, 0.3 / max(length_u, 1e-300))
        u = unit(u + step[:6])
        multipliers = np.concatenate([a + step[6 : 6 + f], [nu + step[6 + f]]])
        level += step[7 + f]
        if length_u < 1e-14:
            break
    return u


def _det(y: Float[Array, "s k 4"]) -> Float[Array, "s k"]:
    """y_0^2 - |y_rest|^2, positive inside the Lorentz cone."""
    rest = np.sqrt(np.einsum("skr,skr->sk", y[..., 1:], y[..., 1:]))
    det: Array = np.maximum((y[..., 0] - rest) * (y[..., 0] + rest), _TINY)
    return det


def _reach(
    y: Float[Array, "s k 4"], dy: Float[Array, "s k 4"], det: Float[Array, "s k"]
) -> Float[Array, "s"]:
    """The largest a with y + a dy in every contact's Lorentz cone."""
    signed = dy * _LORENTZ
    a = np.einsum("skr,skr->sk", dy, signed)
    b = np.einsum("skr,skr->sk", y, signed)
    root = np.sqrt(np.maximum(b * b - a * det, 0.0)) - b
    reach = det / np.maximum(root, _TINY)
    apex = np.where(dy[..., 0] < 0, y[..., 0] / np.maximum(-dy[..., 0], _TINY), np.inf)
    least: Array = np.minimum(reach, apex).min(axis=1)
    return least


def _solve(matrix: Float[Array, "s 6 6"], rhs: Float[Array, "s 6"]) -> Float[Array, "s 6"]:
    """Newton's equations, with a trace of damping where a direction is all but free."""
    damping = 1e-14 * np.trace(matrix, axis1=1, axis2=2)
    step: Array = np.linalg.solve(matrix + damping[:, None, None] * np.eye(6), rhs[..., None])
    return step[..., 0]
