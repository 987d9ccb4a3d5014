"""The epsilon quality of Ferrari and Canny, with exact soft-finger friction and proved bounds."""

from dataclasses import dataclass

from numpy.typing import ArrayLike

from gmdx.arrays import Array, Float
from gmdx.errors import MetricError
from gmdx.metrics.epsilon._arguments import as_count, as_float, as_floats, check_proportions
from gmdx.metrics.epsilon._certify import NEAR_ZERO, ContactSet, Method, certify
from gmdx.metrics.epsilon.wrench import check_contacts, wrench_cones


@dataclass(frozen=True)
class Epsilon:
    """A grasp's epsilon quality between proved bounds; `epsilon` says what the fields mean."""

    lower: float  # proved
    upper: float  # h(direction), reached by an explicit wrench
    direction: Float[Array, "6"]  # unit: the wrench (force, torque / torque_scale) exerted least
    closure: bool  # whether force closure is proved (lower > 0)
    method: Method  # what proved `lower`

    @property
    def gap(self) -> float:
        """(upper - lower) / |upper|, relative to at least 1e-6."""
        return max(0.0, self.upper - self.lower) / max(abs(self.upper), 1e-6)

    def certified(self, rtol: float = 1e-4) -> bool:
        """Whether the bounds agree to `rtol`, or, near 0, to 1e-8 of the unit force."""
        return self.upper - self.lower <= max(rtol * abs(self.upper), NEAR_ZERO)


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

    **Definition.** Contact i at p_i with the inward unit normal n_i exerts a normal force f_n,
    tangential forces f_t and a torsional moment tau_n about its normal, within the elliptic
    limit surface of a soft finger, (|f_t| / friction)^2 + (tau_n / torsion)^2 <= f_n^2. A wrench
    is (force, torque about `origin` / torque_scale), in units of the normal force. What the
    contact exerts at f_n = 1 is the ellipsoid c_i + B_i s, |s| <= 1, and the grasp wrench space
    K is the convex hull of these ellipsoids: normal forces sum to 1, Ferrari and Canny's L1
    form. With force closure epsilon is the radius of the largest ball about 0 inside K; without,
    it is minus the distance from 0 to K. Either way it is the least value over unit vectors u
    of K's support function h(u) = max_i (c_i . u + |B_i^T u|): friction is exact, no cone is
    replaced by edges. Values of different `torsion` or `torque_scale` do not compare.

    **Bounds.** `upper` = h(direction) is a value of h, and so certain: no wrench is harder to
    exert than `direction` as far as the search went, and its opposite is the load resisted
    least (`directional_strength`). `lower` needs a proof, because the minimisation over the
    sphere is not convex. `method` names what proved it:

    - "relaxation": multipliers of a semidefinite relaxation that show h(u)^2 >= lower^2 |u|^2,
      checked by eigenvalues and not by the solver's word. In products of two contacts' cones
      it is exact on every grasp of two contacts tried, some 10,000; that it always is has not
      been proved, and need not be: each value carries its own proof. Only for two contacts.
    - "polytope": a closed surface of simplices around 0 with corners in K, all at `lower` or
      farther. It converges for any contacts, by ever more corners, up to `most_points`.
    - "projection": the point of K nearest to 0 and the plane between the two, by a
      second-order cone programme: without force closure that is all there is to compute.
    - "flat": the contacts span fewer than six dimensions (frictionless pairs, hard fingers, one
      contact), so that K has no interior and epsilon is 0 or negative.

    `closure` is true if force closure is proved (lower > 0). A value is `certified()` if the
    bounds agree to a relative 1e-4, or, near 0, to 1e-8 of the normal force. It is not certified,
    and says so by its bounds, if the effort allowed was not enough (many contacts, `rtol`
    below 1e-3, `most_points` small), and where closure could be neither proved nor refuted,
    because 0 is within rounding of K's boundary.

    Bounds are proved for the numbers given, up to rounding, which is allowed for.

    Args:
        points: Contact points, shape (k, 3), k >= 1, m.
        normals: Unit normals into the object, shape (k, 3).
        friction: Coulomb's coefficient mu.
        torsion: Torsional friction gamma: torsional moment a unit normal force resists, m.
        torque_scale: Length L by which torques are divided, m.
        origin: Point about which torques are taken, shape (3,), m.
        rtol: Relative gap to reach. Where it is not reached, the bounds say so.
        most_points: Most corners of the polytope, the last resort for the lower bound; its
            time grows faster than their number (100: some 0.02 s, 800: seconds).

    Raises:
        MetricError: An argument is not valid; the message names it.

    Sources: Ferrari and Canny, "Planning optimal grasps" (ICRA 1992), the L1 form; Howe and
    Cutkosky, "Practical force-motion models for sliding manipulation" (IJRR 1996), the limit
    surface. Positive forms on two Lorentz cones are sums of the relaxation's two families:
    Stormer (1963), Woronowicz (1976). Programmes are solved by Clarabel.
    """
    p, n = as_floats(points, "points"), as_floats(normals, "normals")
    o = as_floats(origin, "origin")
    mu, gamma = as_float(friction, "friction"), as_float(torsion, "torsion")
    scale = as_float(torque_scale, "torque_scale")
    check_contacts(p, n, friction=mu, torsion=gamma, torque_scale=scale, origin=o)
    check_proportions(p, friction=mu, torsion=gamma, torque_scale=scale, origin=o)
    check_effort(rtol, most_points)
    if p.ndim != 2:
        raise MetricError(
            f"points must have shape (k, 3), not {p.shape}: several grasps are for "
            "`gmdx.epsilon_batch`"
        )
    contacts = ContactSet(
        cones=wrench_cones(p, n, friction=mu, torsion=gamma, torque_scale=scale, origin=o),
        points=p / scale,
        normals=n,
        friction=mu,
        torsion=gamma,
        rtol=rtol,
        most_points=most_points,
    )
    found = certify(contacts, signed=True)
    return Epsilon(found.lower, found.upper, found.direction, found.lower > 0, found.method)


def check_effort(rtol: float, most_points: int) -> None:
    """Refuse tolerances and limits that make no sense.

    Raises:
        MetricError: Naming the argument.
    """
    if not 1e-7 <= as_float(rtol, "rtol") <= 0.5:
        raise MetricError(f"rtol must be between 1e-7 and 0.5, not {rtol}")
    as_count(most_points, "most_points")
