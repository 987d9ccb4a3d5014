"""Intersection-line analysis in bulk: many grasps on one surface."""

import numpy as np
from jaxtyping import Float, Int

from gmdx_kernels.closing_lines.clusters import cluster_triangles, near_pairs
from gmdx_kernels.closing_lines.touches import SAME_CROSSING, Array, FirstTouch, Problem, decide

_GRASPS, _LINES = 64, 512  # at most so many together: only a matter of speed and memory


def pad_grid(pad_size: Float[Array, "2"], grid: tuple[int, int]) -> Float[Array, "l 2"]:
    """Where lines cross a pad's face: an even grid from edge to edge, or the middle for 1.

    Args:
        pad_size: Extents of the face, m: across, and along the approach.
        grid: Lines in either direction; an odd number puts one through the centre.

    Returns:
        Offsets from the face's centre, m: across, and along `up`.
    """
    across, along = (
        np.linspace(-0.5, 0.5, count) * size if count > 1 else np.zeros(1)
        for count, size in zip(grid, pad_size, strict=True)
    )
    return np.stack([np.repeat(across, grid[1]), np.tile(along, grid[0])], axis=1)


def closing_lines(
    vertices: Float[Array, "v 3"],
    faces: Int[Array, "f 3"],
    center: Float[Array, "n 3"],
    axis: Float[Array, "n 3"],
    up: Float[Array, "n 3"],
    width: Float[Array, "n"],
    *,
    offsets: Float[Array, "l 2"],
) -> FirstTouch:
    """First touches of a closed surface along lines parallel to each grasp's closing axis.

    A touch is where a line, coming from its finger, enters the solid between the two
    fingers (within `width` / 2 of the centre, or at most 1e-9 m behind). A line whose finger
    stands inside the solid leaves it before it enters it, and touches nothing from that side.
    Lines through edges and vertices do not leak: each triangle decides by edge functions that
    its neighbour evaluates with exactly the opposite sign (Woop, Benthin and Wald 2013). Of
    triangles that a line enters at the same place (within 1e-9 m) the first in `faces` counts.

    Only the triangles near each line are looked at, in float64. A grasp's result does not depend
    on the others in its batch.

    Args:
        vertices: Corners of the surface, m, in the frame of the grasps.
        faces: Triangles, counter-clockwise seen from outside.
        center: Midway between the fingers, m.
        axis: Unit closing axes, from finger 0 to finger 1.
        up: Unit vectors perpendicular to `axis`, out of the pads along the fingers.
        width: Opening between the fingers, m.
        offsets: Each line's offset from the centre, m: across (up x axis), and along `up`.
    """
    n, lines = len(center), len(offsets)
    distance, triangle = np.full((n, 2, lines), np.nan), np.full((n, 2, lines), -1)
    if not (n and lines and len(faces)):
        return FirstTouch(distance, triangle)
    frame = np.stack([axis, np.cross(up, axis), up], axis=1)
    corners = np.take(np.ascontiguousarray(vertices.T), faces.T, axis=1)
    half = 0.5 * width + SAME_CROSSING  # what a finger stands at is in front of it
    clusters = cluster_triangles(corners)
    chunk = max(1, min(_GRASPS, _LINES // lines))
    for start in range(0, n, chunk):
        some = slice(start, start + chunk)
        part = Problem(corners, center[some], frame[some], half[some], offsets)
        found = decide(part, near_pairs(part, clusters))
        distance[some], triangle[some] = found.distance, found.triangle
    return FirstTouch(distance, triangle)
