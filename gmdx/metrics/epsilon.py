"""The epsilon quality of Ferrari and Canny, with exact soft-finger friction and proved bounds.

epsilon is the radius of the largest ball about 0 inside the grasp wrench space K, the convex
hull of what each contact can exert with normal forces that sum to 1; without force closure it
is minus the distance from 0 to K. It is the least value of K's support function h over unit
directions: any direction bounds it from above, while a bound from below needs a proof.

Sources: Ferrari and Canny, "Planning optimal grasps" (1992), the L1 form; Howe and Cutkosky,
"Practical force-motion models for sliding manipulation" (1996), the elliptic limit surface.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.metrics._incremental import polytope_bounds
from gmdx.metrics._local import Minima, descend, polish, starting_directions
from gmdx.metrics._projection import project_origin
from gmdx.metrics._relaxation import LowerBound, Pairs, relaxation_bound
from gmdx.metrics.wrench import (
    WrenchCones,
    check_contacts,
    contact_supports,
    pair_closure,
    support,
    wrench_cones,
)

Method = Literal["relaxation", "polytope", "projection", "flat", "no closure", "no contact"]

_FLAT = 1e-11  # relative width below which the contacts span fewer than six dimensions
_ZERO = 1e-8  # distance from K, in unit normal forces, that counts as touching
_STARTS = 6
_MOST_CONTACTS = 8  # of the relaxation: its cost grows with their pairs


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
        """Relative gap (upper - lower) / |upper|; 0 where both bounds are 0."""
        width = self.upper - self.lower
        return 0.0 if width <= 0 else width / max(abs(self.upper), 1e-300)

    def certified(self, rtol: float = 1e-4) -> bool:
        """Whether the bounds agree to `rtol`, or to 1e-8 of the unit force near 0."""
        return self.upper - self.lower <= max(rtol * abs(self.upper), _ZERO)


@dataclass(frozen=True)
class EpsilonBatch:
    """The epsilon qualities of n grasps."""

    lower: Float[Array, "n"]  # NaN without contacts
    upper: Float[Array, "n"]  # NaN without contacts
    direction: Float[Array, "n 6"]  # unit; NaN where none was sought
    closure: Bool[Array, "n"]
    method: Array  # (n,) of Method


def epsilon(
    points: Float[Array, "..."],
    normals: Float[Array, "..."],
    *,
    friction: float,
    torsion: float,
    torque_scale: float,
    origin: Float[Array, "..."],
    rtol: float = 1e-4,
    most_points: int = 1500,
) -> Epsilon:
    """Epsilon quality of one grasp, signed, between proved bounds.

    Args:
        points: Contact points, shape (k, 3), k >= 1, m.
        normals: Unit normals into the object, shape (k, 3).
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, shape (3,), m.
        rtol: Relative gap to reach. If it is not reached, the bounds say so.
        most_points: Most vertices of the inner polytope, the last resort for the lower bound.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    points, normals, origin = (np.asarray(a, float) for a in (points, normals, origin))
    check_contacts(
        points,
        normals,
        friction=friction,
        torsion=torsion,
        torque_scale=torque_scale,
        origin=origin,
    )
    cones = wrench_cones(
        points,
        normals,
        friction=friction,
        torsion=torsion,
        torque_scale=torque_scale,
        origin=origin,
    )
    return _Quality(cones, points / torque_scale, normals, friction, rtol, most_points).value(
        signed=True
    )


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
    most_points: int = 400,
) -> EpsilonBatch:
    """Epsilon qualities of n grasps with up to k contacts each.

    Args:
        points: Contact points, m.
        normals: Unit normals into the object.
        valid: Which contacts exist; a grasp without any gets NaN.
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, m.
        rtol: Relative gap to reach.
        signed: Whether to compute how far grasps without force closure are from it. If not,
            both their bounds are 0, the quality a dataset stores, and no direction is sought.
        most_points: As in `epsilon`.

    Raises:
        MetricError: An argument is not valid; the message names it.
    """
    n = len(points)
    lower, upper = np.full(n, np.nan), np.full(n, np.nan)
    direction = np.full((n, 6), np.nan)
    closure = np.zeros(n, bool)
    method = np.full(n, "no contact", dtype="<U12")
    parameters = {"friction": friction, "torsion": torsion, "torque_scale": torque_scale}
    for i in np.flatnonzero(valid.any(axis=1)):
        p, m = points[i, valid[i]], normals[i, valid[i]]
        check_contacts(p, m, **parameters, origin=origin)
        cones = wrench_cones(p, m, **parameters, origin=origin)
        one = _Quality(cones, p / torque_scale, m, friction, rtol, most_points).value(signed=signed)
        lower[i], upper[i], direction[i] = one.lower, one.upper, one.direction
        closure[i], method[i] = one.closure, one.method
    return EpsilonBatch(lower, upper, direction, closure, method)


@dataclass(frozen=True)
class _Quality:
    """One grasp on its way to a certified value."""

    cones: WrenchCones
    points: Float[Array, "k 3"]  # divided by the torque scale
    normals: Float[Array, "k 3"]
    friction: float
    rtol: float
    most_points: int

    def value(self, *, signed: bool) -> Epsilon:
        """The quality by the cheapest route that proves it."""
        w = np.linalg.svd(self.cones.columns, compute_uv=True, full_matrices=True)
        singular = w.S if len(w.S) == 6 else np.zeros(6)
        if singular[-1] <= _FLAT * singular[0]:
            return self._flat(w.Vh[-1], signed)
        if len(self.points) == 2:
            closed = bool(pair_closure(self.points, self.normals, friction=self.friction))
            return self._pair() if closed else self._open(signed)
        return self._several(signed)

    def _flat(self, normal: Float[Array, "6"], signed: bool) -> Epsilon:
        """K lies in a hyperplane through 0 (epsilon 0 if K holds 0) or misses 0."""
        away = project_origin(self.cones)
        if away.separation > _ZERO:
            return self._open(signed)
        return Epsilon(-away.distance, float(support(self.cones, normal)), normal, False, "flat")

    def _open(self, signed: bool) -> Epsilon:
        if not signed:
            return Epsilon(0.0, 0.0, np.full(6, np.nan), False, "no closure")
        away = project_origin(self.cones)
        return Epsilon(-away.distance, -away.separation, away.direction, False, "projection")

    def _pair(self) -> Epsilon:
        tol = 0.02 * self.rtol
        bound = relaxation_bound(self.cones, ((0, 1),), transposed=False, tol=tol)
        u = self._polished(bound)
        if not self._enough(bound.value, u):
            bound = _best(
                bound,
                relaxation_bound(self.cones, ((0, 1),), transposed=True, tol=1e-3 * tol),
            )
            starts = np.concatenate([bound.directions, starting_directions(self.cones, _STARTS)])
            found = self._descended(starts, 1e-9)
            candidates = [u, *(polish(self.cones, d) for d in found.directions[:3])]
            u = min(candidates, key=lambda d: float(support(self.cones, d)))
        return self._finish(bound.value, u, found_by=bound)

    def _several(self, signed: bool) -> Epsilon:
        found = self._descended(starting_directions(self.cones, _STARTS), 0.3 * self.rtol)
        u = found.directions[0]
        if found.values[0] <= 0:
            return self._open(signed)
        members = _bearing(found)
        bound = LowerBound(0.0, np.zeros((0, 6)))
        for pairs_of in (_nearest_pairs, _opposed_pairs, _opposed_pairs, _opposed_pairs):
            if len(members) > _MOST_CONTACTS:
                break
            index = np.array(members)
            part = self.cones[index]
            pairs = pairs_of(self.points[index], self.normals[index])
            if len(pairs) == 0 or _span(part) < 6:
                break
            latest = relaxation_bound(part, pairs, transposed=False, tol=0.1 * self.rtol)
            bound = _best(bound, latest)
            if self._enough(bound.value, u):
                break
            starts = latest.directions[support(self.cones, latest.directions) > 0]
            if len(starts):
                again = self._descended(starts, 0.3 * self.rtol)
                if again.values[0] < support(self.cones, u):
                    u, found = again.directions[0], again
            wanted = {*members, *_bearing(found)}
            if len(latest.directions):
                first = contact_supports(self.cones, latest.directions[0])
                wanted.add(int(first.argmax()))
            members = sorted(wanted)
        return self._finish(bound.value, u, found_by=bound)

    def _finish(self, lower: float, u: Float[Array, "6"], *, found_by: LowerBound) -> Epsilon:
        """The value, by the polytope where the relaxation was not enough."""
        if not self._enough(lower, u):
            u = polish(self.cones, u)
        upper = float(support(self.cones, u))
        if self._enough(lower, u):
            return Epsilon(min(lower, upper), upper, u, True, "relaxation")
        away = project_origin(self.cones)
        if away.separation > 0:
            return Epsilon(-away.distance, -away.separation, away.direction, False, "projection")
        guesses = np.concatenate([u[None], found_by.directions])
        grown = polytope_bounds(
            self.cones, guesses, rtol=self.rtol, most_points=self.most_points
        )
        if grown.upper < upper:
            upper, u = grown.upper, grown.direction
        best = max(lower, grown.lower, -away.distance)
        method: Method = "relaxation" if lower == best else "polytope"
        if best == -away.distance:
            method = "projection"
        return Epsilon(min(best, upper), upper, u, best > 0, method)

    def _enough(self, lower: float, u: Float[Array, "6"]) -> bool:
        upper = float(support(self.cones, u))
        return lower > 0 and upper - lower <= self.rtol * upper

    def _polished(self, bound: LowerBound) -> Float[Array, "6"]:
        """The lowest direction that the relaxation suggests, made exact."""
        if len(bound.directions) == 0:
            return starting_directions(self.cones, 1)[0]
        return polish(
            self.cones, bound.directions[support(self.cones, bound.directions).argmin()]
        )

    def _descended(self, starts: Float[Array, "m 6"], tol: float) -> Minima:
        h = support(self.cones, starts)
        if h.min() <= 0:
            shares = np.zeros((1, len(self.points)))
            return Minima(starts[h.argmin()][None], h.min()[None], shares)
        return descend(self.cones, starts, tol=tol)


def _best(one: LowerBound, other: LowerBound) -> LowerBound:
    return other if other.value >= one.value else one


def _span(cones: WrenchCones) -> int:
    """Dimensions that the contacts' wrenches span."""
    return int(np.linalg.matrix_rank(cones.columns, tol=None))


def _bearing(found: Minima) -> list[int]:
    """The contacts that bear the balancing wrench at the lowest minimum."""
    return [int(i) for i in np.flatnonzero(found.shares[0] > 0.004)]


def _opposed_pairs(points: Float[Array, "k 3"], normals: Float[Array, "k 3"]) -> Pairs:
    """All pairs whose normals oppose each other; all pairs if there are none."""
    i, j = np.triu_indices(len(points), 1)
    opposed = np.einsum("pa,pa->p", normals[i], normals[j]) < 0
    if not opposed.any():
        opposed[:] = True
    return tuple((int(a), int(b)) for a, b in zip(i[opposed], j[opposed], strict=True))


def _nearest_pairs(points: Float[Array, "k 3"], normals: Float[Array, "k 3"]) -> Pairs:
    """Each contact with the one that opposes it most nearly along the line between them."""
    facing = normals @ normals.T
    axis = normals[:, None] - normals[None]
    axis /= np.maximum(np.linalg.norm(axis, axis=-1, keepdims=True), 1e-12)
    apart = points[:, None] - points[None]
    sideways = np.linalg.norm(
        apart - np.einsum("ija,ija->ij", apart, axis)[..., None] * axis, axis=-1
    )
    cost = 3.0 * facing + sideways
    np.fill_diagonal(cost, np.inf)
    partner = cost.argmin(axis=1)
    chosen = {(min(i, int(j)), max(i, int(j))) for i, j in enumerate(partner)}
    return tuple(sorted(chosen))
