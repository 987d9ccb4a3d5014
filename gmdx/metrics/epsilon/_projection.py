"""Distance from the origin to a wrench space: epsilon where there is no force closure."""

from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse

from gmdx.arrays import Array, Float
from gmdx.metrics.epsilon._conic import solve_conic
from gmdx.metrics.epsilon.wrench import WrenchCones, support


@dataclass(frozen=True)
class Projection:
    """The point of K nearest to 0, and the direction that separates the two."""

    distance: float  # |w| of a point of K: dist(0, K) is at most this
    separation: float  # -h(direction): dist(0, K) is at least this
    direction: Float[Array, "6"]  # unit


def project_origin(cones: WrenchCones) -> Projection:
    """Project 0 onto K = conv(union of c_i + B_i s) by one second-order cone programme.

    Minimise |w| over w = sum_i a_i c_i + B_i x_i, |x_i| <= a_i, sum_i a_i = 1. The direction
    comes from the dual, which is more accurate than w / |w| where the distance is small.
    """
    k = len(cones.centers)
    columns = cones.columns  # (4k, 6): c_i, then the rows of B_i^T
    size = 1 + 4 * k  # distance bound, then (a_i, x_i)
    equality = np.zeros((1, size))
    equality[0, 1::4] = 1.0
    ball = np.zeros((7, size))
    ball[0, 0] = -1.0
    ball[1:, 1:] = -columns.T
    forces = np.zeros((4 * k, size))
    forces[:, 1:] = -np.eye(4 * k)
    b = np.zeros(1 + 7 + 4 * k)
    b[0] = 1.0
    q = np.zeros(size)
    q[0] = 1.0
    solution = solve_conic(
        q,
        scipy.sparse.csc_matrix(np.concatenate([equality, ball, forces])),
        b,
        [clarabel.ZeroConeT(1), clarabel.SecondOrderConeT(7)] + [clarabel.SecondOrderConeT(4)] * k,
        tol=1e-10,
        feasibility=1e-10,
        absolute=1e-10,
    )
    force, normal = solution.x[1:].reshape(k, 4), -solution.z[2:8]
    if not (np.isfinite(force).all() and np.isfinite(normal).all()):
        force = np.tile([1.0, 0.0, 0.0, 0.0], (k, 1))
        normal = -cones.centers.sum(axis=0)
    point = _inside(force) @ columns
    directions = [_unit(sign * c) for c in (normal, -point) for sign in (1.0, -1.0)]
    h = np.array([float(support(cones, u)) for u in directions])
    return Projection(float(np.linalg.norm(point)), float(-h.min()), directions[int(h.argmin())])


def _inside(force: Float[Array, "k 4"]) -> Float[Array, "r"]:
    """The nearest forces that obey every constraint exactly."""
    a = np.maximum(force[:, 0], 0.0)
    length = np.linalg.norm(force[:, 1:], axis=1)
    x = force[:, 1:] * np.minimum(1.0, a / np.maximum(length, 1e-300))[:, None]
    feasible: Array = np.concatenate([a[:, None], x], axis=1).ravel() / max(a.sum(), 1e-300)
    return feasible


def _unit(w: Float[Array, "6"]) -> Float[Array, "6"]:
    length = np.linalg.norm(w)
    return np.eye(6)[0] if length < 1e-300 else np.asarray(w / length)
