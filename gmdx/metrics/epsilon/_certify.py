"""One grasp's epsilon: from its contacts' wrench cones to bounds that are proved."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.metrics.epsilon._incremental import polytope_bounds
from gmdx.metrics.epsilon._local import Minima, descend, starting_directions
from gmdx.metrics.epsilon._polish import polish
from gmdx.metrics.epsilon._projection import project_origin
from gmdx.metrics.epsilon._relaxation import LowerBound, relaxation_bound
from gmdx.metrics.epsilon.wrench import WrenchCones, pair_closure, principal_axes, support

Method = Literal["relaxation", "polytope", "projection", "flat", "no closure", "no contact"]

NEAR_ZERO = 1e-8  # of the unit force: bounds this near to each other agree, whatever their ratio
_FLAT = 1e-11  # relative width below which the contacts span fewer than six dimensions
_STARTS = 6
_SUSPECT = 0.02  # of the unit force: a search that ends lower has often met no closure


@dataclass(frozen=True)
class Bounds:
    """What is known about one grasp's epsilon."""

    lower: float
    upper: float
    direction: Float[Array, "6"]  # unit
    method: Method


@dataclass(frozen=True)
class ContactSet:
    """One grasp's contacts and how well its epsilon is to be known."""

    cones: WrenchCones
    points: Float[Array, "k 3"]  # divided by the torque scale
    normals: Float[Array, "k 3"]
    friction: float
    torsion: float
    rtol: float
    most_points: int  # of the polytope


# Without closure both bounds of the unsigned value are 0.
_NO_CLOSURE = Bounds(0.0, 0.0, np.full(6, np.nan), "no closure")


def _refuted(upper: float, direction: Float[Array, "6"]) -> Bounds:
    """No closure, by a direction along which nothing is exerted."""
    return Bounds(-np.inf, upper, direction, "no closure")


def certify(contacts: ContactSet, *, signed: bool) -> Bounds:
    """Bounds of epsilon by the cheapest route that proves them.

    Two contacts: closure by Nguyen's test or by projection, then one semidefinite relaxation,
    exact on every pair seen so far. More contacts: a local search, then the inner polytope,
    which is also what remains for pairs whose relaxation the solver leaves blunt. (With products
    of many pairs the relaxation is slower than the polytope, and often loose.)

    Args:
        contacts: The grasp.
        signed: Whether to measure how far a grasp without closure is from it, or to leave
            its value at 0.
    """
    if not _spans(contacts.cones):
        found = _flat(contacts)
    elif len(contacts.points) == 2:
        found = _pair(contacts)
    else:
        found = _several(contacts)
    if signed and found.method == "no closure":
        away = project_origin(contacts.cones)
        upper, u = -away.separation, away.direction
        if found.upper < upper:
            upper, u = found.upper, found.direction
        found = Bounds(min(-away.distance, upper), upper, u, "projection")
    if not signed and found.upper <= 0:
        return _NO_CLOSURE
    if not signed and found.lower < 0:
        return replace(found, lower=0.0)
    return found


def _flat(contacts: ContactSet) -> Bounds:
    """K is flat to rounding: epsilon is about 0 if K holds 0, else it is negative."""
    away = project_origin(contacts.cones)
    if away.separation > NEAR_ZERO:
        return _NO_CLOSURE
    normal = principal_axes(contacts.cones).axes[:, 0]
    upper = float(support(contacts.cones, normal))
    return Bounds(min(-away.distance, upper), upper, normal, "flat")


def _pair(contacts: ContactSet) -> Bounds:
    cones, both = contacts.cones, ((0, 1),)
    closed = pair_closure(contacts.points, contacts.normals, friction=contacts.friction)
    if not closed and project_origin(cones).separation > 0:
        return _NO_CLOSURE
    tol = min(0.02 * contacts.rtol, 2e-6)
    bound = relaxation_bound(cones, both, transposed=False, tol=tol)
    guesses = bound.directions if len(bound.directions) else starting_directions(cones, 1)
    u = polish(cones, guesses[support(cones, guesses).argmin()])
    if not _enough(contacts, bound.value, u):
        # Ties between worst wrenches blur the guess; a blunt solution, the bound.
        bound = _better(bound, relaxation_bound(cones, both, transposed=True, tol=1e-3 * tol))
        starts = np.concatenate([bound.directions, starting_directions(cones, _STARTS)])
        found = _descended(cones, starts, 1e-9).directions[:3]
        u = min([u, *(polish(cones, d) for d in found)], key=lambda d: float(support(cones, d)))
    return _finish(contacts, bound, u)


def _several(contacts: ContactSet) -> Bounds:
    cones, rtol = contacts.cones, contacts.rtol
    found = _descended(cones, starting_directions(cones, _STARTS), rtol)
    if found.values[0] <= 0:
        return _refuted(float(found.values[0]), found.directions[0])
    if found.values[0] < _SUSPECT and project_origin(cones).separation > 0:
        return _NO_CLOSURE
    return _finish(contacts, LowerBound(0.0, found.directions), polish(cones, found.directions[0]))


def _finish(contacts: ContactSet, bound: LowerBound, u: Float[Array, "6"]) -> Bounds:
    """The bounds, by the polytope where the relaxation was not enough."""
    cones, rtol = contacts.cones, contacts.rtol
    upper = float(support(cones, u))
    if _enough(contacts, bound.value, u):
        return Bounds(min(bound.value, upper), upper, u, "relaxation")
    guesses = np.concatenate([u[None], bound.directions])
    grown = polytope_bounds(cones, guesses, rtol=rtol, most_points=contacts.most_points)
    if grown.upper < upper:
        u = polish(cones, grown.direction) if grown.upper > 0 else grown.direction
        upper = float(support(cones, u))
    if upper <= 0:
        return _refuted(upper, u)
    lower = max(bound.value, grown.lower)
    if lower <= 0:  # too little closure to show in a polytope
        away = project_origin(cones)
        if away.separation > 0:
            upper, u = -away.separation, away.direction
        return Bounds(min(-away.distance, upper), upper, u, "projection")
    method: Method = "polytope" if grown.lower >= bound.value else "relaxation"
    return Bounds(min(lower, upper), upper, u, method)


def _enough(contacts: ContactSet, lower: float, u: Float[Array, "6"]) -> bool:
    upper = float(support(contacts.cones, u))
    return lower > 0 and upper - lower <= contacts.rtol * upper


def _better(one: LowerBound, other: LowerBound) -> LowerBound:
    return other if other.value >= one.value else one


def _descended(cones: WrenchCones, starts: Float[Array, "m 6"], tol: float) -> Minima:
    """Local minima, or the one start that shows that there is no closure."""
    h = support(cones, starts)
    if h.min() <= 0:
        return Minima(starts[h.argmin()][None], h.min()[None])
    return descend(cones, starts, tol=tol)


def _spans(cones: WrenchCones) -> bool:
    """Whether the contacts span all six dimensions."""
    widths = principal_axes(cones).widths
    return bool(widths[0] > _FLAT * widths[-1])
