"""Bounds of epsilon by growing a polytope inside the wrench space until it is close enough."""

import logging
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gmdx.arrays import Array, Float, Int
from gmdx.metrics._local import starting_directions, unit
from gmdx.metrics._polish import polish
from gmdx.metrics.wrench import WrenchCones, principal_axes, support, support_points
from gmdx.rng import generator

_LOG = logging.getLogger("gmdx")
_STARTS = 12  # directions of the first polytope, besides the guesses and the axes
_GROWTH = 6  # most points a round: facets, and so time, grow much faster than points
_APART = 0.9998  # cosine above which two facets are the same place
_FOLD = 1e-9  # how far a vertex may stand out of its neighbour's plane, relative to the hull


@dataclass(frozen=True)
class PolytopeBounds:
    """What the polytope proved."""

    lower: float  # offset of the facet nearest to 0, less rounding; -inf if 0 is not inside
    upper: float
    direction: Float[Array, "6"]  # unit, h(direction) = upper


def polytope_bounds(
    cones: WrenchCones, guesses: Float[Array, "m 6"], *, rtol: float, most_points: int
) -> PolytopeBounds:
    """Grow an inner polytope by support points along the normals of its nearest facets.

    Its facet nearest to the origin bounds epsilon from below, the support along any facet's
    normal from above. Points are drawn towards 0 by random amounts far below the tolerance:
    the support points of a pair lie in two 3-flats, on which Qhull would degenerate. Drawn
    points still belong to K if the polytope holds 0, so the bound stays valid.

    Args:
        cones: Contacts that span all six dimensions.
        guesses: Directions in which K is known to be thin.
        rtol: Relative gap at which to stop.
        most_points: Most vertices to try; what was proved by then is returned.
    """
    rng = generator(0, "epsilon", "polytope")
    principal = principal_axes(cones)
    rounding = principal.rounding  # Qhull's tolerances are absolute: work where K is round

    def drawn(points: Float[Array, "p 6"]) -> Float[Array, "p 6"]:
        shrunk: Array = points * (1.0 - 0.01 * rtol * rng.random((len(points), 1)))
        return shrunk

    starts = [guesses, starting_directions(cones, _STARTS)]
    starts += [sign * a for a in (principal.axes.T, unit(rounding.T)) for sign in (1.0, -1.0)]
    u = np.concatenate(starts)
    values = support(cones, u)
    best = PolytopeBounds(-np.inf, float(values.min()), u[values.argmin()])
    fresh = _new_points(cones, u, np.zeros((0, 6)))
    vertices = drawn(fresh)
    try:
        hull = ConvexHull(vertices @ rounding, incremental=True)
        while True:
            normals = hull.equations[:, :6] @ rounding.T
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            # A facet lies wholly beyond the least of its own vertices.
            offsets = np.einsum("fvj,fj->fv", vertices[hull.simplices], normals).min(axis=1)
            weak = np.flatnonzero(offsets < best.upper * (1.0 - 0.95 * rtol))
            weak = weak[np.argsort(offsets[weak], kind="stable")][: 40 * _GROWTH]
            best = _improved(cones, best, normals[weak])
            done = best.upper <= 0 or not (offsets[weak] < best.upper * (1 - 0.95 * rtol)).any()
            fresh = np.zeros((0, 6))
            if not done and len(vertices) < most_points:
                targets = normals[weak[_spread(normals[weak])]]
                fresh = _new_points(cones, targets, vertices)
            if len(fresh) == 0:
                break
            fresh = drawn(fresh)
            vertices = np.concatenate([vertices, fresh])
            hull.add_points(fresh @ rounding)
    except QhullError as error:
        _LOG.info("epsilon: Qhull gave up: %s", str(error).splitlines()[0])
        return best
    opposite = _across(hull.simplices, hull.neighbors)
    size = float(np.abs(vertices).max())
    if opposite is None:
        _LOG.info("epsilon: Qhull's facets have a boundary: no lower bound from them")
        return best
    out = np.einsum("fvj,fj->fv", vertices[opposite], normals).max(axis=1) - offsets
    if out.max() > _FOLD * size:
        _LOG.info("epsilon: Qhull's facets fold over each other: no lower bound from them")
        return best
    lower = float(offsets.min()) - max(float(out.max()), 0.0) - 1e-13 * size
    return PolytopeBounds(lower, best.upper, best.direction)


def _improved(
    cones: WrenchCones, best: PolytopeBounds, normals: Float[Array, "m 6"]
) -> PolytopeBounds:
    """The upper bound, lowered if the support along some facet's normal is less."""
    if len(normals) == 0:
        return best
    h = support(cones, normals)
    if h.min() >= best.upper:
        return best
    u = polish(cones, normals[h.argmin()])
    return PolytopeBounds(best.lower, float(support(cones, u)), u)


def _new_points(
    cones: WrenchCones, u: Float[Array, "m 6"], known: Float[Array, "p 6"]
) -> Float[Array, "q 6"]:
    """The farthest wrench along each direction, without those known already."""
    points = support_points(cones, u)
    top = np.einsum("mki,mi->mk", points, u).argmax(axis=1)
    fresh = points[np.arange(len(u)), top]
    everything = np.concatenate([known, fresh])
    apart = np.linalg.norm(fresh[:, None] - everything[None], axis=-1)
    earlier = np.arange(len(everything))[None] < len(known) + np.arange(len(fresh))[:, None]
    new: Array = fresh[~((apart < 1e-7 * np.abs(everything).max()) & earlier).any(axis=1)]
    return new


def _spread(normals: Float[Array, "m 6"]) -> Int[Array, "p"]:
    """The first few normals that differ from each other."""
    chosen = [0]
    for i in range(1, len(normals)):
        if len(chosen) == _GROWTH:
            break
        if (normals[chosen] @ normals[i]).max() < _APART:
            chosen.append(i)
    return np.array(chosen)


def _across(simplices: Int[Array, "f 6"], neighbors: Int[Array, "f 6"]) -> Array | None:
    """The vertex beyond each facet's ridges, (f, 6), or None unless every ridge joins two facets.

    Facets without a boundary, with 0 inside all of their planes and the vertex beyond each
    ridge inside too, are seen from 0 in every direction: they enclose a ball of their least
    offset. This does not rely on how they were found.
    """
    if (neighbors < 0).any():
        return None
    names = generator(0, "epsilon", "names").integers(1, 2**40, simplices.max() + 1)[simplices]
    ridges = names.sum(axis=1, keepdims=True) - names  # opposite each vertex
    returned = (neighbors[neighbors] == np.arange(len(simplices))[:, None, None]) & (
        ridges[neighbors] == ridges[:, :, None]
    )
    if not returned.any(axis=2).all():
        return None
    across: Array = np.take_along_axis(
        simplices[neighbors], returned.argmax(axis=2)[..., None], axis=2
    )[..., 0]
    return across
