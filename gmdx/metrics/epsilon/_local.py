"""Upper bounds of epsilon: local maximisation of |v|^2 over the polar of the wrench space.

h(v) <= 1 describes a convex body, the polar of K, and epsilon is 1 / max |v| over it. Each
v on its boundary yields the upper bound h(v / |v|), however it was found.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.metrics.epsilon.wrench import WrenchCones, principal_axes, support
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


def starting_directions(cones: WrenchCones, count: int) -> Float[Array, "s 6"]:
    """The weakest of a fixed set of directions that are spread evenly where K is round."""
    principal = principal_axes(cones)
    u = np.concatenate([_sphere() @ principal.rounding.T, principal.axes.T])
    u = unit(np.concatenate([u, -u]))
    return u[np.argsort(support(cones, u), kind="stable")[:count]]


def descend(
    cones: WrenchCones, starts: Float[Array, "s 6"], *, tol: float, steps: int = 40
) -> Minima:
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
    best, best_value = starts, support(cones, starts)
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
        lead = best_value.argmin()
        if k * gap[lead] <= tol * norm[lead] ** 2 or not value.min() > 0:
            break
        # Rows that have converged to rounding would divide by zero: stop all of them there.
        if not (min(_det(s).min(), _det(y).min() / gap.max()) > 1e-26 and np.isfinite(v).all()):
            break
    order = np.argsort(best_value, kind="stable")
    return Minima(best[order], best_value[order])


@lru_cache(maxsize=1)
def _sphere() -> Float[Array, "p 6"]:
    """Fixed directions, evenly random."""
    return generator(0, "epsilon", "starts").standard_normal((_SAMPLES // 2, 6))


def unit(u: Float[Array, "*m 6"]) -> Float[Array, "*m 6"]:
    """Directions of length 1."""
    scaled: Array = u / np.linalg.norm(u, axis=-1, keepdims=True)
    return scaled


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
    reach = det / np.maximum(root, 1e-12 * det)
    apex = np.where(dy[..., 0] < 0, y[..., 0] / np.maximum(-dy[..., 0], 1e-12 * y[..., 0]), np.inf)
    least: Array = np.minimum(reach, apex).min(axis=1)
    return least


def _solve(matrix: Float[Array, "s 6 6"], rhs: Float[Array, "s 6"]) -> Float[Array, "s 6"]:
    """Newton's equations, with a trace of damping where a direction is all but free."""
    damping = 1e-14 * np.trace(matrix, axis1=1, axis2=2)
    step: Array = np.linalg.solve(matrix + damping[:, None, None] * np.eye(6), rhs[..., None])
    return step[..., 0]
