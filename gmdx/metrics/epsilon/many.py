"""Epsilon qualities of many grasps at once: two contacts in bulk, more of them one by one."""

import time
from dataclasses import dataclass

import numpy as np
from gmdx_kernels.epsilon import IMPLEMENTATIONS, PairEpsilon, pair_epsilon

from gmdx.arrays import Array, Bool, Float
from gmdx.errors import MetricError
from gmdx.metrics.epsilon._arguments import check_proportions
from gmdx.metrics.epsilon._certify import NEAR_ZERO, ContactSet, certify
from gmdx.metrics.epsilon.certified import check_effort
from gmdx.metrics.epsilon.wrench import check_contacts, wrench_cones

KERNEL = "kernel"  # the method of values that the bulk kernel computed and proved


@dataclass(frozen=True)
class EpsilonBatch:
    """The epsilon qualities of n grasps; NaN for a grasp without contacts."""

    lower: Float[Array, "n"]  # proved
    upper: Float[Array, "n"]
    direction: Float[Array, "n 6"]  # unit; NaN where none was sought
    closure: Bool[Array, "n"]
    method: Array  # (n,) of Method, or `kernel`: what proved the lower bound
    bulk: Bool[Array, "n"]  # whether the bulk kernel alone decided
    seconds: Float[Array, "n"]  # processor time; the kernel's is shared out among its grasps


def epsilon_batch(
    points: Float[Array, "n k 3"],
    normals: Float[Array, "n k 3"],
    valid: Bool[Array, "n k"],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "3"],
    rtol: float | Float[Array, "n"] = 1e-4,
    rtol_bulk: float = 1e-4,
    signed: bool = False,
    most_points: int = 150,
    implementation: str = "numpy",
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
        rtol_bulk: Relative gap to which the bulk kernel works, whatever the others in the batch.
        signed: Whether to measure how far grasps without force closure are from it. If not,
            both their bounds are 0, the quality a dataset stores, and no direction is sought.
        most_points: As in `epsilon`; by default a grasp takes at most some 0.1 s.
        implementation: Of the bulk kernel for grasps of two contacts, one of
            `gmdx_kernels.epsilon.IMPLEMENTATIONS`. What it does not bound to `rtol` is computed
            as grasps of more contacts are, and says so in `method`.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    parameters = {"friction": friction, "torsion": torsion, "torque_scale": torque_scale}
    if valid.any():
        check_contacts(points[valid], normals[valid], **parameters, origin=origin)
        check_proportions(points[valid], **parameters, origin=origin)
    if implementation not in IMPLEMENTATIONS:
        known = ", ".join(IMPLEMENTATIONS)
        raise MetricError(f"no implementation {implementation!r} of the kernel: one of {known}")
    n = len(points)
    if np.shape(rtol) not in ((), (n,)):
        raise MetricError(f"rtol must be one number or {n}, not of shape {np.shape(rtol)}")
    tolerance = np.broadcast_to(np.asarray(rtol, float), n)
    for extreme in (tolerance.min(initial=0.5), tolerance.max(initial=1e-7), rtol_bulk):
        check_effort(float(extreme), most_points)
    lower, upper, direction = np.full(n, np.nan), np.full(n, np.nan), np.full((n, 6), np.nan)
    method, bulk, seconds = np.full(n, "no contact", "<U12"), np.zeros(n, bool), np.zeros(n)
    count = valid.sum(axis=1)

    pairs = np.flatnonzero(count == 2)
    slots = np.argsort(~valid[pairs], axis=1, kind="stable")[:, :2].reshape(len(pairs), 2)
    start = time.process_time()
    found = pair_epsilon(
        points[pairs[:, None], slots],
        normals[pairs[:, None], slots],
        friction=friction,
        torsion=torsion,
        torque_scale=torque_scale,
        origin=origin,
        rtol=rtol_bulk,
        implementation=implementation,
    )
    seconds[pairs] = (time.process_time() - start) / max(len(pairs), 1)
    apart = found.upper < -NEAR_ZERO  # of the unit force: beyond rounding
    done = _within(found, tolerance[pairs]) | (apart & (not signed))
    rows = pairs[done]
    lower[rows], upper[rows] = found.lower[done], found.upper[done]
    direction[rows], method[rows], bulk[rows] = found.direction[done], KERNEL, True
    if not signed:
        refused = pairs[apart]
        lower[refused] = upper[refused] = 0.0
        direction[refused], method[refused] = np.nan, "no closure"

    points, normals = (np.where(valid[..., None], a, 0.0) for a in (points, normals))
    cones = wrench_cones(points, normals, **parameters, origin=origin)
    for i in np.flatnonzero((count > 0) & ~bulk):
        start = time.process_time()
        contacts = ContactSet(
            cones=cones[i][valid[i]],
            points=points[i, valid[i]] / torque_scale,
            normals=normals[i, valid[i]],
            friction=friction,
            torsion=torsion,
            rtol=float(tolerance[i]),
            most_points=most_points,
        )
        one = certify(contacts, signed=signed)
        lower[i], upper[i], direction[i] = one.lower, one.upper, one.direction
        method[i] = one.method
        seconds[i] += time.process_time() - start
    return EpsilonBatch(lower, upper, direction, lower > 0, method, bulk, seconds)


def _within(found: PairEpsilon, rtol: Float[Array, "n"]) -> Bool[Array, "n"]:
    """Whether the kernel's bounds are signed alike and near enough to each other."""
    gap = found.upper - found.lower
    closed = (found.lower > 0) & (gap <= rtol * found.upper)
    apart = (found.upper < -NEAR_ZERO) & (gap <= np.maximum(-rtol * found.upper, NEAR_ZERO))
    return np.asarray(closed | apart)
