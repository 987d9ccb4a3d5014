"""Bounds of epsilon by growing a polytope inside the wrench space until it is close enough."""

import logging
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gmdx.arrays import Array, Bool, Float
from gmdx.metrics._local import polish, starting_directions, unit
from gmdx.metrics.wrench import WrenchCones, contact_supports, support, support_points
from gmdx.rng import generator

_LOG = logging.getLogger("gmdx")
_FACETS_A_ROUND = 150  # facets pushed outward between two rebuilds of the hull


@dataclass(frozen=True)
class PolytopeBounds:
    """What the polytope proved."""

    lower: float  # offset of the facet nearest to 0, less rounding; <= 0 without closure
    upper: float
    direction: Float[Array, "6"]  # unit, h(direction) = upper


def polytope_bounds(
    cones: WrenchCones, guesses: Float[Array, "m 6"], *, rtol: float, most_points: int
) -> PolytopeBounds:
    """Grow an inner polytope by support points along the normals of its nearest facets.

    Its facet nearest to the origin bounds epsilon from below, the support along any facet's
    normal from above. Points are drawn towards 0 by random amounts far below the tolerance:
    the support points of a pair lie in two 3-flats, on which Qhull would degenerate. Drawn
    points still belong to K when K holds 0, so the bound stays valid.

    Args:
        cones: Contacts that span all six dimensions.
        guesses: Directions in which K is known to be thin.
        rtol: Relative gap at which to stop.
        most_points: Most vertices to try; what was proved by then is returned.
    """
    rng = generator(0, "epsilon", "polytope")
    columns = cones.columns
    width, axes = np.linalg.eigh(columns.T @ columns)
    # Qhull's tolerances are absolute: work where K is round, measure where it is not.
    rounding = axes / np.sqrt(width)
    starts = np.concatenate([guesses, starting_directions(cones, 40), axes.T, -axes.T])
    direction = starts[support(cones, starts).argmin()]
    upper = float(support(cones, direction))
    points = _near_supports(cones, starts, 0.2)
    lower = -np.inf
    while True:
        vertices = points * (1.0 - 0.01 * rtol * rng.random((len(points), 1)))
        try:
            hull = ConvexHull(vertices @ rounding)
        except QhullError as error:
            _LOG.info("epsilon: Qhull gave up on %d points: %s", len(points), error)
            break
        normals = hull.equations[:, :6] @ rounding.T
        length = np.linalg.norm(normals, axis=1)
        normals /= length[:, None]
        offsets = np.einsum("fvj,fj->fv", vertices[hull.simplices], normals).min(axis=1)
        if (hull.neighbors >= 0).all():
            # A facet lies wholly beyond its least vertex; the rounding of Qhull's normals is
            # in that minimum, what remains is that of the products themselves.
            lower = max(lower, float(offsets.min() - 1e-13 * np.abs(vertices).max()))
        h = support(cones, normals)
        if h.min() < upper:
            direction = polish(cones, normals[h.argmin()])
            upper = float(support(cones, direction))
        if upper <= 0 or upper - lower <= rtol * upper or len(points) >= most_points:
            break
        weak = np.flatnonzero(offsets < upper * (1.0 - 0.9 * rtol))
        weak = weak[np.argsort(offsets[weak], kind="stable")]
        spread = _spread(normals[weak], _FACETS_A_ROUND)
        fresh = _near_supports(cones, np.concatenate([normals[weak][spread], direction[None]]), 0.0)
        fresh = fresh[_distinct(fresh, points, 1e-9)]
        if len(fresh) == 0:
            break
        points = np.concatenate([points[np.unique(hull.simplices)], fresh])
    return PolytopeBounds(lower, upper, direction)


def _near_supports(
    cones: WrenchCones, u: Float[Array, "m 6"], slack: float
) -> Float[Array, "p 6"]:
    """Support points of the contacts whose support is within `slack` of the largest."""
    h = contact_supports(cones, u)
    top = h.max(axis=1, keepdims=True)
    points: Array = support_points(cones, u)[h >= top - slack * np.abs(top) - 1e-12]
    return points


def _spread(normals: Float[Array, "m 6"], count: int) -> Float[Array, "p"] | Array:
    """Indices of up to `count` normals, leaving out near repeats of weaker facets."""
    chosen: list[int] = []
    kept = np.zeros((count, 6))
    for i, normal in enumerate(normals[: 20 * count]):
        if not chosen or (kept[: len(chosen)] @ normal).max() < 0.9998:
            kept[len(chosen)] = normal
            chosen.append(i)
            if len(chosen) == count:
                break
    return np.array(chosen, int)


def _distinct(
    fresh: Float[Array, "m 6"], known: Float[Array, "p 6"], tol: float
) -> Bool[Array, "m"]:
    """Which fresh points are not known, and not repeated."""
    everything = np.concatenate([known, fresh])
    square = np.einsum("ij,ij->i", everything, everything)
    distance = square[len(known) :, None] + square[None] - 2.0 * fresh @ everything.T
    later = np.arange(len(everything))[None] >= len(known) + np.arange(len(fresh))[:, None]
    near: Array = (distance < tol**2 * max(square.max(), 1.0)) & ~later
    new: Array = ~near.any(axis=1)
    return new
