"""Rids a closed surface of slivers: collapses short edges and flips badly placed ones."""

from collections import defaultdict

import numpy as np

from gmdx_assets.parametric.solids import Floats, Ints, Solid


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


def _smallest_angles(corners: Floats) -> Floats:
    """The smallest angle of each triangle (n, 3, 3), rad."""
    a = _unit(np.roll(corners, -1, axis=1) - corners)
    b = _unit(np.roll(corners, 1, axis=1) - corners)
    smallest: Floats = np.arccos(np.clip((a * b).sum(axis=2), -1, 1)).min(axis=1)
    return smallest


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
            bad = turned or _smallest_angles(after).min() < min(_smallest_angles(before).min(), 0.1)
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
    starts, ends, thirds = (np.roll(faces, -shift, axis=1).ravel() for shift in range(3))
    sides = {(int(a), int(b)): i for i, (a, b) in enumerate(zip(starts, ends, strict=True))}
    pairs = [(i, sides[b, a]) for (a, b), i in sides.items() if a < b]
    here, there = np.array(pairs).T
    u, v, w, x = starts[here], ends[here], thirds[here], thirds[there]
    old = np.stack([_normals(vertices[c]) for c in (_rows(u, v, w), _rows(v, u, x))], axis=1)
    new = np.stack([_normals(vertices[c]) for c in (_rows(w, x, v), _rows(x, w, u))], axis=1)
    larger = old[np.arange(len(u)), np.linalg.norm(old, axis=2).argmax(axis=1)]
    alike = (_unit(new) * _unit(larger)[:, None]).sum(axis=2).min(axis=1) > 0.5
    across = _unit(np.cross(vertices[v] - vertices[u], vertices[x] - vertices[w]))
    flat = np.abs((across * (vertices[w] - vertices[u])).sum(axis=1)) < tolerance
    angles = _smallest_angles(vertices[faces])
    before = np.minimum(angles[here // 3], angles[there // 3])
    after = np.minimum(
        _smallest_angles(vertices[_rows(w, x, v)]), _smallest_angles(vertices[_rows(x, w, u)])
    )
    count = 0
    touched: set[int] = set()
    for e in np.flatnonzero(alike & flat & (after > 1.05 * before)):
        a, b, c, d = int(u[e]), int(v[e]), int(w[e]), int(x[e])
        i, j = int(here[e]) // 3, int(there[e]) // 3
        if i in touched or j in touched or (c, d) in sides or (d, c) in sides:
            continue
        faces[i], faces[j] = (c, d, b), (d, c, a)
        # The neighbours wait for the next round: what was computed for them no longer holds.
        touched |= {i, j, *(sides[edge] // 3 for edge in ((c, b), (a, c), (b, d), (d, a)))}
        count += 1
    return count


def _rows(a: Ints, b: Ints, c: Ints) -> Ints:
    return np.stack([a, b, c], axis=1)
