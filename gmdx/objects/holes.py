"""Fill the small holes of a surface, each with the smallest area that closes it."""

from dataclasses import dataclass

import networkx
import numpy as np

from gmdx.arrays import Array, Float, Int

_LONGEST = 80  # edges around a hole: the work grows with their third power


@dataclass(frozen=True)
class FilledHoles:
    """A surface with its small holes filled."""

    faces: Int[Array, "g 3"]
    holes: int
    widest: float  # largest distance across a filled hole, in the unit of the vertices


def fill_holes(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, widest: float
) -> FilledHoles:
    """Fill the holes that are no wider than `widest` and bounded by one simple loop of edges.

    No vertex is added. New faces are wound like their neighbours.
    """
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    key = np.sort(edges, axis=1) @ np.array([int(faces.max()) + 1, 1])
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    rim = edges[count[inverse] == 1]
    directed = {(int(a), int(b)) for a, b in rim}
    graph = networkx.Graph()
    graph.add_edges_from(sorted(directed))
    added: list[Array] = []
    largest = 0.0
    for component in sorted(networkx.connected_components(graph), key=min):
        loop = _simple_loop(graph, component)
        if loop is None or len(loop) > _LONGEST:
            continue
        points = vertices[loop]
        across = float(np.linalg.norm(points[:, None] - points[None], axis=2).max())
        if across > widest:
            continue
        if (loop[0], loop[1]) in directed:  # the neighbour's edge must be run through backwards
            loop = loop[::-1]
        added.append(np.array(loop)[smallest_triangulation(vertices[loop])])
        largest = max(largest, across)
    return FilledHoles(np.concatenate([faces, *added]), len(added), largest)


def smallest_triangulation(points: Float[Array, "n 3"]) -> Int[Array, "m 3"]:
    """The triangles of least area in sum that span a closed polygon in space (m = n - 2).

    Dynamic programming over the polygon's diagonals (Barequet and Sharir 1995).
    """
    n = len(points)
    best = np.zeros((n, n))
    middle = np.zeros((n, n), int)
    for span in range(2, n):
        for i in range(n - span):
            k = i + span
            j = np.arange(i + 1, k)
            area = 0.5 * np.linalg.norm(
                np.cross(points[j] - points[i], points[k] - points[i]), axis=1
            )
            cost = best[i, j] + best[j, k] + area
            choice = int(np.argmin(cost))
            best[i, k], middle[i, k] = cost[choice], j[choice]
    triangles: list[tuple[int, int, int]] = []
    open_spans: list[tuple[int, int]] = [(0, n - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first >= 2:
            between = int(middle[first, last])
            triangles.append((first, between, last))
            open_spans += [(first, between), (between, last)]
    return np.array(triangles, np.int64)


def _simple_loop(graph: networkx.Graph, component: set[int]) -> list[int] | None:
    """The vertices around a component in order, or None if it is more than one loop."""
    if len(component) < 3 or any(graph.degree(v) != 2 for v in component):
        return None
    start = min(component)
    loop, previous, at = [start], start, min(graph.neighbors(start))
    while at != start:
        loop.append(at)
        previous, at = at, next(v for v in graph.neighbors(at) if v != previous)
    return loop
