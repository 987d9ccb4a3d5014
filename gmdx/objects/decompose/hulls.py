"""Convex hulls as arrays of vertices: simplify, grow and merge them."""

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gmdx.arrays import Array, Float


@dataclass(frozen=True)
class HullNode:
    """A convex hull."""

    points: Float[Array, "n 3"]  # m, vertices only
    volume: float  # m^3


@dataclass(frozen=True)
class MergeSequence:
    """Hulls merged pair by pair, the cheapest pair first.

    The first `leaves` nodes are the hulls given; each later one is the hull of the two
    nodes in the same row of `pairs`.
    """

    nodes: tuple[HullNode, ...]
    pairs: tuple[tuple[int, int], ...]
    leaves: int

    def after(self, merges: int) -> tuple[int, ...]:
        """Indices of the nodes that stand after so many merges."""
        gone = {node for pair in self.pairs[:merges] for node in pair}
        return tuple(i for i in range(self.leaves + merges) if i not in gone)


def hull_node(points: Float[Array, "n 3"], *, thickness: float = 0.0) -> HullNode | None:
    """The convex hull of points; None if it is flat or thinner than `thickness` m."""
    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    # Volume over half the area: the thickness of a plate.
    if hull.volume <= 0 or 2 * hull.volume / hull.area < thickness:
        return None
    return HullNode(np.asarray(points, float)[hull.vertices], float(hull.volume))


def simplify_hull(
    node: HullNode, *, tolerance: float, max_vertices: int, restore: bool = True
) -> Float[Array, "m 3"]:
    """Fewer vertices for a convex hull.

    Starts from the extreme vertices along the principal axes and adds, facet by facet, the
    vertex that sticks out furthest, until none sticks out by more than `tolerance`. The
    result is then scaled about its centroid to the volume it had, so that it does not
    shrink on average.

    Args:
        node: The hull.
        tolerance: Largest distance of a vertex left out from the hull of those kept, m.
        max_vertices: Stop there even if the tolerance is not met.
        restore: Whether to scale back to the hull's volume.
    """
    points = node.points
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    along = points @ np.concatenate([axes, [[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]]).T
    keep = set(np.concatenate([along.argmin(axis=0), along.argmax(axis=0)]).tolist())
    while len(keep) < min(max_vertices, len(points)):
        chosen = sorted(keep)
        kept = hull_node(points[chosen])
        if kept is None:  # the extremes alone are flat
            keep |= set(range(min(len(points), len(keep) + 4)))
            continue
        planes = ConvexHull(points[chosen]).equations
        outside = points @ planes[:, :3].T + planes[:, 3]
        furthest = outside.max(axis=1)
        new = [i for i in np.unique(outside.argmax(axis=0)).tolist() if furthest[i] > tolerance]
        new = sorted(set(new) - keep, key=lambda i: -furthest[i])
        if not new:
            break
        room = max_vertices - len(keep)
        keep |= set(new[: min(room, max(2, len(keep) // 2))])
    simple = hull_node(points[sorted(keep)])
    if simple is None:
        return points
    if not restore or len(simple.points) == len(points):
        return simple.points
    center = simple.points.mean(axis=0)
    grown: Array = center + (simple.points - center) * (node.volume / simple.volume) ** (1 / 3)
    return grown


def grow_hull(
    points: Float[Array, "n 3"], margin: float | Float[Array, "f"]
) -> Float[Array, "n 3"]:
    """Move the facets of a convex hull outward by about `margin` m, keeping its vertices.

    Each vertex moves by the least-squares solution of n . d = margin over its facets'
    normals n, lightly damped so that needle-sharp corners do not fly off.

    Args:
        points: The vertices.
        margin: One distance, or one for each of scipy's (triangular) facets, m.
    """
    hull = ConvexHull(points)
    normals = hull.equations[:, :3]
    corner, normal = hull.simplices.ravel(), np.repeat(normals, 3, axis=0)
    wanted = np.repeat(np.broadcast_to(margin, len(normals)), 3)
    matrix = np.zeros((len(points), 3, 3))
    right = np.zeros((len(points), 3))
    np.add.at(matrix, corner, normal[:, :, None] * normal[:, None, :])
    np.add.at(right, corner, wanted[:, None] * normal)
    step = np.linalg.solve(matrix + 0.05 * np.eye(3), right[:, :, None])[:, :, 0]
    moved: Array = points + step
    return moved


def trim_hulls(
    hulls: Sequence[Float[Array, "_ 3"]], depth: float, *, probe: float
) -> list[Float[Array, "_ 3"]]:
    """Move the outer facets of several hulls inward by about `depth` m.

    A facet is an inner one, and stays, where the point `probe` m outside its centre lies
    in another hull; so hulls that overlap keep overlapping, and only their union shrinks.
    """
    built = [ConvexHull(points) for points in hulls]
    trimmed = []
    for i, (points, hull) in enumerate(zip(hulls, built, strict=True)):
        outside = points[hull.simplices].mean(axis=1) + probe * hull.equations[:, :3]
        inner = np.zeros(len(outside), bool)
        for j, other in enumerate(built):
            if j != i:
                above = outside @ other.equations[:, :3].T + other.equations[:, 3]
                inner |= above.max(axis=1) <= 0
        trimmed.append(grow_hull(points, np.where(inner, 0.0, -depth)))
    return trimmed


def merge_sequence(hulls: tuple[HullNode, ...], *, gap: float) -> MergeSequence:
    """Merge hulls pair by pair down to one, each time where it adds the least volume.

    Args:
        hulls: The hulls to start from.
        gap: Pairs whose bounding boxes are further apart than this are not merged, m.
    """
    nodes = list(hulls)
    lows = [h.points.min(axis=0) for h in nodes]
    highs = [h.points.max(axis=0) for h in nodes]
    queue: list[tuple[float, int, int, HullNode]] = []

    def offer(i: int, j: int) -> None:
        if (np.maximum(lows[i], lows[j]) - np.minimum(highs[i], highs[j])).max() > gap:
            return
        merged = hull_node(np.concatenate([nodes[i].points, nodes[j].points]))
        if merged is not None:
            added = merged.volume - nodes[i].volume - nodes[j].volume
            heapq.heappush(queue, (added, i, j, merged))

    for i, j in itertools.combinations(range(len(nodes)), 2):
        offer(i, j)
    alive = set(range(len(nodes)))
    pairs: list[tuple[int, int]] = []
    while queue:
        _, i, j, merged = heapq.heappop(queue)
        if i not in alive or j not in alive:
            continue
        alive -= {i, j}
        new = len(nodes)
        nodes.append(merged)
        lows.append(merged.points.min(axis=0))
        highs.append(merged.points.max(axis=0))
        pairs.append((i, j))
        for k in sorted(alive):
            offer(k, new)
        alive.add(new)
    return MergeSequence(tuple(nodes), tuple(pairs), len(hulls))
