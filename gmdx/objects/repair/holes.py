"""Fill the holes of a surface, each with the smallest area that closes it."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.objects.repair.read import edge_counts

_LONGEST = 256  # edges around a hole: the work grows with their third power


@dataclass(frozen=True)
class FilledHoles:
    """A surface with its holes filled."""

    faces: Int[Array, "g 3"]
    holes: int
    widest: float  # largest distance across a filled hole, in the unit of the vertices
    area: float  # of all that was filled, in that unit squared


def fill_holes(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, area: float
) -> FilledHoles:
    """Fill the holes that take no more than `area` to close.

    A hole is a loop of edges that belong to one face each; holes that touch at a vertex are told
    apart. No vertex is added. The new faces go round the hole against their neighbours, which
    is right where the neighbours agree.
    """
    edges = _edges(faces)
    added: list[Array] = []
    widest = filled = 0.0
    for loop in _loops(faces):
        points = vertices[loop]
        across = float(np.linalg.norm(points[:, None] - points[None], axis=2).max())
        if len(loop) > _LONGEST or _flat_area(points) > area:
            continue
        triangles = smallest_triangulation(points, forbidden=_forbidden(loop, edges))
        a, b, c = np.moveaxis(points[triangles], 1, 0)
        closing = float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        new = loop[triangles]
        if closing <= area:
            added.append(new)
            edges |= _edges(new)
            widest, filled = max(widest, across), filled + closing
    return FilledHoles(np.concatenate([faces, *added]), len(added), widest, filled)


def smallest_triangulation(
    points: Float[Array, "n 3"], *, forbidden: Bool[Array, "n n"] | None = None
) -> Int[Array, "m 3"]:
    """The triangles of least area in sum that span a closed polygon in space (m = n - 2).

    Dynamic programming over the polygon's diagonals (Barequet and Sharir 1995).

    Args:
        points: The corners in order, in any unit.
        forbidden: Diagonals that are taken only if there is no other way.
    """
    n = len(points)
    fine = np.zeros((n, n))
    if forbidden is not None:
        fine[forbidden] = 1e3 * n * float(np.ptp(points, axis=0).max()) ** 2
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
            best[i, k], middle[i, k] = cost[choice] + fine[i, k], j[choice]
    triangles: list[tuple[int, int, int]] = []
    open_spans: list[tuple[int, int]] = [(0, n - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first >= 2:
            between = int(middle[first, last])
            triangles.append((first, between, last))
            open_spans += [(first, between), (between, last)]
    return np.array(triangles, np.int64)


def _flat_area(points: Float[Array, "n 3"]) -> float:
    """Area of a closed polygon's largest projection: no surface that spans it has less."""
    around = points - points.mean(axis=0)
    return float(0.5 * np.linalg.norm(np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)))


def _edges(faces: Int[Array, "f 3"]) -> set[tuple[int, int]]:
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return set(map(tuple, pairs.tolist()))


def _forbidden(loop: Int[Array, "n"], edges: set[tuple[int, int]]) -> Bool[Array, "n n"]:
    """Diagonals between a vertex and itself, or along an edge that has its two faces already."""
    n = len(loop)
    result = np.zeros((n, n), bool)
    for i in range(n):
        for k in range(i + 2, n):
            a, b = sorted((int(loop[i]), int(loop[k])))
            result[i, k] = (i, k) != (0, n - 1) and (a == b or (a, b) in edges)
    return result


def _loops(faces: Int[Array, "f 3"]) -> list[Int[Array, "_"]]:
    """Vertices around each hole, in the direction that faces filling it have."""
    fans = _fans(faces)
    start, end = fans, np.roll(fans, -1, axis=1)
    rim = edge_counts(faces) == 1
    # backwards along the border: a face that fills runs through each edge against its neighbour
    following = dict(zip(end[rim].tolist(), start[rim].tolist(), strict=True))
    vertex = np.empty(int(fans.max()) + 1, np.int64)
    vertex[fans] = faces
    loops: list[Array] = []
    while following:
        first, at = next(iter(following.items()))
        loop = [first]
        del following[first]
        while at != first and at in following:
            loop.append(at)
            at = following.pop(at)
        if at == first and len(loop) > 2:
            loops += _simple(vertex[loop])
    return loops


def _simple(loop: Int[Array, "n"]) -> list[Int[Array, "_"]]:
    """A loop cut into loops that pass each vertex once."""
    done: list[Array] = []
    path: list[int] = []
    for v in loop.tolist():
        if v in path:
            at = path.index(v)
            done.append(np.array(path[at:], np.int64))
            del path[at:]
        path.append(v)
    done.append(np.array(path, np.int64))
    return [part for part in done if len(part) > 2]


def _fans(faces: Int[Array, "f 3"]) -> Int[Array, "f 3"]:
    """A number for each corner, the same for the corners around a vertex that share edges.

    Where two sheets touch at a vertex only, their corners have different numbers.
    """
    tail, head = faces, np.roll(faces, -1, axis=1)
    key = np.minimum(tail, head) * (int(faces.max()) + 1) + np.maximum(tail, head)
    order = np.argsort(key.ravel(), kind="stable")
    _, start, count = np.unique(key.ravel()[order], return_index=True, return_counts=True)
    a, b = order[start[count == 2]], order[start[count == 2] + 1]
    next_corner = np.arange(faces.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    alike = faces.ravel()[a] == faces.ravel()[b]
    here = np.concatenate([a, next_corner[a]])
    there = np.concatenate([np.where(alike, b, next_corner[b]), np.where(alike, next_corner[b], b)])
    graph = coo_array((np.ones(len(here), np.int8), (here, there)), shape=(faces.size,) * 2)
    label: Array = connected_components(graph, directed=False)[1]
    return label.astype(np.int64).reshape(-1, 3)
