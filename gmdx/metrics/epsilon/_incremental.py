"""Bounds of epsilon by growing a polytope inside the wrench space until it is close enough."""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.metrics.epsilon._local import unit
from gmdx.metrics.epsilon._projection import project_origin
from gmdx.metrics.epsilon.wrench import WrenchCones, support
from gmdx.rng import generator

_FIRST = (0.1, 1e-4, 1e-8)  # of the upper bound: sizes of the polytope to start from
_DRAWN = 0.01  # of the tolerance: most by which a point is drawn towards 0
_BEYOND = 1e-10  # relative distance from a facet's plane from which a point sees the facet
_BITS = 15  # of a point's number
_ROUNDING = 1e-13  # of a height, relative to the largest coordinate
_NAMES = 1 << _BITS * np.arange(4)  # of four points by one number
_ALL_BUT = np.array([[j for j in range(6) if j != i] for i in range(6)])
_OTHERS = _ALL_BUT[:5, :4]  # of the first five


@dataclass(frozen=True)
class PolytopeBounds:
    """What the polytope proved."""

    lower: float  # distance of the facet nearest to 0, less rounding; -inf if 0 is not inside
    upper: float
    direction: Float[Array, "6"]  # unit, h(direction) = upper


def polytope_bounds(
    cones: WrenchCones, guesses: Float[Array, "m 6"], *, rtol: float, most_points: int
) -> PolytopeBounds:
    """Grow an inner polytope by the farthest wrench along the normal of its nearest facet.

    The facet nearest to the origin bounds epsilon from below, the support along any facet's
    normal from above. The first polytope is a simplex far smaller than the ball sought; what
    it encloses counts once none of its corners is left, that is when all facets are far.
    Points are drawn towards 0 by random amounts far below the tolerance, which keeps them in K:
    the farthest wrenches of a contact lie in a 3-flat, and facets would be flat as well.

    Args:
        cones: Contacts that span all six dimensions.
        guesses: Directions in which K is known to be thin, at least one.
        rtol: Relative gap at which to stop.
        most_points: Most vertices to try; what was proved by then is returned.
    """
    h = support(cones, guesses)
    best = PolytopeBounds(-np.inf, float(h.min()), guesses[h.argmin()])
    if best.upper <= 0:
        return best
    for share in _FIRST:
        size = share * best.upper
        best = _grown(cones, best, guesses, size, rtol, most_points)
        if best.upper > size:
            break
        away = project_origin(cones)
        if away.separation > 0 or best.upper <= 0:
            return PolytopeBounds(-np.inf, -away.separation, away.direction)
    return best


def _grown(
    cones: WrenchCones,
    best: PolytopeBounds,
    starts: Float[Array, "m 6"],
    size: float,
    rtol: float,
    most_points: int,
) -> PolytopeBounds:
    """Grow from a simplex of corners at `size`; gives up once the upper bound falls to that."""
    generators = np.concatenate([cones.centers[:, None], cones.spreads], axis=1)
    surface = Surface(size)
    drawn = generator(0, "epsilon", "polytope")

    def add(wrench: Float[Array, "6"]) -> bool:
        return surface.add(wrench * (1.0 - _DRAWN * rtol * drawn.random()))

    for u in starts:
        add(_farthest(generators, u).wrench)
    while True:
        steepness = np.sqrt(surface.nearest @ surface.nearest)
        u = surface.nearest / steepness
        far = _farthest(generators, u)
        if far.support < best.upper:
            best = PolytopeBounds(best.lower, float(support(cones, u)), u)
        close = best.upper * (1.0 - 0.95 * rtol)
        done = best.upper <= size or 1.0 / steepness >= close or surface.count >= most_points
        if done or not (add(far.wrench) or add(far.wrench)):
            break
    lower = surface.proved()
    return PolytopeBounds(lower if lower > size else -np.inf, best.upper, best.direction)


@dataclass(frozen=True)
class _Farthest:
    support: float
    wrench: Float[Array, "6"]


def _farthest(generators: Float[Array, "k 4 6"], u: Float[Array, "6"]) -> _Farthest:
    """The wrench of K that reaches farthest along u, from each contact's c_i and B_i^T."""
    along = (generators.reshape(-1, 6) @ u).reshape(-1, 4)
    slip = along[:, 1:]
    length = np.sqrt((slip * slip).sum(axis=1))
    h = along[:, 0] + length
    i = int(h.argmax())
    share = along[i] / max(float(length[i]), 1e-300)
    share[0] = 1.0
    return _Farthest(float(h[i]), share @ generators[i])


class Surface:
    """A closed surface of simplices about 0 that grows by one point after another.

    Each facet has a normal n with n . v = 1 for its vertices v, so its plane is at 1 / |n|. A
    point p replaces the facets it sees, n . p > 1, by those that join it to the ridges around
    them. The normal of a new facet is the mean, with n . p = 1, of those on either side of its
    ridge: there are no equations to solve, and nothing that fails on degenerate points.

    It encloses 0 whatever the rounding. Every ridge belongs to an even number of facets: at the
    start, and after each step, since p is joined to the boundary of what is taken away. The
    facets that are replaced and p lie beyond planes that leave 0 on the other side. So the
    surface stays in the way of every ray from 0 (its degree about 0, modulo 2, stays 1), and
    no facet is nearer than its lowest vertex along its normal. `add` refuses a point where
    these conditions cannot be verified.
    """

    def __init__(self, size: float) -> None:
        """The regular simplex whose corners are at the distance `size`."""
        corners = np.linalg.qr(np.column_stack([np.ones(7), np.eye(7)[:, :6]]))[0][:, 1:]
        self._points = size * unit(corners)
        self._vertices = np.array([[j for j in range(7) if j != i] for i in range(7)])
        self._neighbors = self._vertices.copy()  # beyond corner j of facet i lies facet j
        corners = self._points[self._vertices]
        self._normals = np.linalg.solve(corners, np.ones((7, 6, 1)))[..., 0]
        self._steepness = np.einsum("fj,fj->f", self._normals, self._normals)
        self._free = np.zeros(0, dtype=int)  # places of facets that are gone

    @property
    def count(self) -> int:
        """How many points the surface was made of."""
        return len(self._points)

    @property
    def nearest(self) -> Float[Array, "6"]:
        """Normal of the facet nearest to 0, as long as 1 / its distance."""
        normal: Array = self._normals[self._steepness.argmax()]
        return normal

    def proved(self) -> float:
        """The radius of a ball that the surface encloses for certain."""
        alive = self._steepness > 0
        normals = self._normals[alive] / np.sqrt(self._steepness[alive])[:, None]
        heights = np.einsum("fvj,fj->fv", self._points[self._vertices[alive]], normals)
        return float(heights.min()) - _ROUNDING * float(np.abs(self._points).max())

    def add(self, point: Float[Array, "6"]) -> bool:
        """Grow by a point; False, and no change, if it sees no facet or proves nothing."""
        above = self._normals @ point
        seen = above > 1.0 + _BEYOND
        old = np.flatnonzero(seen)
        around = self._neighbors[old]
        rows, gaps = np.nonzero(~seen[around])
        inner, outer = old[rows], around[rows, gaps]
        n = len(rows)
        if n == 0 or self.count >= 1 << _BITS:
            return False
        # The last place is the new point's, so the vertices of a facet stay in order.
        vertices = np.full((n, 6), self.count)
        vertices[:, :5] = self._vertices[inner[:, None], _ALL_BUT[gaps]]
        share = np.clip((above[inner] - 1.0) / (above[inner] - above[outer]), 0.0, 1.0)
        normals = self._normals[inner]
        normals = normals + share[:, None] * (self._normals[outer] - normals)
        points = np.concatenate([self._points, point[None]])
        heights = np.einsum("fvj,fj->fv", points[vertices], normals)
        names = (vertices[:, _OTHERS] @ _NAMES).ravel()
        order = names.argsort()
        ranked, one, other = names[order], order[::2], order[1::2]
        back = self._neighbors[outer] == inner[:, None]
        if not (
            len(one) == len(other)
            and (ranked[::2] == ranked[1::2]).all()  # each new ridge joins two facets
            and (ranked[2::2] > ranked[1:-1:2]).all()  # and no more
            and np.count_nonzero(back) == n
            and heights.min() > 0.5
        ):
            return False
        slots = self._slots(old, n)
        neighbors = np.empty((n, 6), dtype=int)
        neighbors[:, 5] = outer
        neighbors[one // 5, one % 5] = slots[other // 5]
        neighbors[other // 5, other % 5] = slots[one // 5]
        self._neighbors[outer, back.argmax(axis=1)] = slots
        self._points = points
        self._vertices[slots], self._neighbors[slots] = vertices, neighbors
        self._normals[slots] = normals
        self._steepness[slots] = np.einsum("fj,fj->f", normals, normals)
        return True

    def _slots(self, old: Int[Array, "s"], count: int) -> Int[Array, "n"]:
        """Places for new facets: those of the old ones, which go, and free ones."""
        self._normals[old] = 0.0  # a facet that no point sees
        self._steepness[old] = 0.0
        self._free = np.concatenate([old, self._free])
        missing = count - len(self._free)
        if missing > 0:
            size = len(self._steepness)
            more = max(missing, size)
            self._vertices = np.concatenate([self._vertices, np.zeros((more, 6), dtype=int)])
            self._neighbors = np.concatenate([self._neighbors, np.zeros((more, 6), dtype=int)])
            self._normals = np.concatenate([self._normals, np.zeros((more, 6))])
            self._steepness = np.concatenate([self._steepness, np.zeros(more)])
            self._free = np.concatenate([self._free, np.arange(size, size + more)])
        slots, self._free = self._free[:count], self._free[count:]
        return np.asarray(slots)
