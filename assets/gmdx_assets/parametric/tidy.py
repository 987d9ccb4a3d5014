"""Rids a closed surface of slivers: collapses short edges and flips badly placed ones."""

from collections import defaultdict

import numpy as np

from gmdx_assets.parametric.solids import Floats, Ints, Solid

Edge = tuple[int, int]


def tidy(solid: Solid, *, shortest: float, tolerance: float) -> Solid:
    """The same surface with fewer and better triangles.

    Args:
        solid: A closed 2-manifold.
        shortest: Shorter edges are collapsed where the surface allows it, m.
        tolerance: How far one change may move the surface, m.
    """
    vertices, faces = solid.vertices.copy(), solid.faces.copy()
    for _ in range(20):
        faces, collapsed = _collapse(vertices, faces, shortest, tolerance)
        flipped = _flip(vertices, faces, tolerance)
        if not collapsed and not flipped:
            break
    used, renumbered = np.unique(faces, return_inverse=True)
    return Solid(vertices[used], renumbered.reshape(-1, 3).astype(np.int64))


def _normals(corners: Floats) -> Floats:
    """Unnormalised normals of triangles (n, 3, 3)."""
    normals: Floats = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals


def _unit(vectors: Floats) -> Floats:
    length: Floats = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, 1e-30)


def _smallest_angle(corners: Floats) -> float:
    """The smallest angle in any of the triangles (n, 3, 3), rad."""
    a = _unit(np.roll(corners, -1, axis=1) - corners)
    b = _unit(np.roll(corners, 1, axis=1) - corners)
    return float(np.arccos(np.clip((a * b).sum(axis=2), -1, 1)).min())


def _opposite(faces: Ints) -> dict[Edge, tuple[int, int]]:
    """For each directed edge its face and the face's third vertex."""
    return {
        (int(f[i]), int(f[(i + 1) % 3])): (index, int(f[(i + 2) % 3]))
        for index, f in enumerate(faces)
        for i in range(3)
    }


def _collapse(vertices: Floats, faces: Ints, shortest: float, tolerance: float) -> tuple[Ints, int]:
    """Moves one end of each short edge onto the other where that keeps the surface."""
    around: dict[int, set[int]] = defaultdict(set)
    for index, face in enumerate(faces):
        for vertex in face:
            around[int(vertex)].add(index)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    gone: set[int] = set()
    touched: set[int] = set()
    for a, b in edges[np.argsort(length, kind="stable")][: int((length < shortest).sum())]:
        u, v = int(a), int(b)
        ring = {int(w) for i in around[u] | around[v] for w in faces[i]}
        if ring & touched:
            continue
        shared = around[u] & around[v]
        common = {int(w) for i in around[u] for w in faces[i]} & {
            int(w) for i in around[v] for w in faces[i]
        }
        if len(shared) != 2 or len(common) != 4:
            continue
        costs = []
        for keep, drop in ((u, v), (v, u)):
            moving = sorted(around[drop] - shared)
            before = vertices[faces[moving]]
            after = np.where((faces[moving] == drop)[..., None], vertices[keep], before)
            old, new = _unit(_normals(before)), _unit(_normals(after))
            thick = np.linalg.norm(_normals(before), axis=1) > 1e-10
            shift = np.abs(((vertices[keep] - vertices[drop]) * old).sum(axis=1))[thick]
            turned = ((old * new).sum(axis=1) < 0.3)[thick].any()
            bad = turned or _smallest_angle(after) < min(_smallest_angle(before), 0.1)
            costs.append(np.inf if bad else float(shift.max(initial=0.0)))
        if min(costs) > tolerance:
            continue
        keep, drop = (u, v) if costs[0] <= costs[1] else (v, u)
        for i in around[drop]:
            faces[i][faces[i] == drop] = keep
        around[keep] = (around[keep] | around[drop]) - shared
        gone |= shared
        touched |= ring
    kept: Ints = np.delete(faces, sorted(gone), axis=0)
    return kept, len(gone)


def _flip(vertices: Floats, faces: Ints, tolerance: float) -> int:
    """Flips, in place, edges whose other diagonal makes better triangles of the same surface."""
    opposite = _opposite(faces)
    touched: set[int] = set()
    count = 0
    for (u, v), (i, w) in sorted(opposite.items()):
        j, x = opposite[v, u]
        if u > v or i in touched or j in touched or (w, x) in opposite or (x, w) in opposite:
            continue
        before = vertices[[[u, v, w], [v, u, x]]]
        after = vertices[[[w, x, v], [x, w, u]]]
        old, new = _normals(before), _normals(after)
        larger = _unit(old[np.argmax(np.linalg.norm(old, axis=1))])
        if (_unit(new) @ larger).min() < 0.5:
            continue
        across = _unit(np.cross(vertices[v] - vertices[u], vertices[x] - vertices[w]))
        if abs(float(across @ (vertices[w] - vertices[u]))) > tolerance:
            continue
        if _smallest_angle(after) < 1.05 * _smallest_angle(before):
            continue
        faces[i], faces[j] = (w, x, v), (x, w, u)
        touched |= {i, j}
        touched |= {opposite[e][0] for e in ((w, v), (u, w), (v, x), (x, u)) if e in opposite}
        count += 1
    return count
