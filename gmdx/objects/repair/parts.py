"""The closed parts of a mesh: whether each is sound, and which are voids in others."""

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.objects.repair.read import used_vertices
from gmdx.objects.repair.solid import misfit
from gmdx.objects.repair.winding import signed_volumes, winding_number


def worst_misfit(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], label: Int[Array, "f"]
) -> float:
    """The largest misfit of the parts, each by itself."""
    worst = 0.0
    for part in range(int(label.max()) + 1):
        mine = faces[label == part]
        if signed_volumes(vertices, mine, np.zeros(len(mine), int))[0] < 0:
            mine = mine[:, ::-1]
        used = used_vertices(mine)
        worst = max(worst, misfit(vertices[used], np.searchsorted(used, mine)))
    return worst


def nesting(
    vertices: Float[Array, "v 3"],
    faces: Int[Array, "f 3"],
    label: Int[Array, "f"],
    volumes: Float[Array, "k"],
) -> tuple[Int[Array, "k"], Int[Array, "k"]]:
    """For each closed part, +1 (matter) or -1 (a void in matter), and in how many others it is.

    From the largest part to the smallest: what is in no matter is matter; what is inside matter
    is a void if it is wound against the part around it.
    """
    signs, depths = np.ones(len(volumes), int), np.zeros(len(volumes), int)
    parts = [vertices[faces[label == k]] for k in range(len(volumes))]
    low = np.array([p.min(axis=(0, 1)) for p in parts])
    high = np.array([p.max(axis=(0, 1)) for p in parts])
    order = np.argsort(-np.abs(volumes), kind="stable")
    for place, k in enumerate(order):
        probe = parts[k][:: max(1, len(parts[k]) // 8), 0]
        total, container = 0.0, -1
        for j in order[:place]:
            if (low[j] > low[k]).any() or (high[j] < high[k]).any():
                continue
            inside = float(np.abs(winding_number(probe, parts[j])).min())
            if inside > 0.5:
                depths[k] += 1
                total += signs[j]
                container = j
        if total > 0:  # in matter: its winding, relative to what is around it, decides
            flipped = signs[container] * volumes[container] < 0
            signs[k] = 1 if (volumes[k] > 0) != flipped else -1
    return signs, depths
