"""Intersection-line analysis in NumPy: the definition that faster kernels are checked against."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    Array = np.ndarray[Any, np.dtype[Any]]
else:
    Array = np.ndarray

_SAME_CROSSING = 1e-9  # m, crossings closer than this are one: a line through a silhouette edge


@dataclass(frozen=True)
class FirstTouch:
    """First touches of l lines a grasp; finger 0 comes from the axis' negative side."""

    distance: Float[Array, "n 2 l"]  # m along the axis from the centre; NaN where none
    triangle: Int[Array, "n 2 l"]  # index of the touched triangle; -1 where none


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
    fingers (within `width` / 2 of the centre). A line whose finger stands inside the solid
    leaves it before it enters it, and touches nothing from that side. Lines through edges
    and vertices do not leak: each triangle decides by edge functions that its neighbour
    evaluates with exactly the opposite sign (Woop, Benthin and Wald 2013).

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
    distance = np.full((n, 2, lines), np.nan)
    triangle = np.full((n, 2, lines), -1)
    span = np.stack([offsets.min(axis=0), offsets.max(axis=0)], axis=1)
    across = np.cross(up, axis)
    # Coordinates and corners by rows: whole rows are what the culling works on.
    columns, corners = np.ascontiguousarray(vertices.T), np.ascontiguousarray(faces.T)
    for i in range(n):
        frame = np.stack([axis[i], across[i], up[i]])
        # Not `@`: the last bits of BLAS depend on its threads.
        local = np.einsum("ij,jv->iv", frame, columns - center[i, :, None])
        half = 0.5 * float(width[i])
        near = _reaching(local, corners, np.vstack([[-half, half], span]))
        if len(near):
            found, which = _touches(local[:, corners[:, near]], offsets, half)
            distance[i] = found
            triangle[i] = np.where(which >= 0, near[which], -1)
    return FirstTouch(distance, triangle)


def _reaching(
    local: Float[Array, "3 v"], corners: Int[Array, "3 f"], box: Float[Array, "3 2"]
) -> Int[Array, "m"]:
    """Triangles whose bounding box meets the box that the lines span."""
    # A bit for each side of the box: a triangle wholly beyond one side keeps that bit.
    beyond = np.zeros(local.shape[1], np.uint8)
    for side, (row, (low, high)) in enumerate(zip(local, box, strict=True)):
        beyond |= np.left_shift(row < low, side, dtype=np.uint8)
        beyond |= np.left_shift(row > high, side + 3, dtype=np.uint8)
    outside = beyond[corners[0]] & beyond[corners[1]] & beyond[corners[2]]
    return np.flatnonzero(outside == 0)


def _touches(
    corners: Float[Array, "3 3 m"], offsets: Float[Array, "l 2"], half: float
) -> tuple[Float[Array, "2 l"], Int[Array, "2 l"]]:
    """Distances along the axis and indices among the m triangles of both fingers' touches.

    Args:
        corners: Coordinates (along, across, up) of the corners 0, 1, 2 of each triangle, m.
        offsets: Where the lines cross (across, up), m.
        half: How far from the centre the fingers are, m.
    """
    # Only a triangle whose shadow's bounding box holds a line can meet it.
    low, high = corners[1:].min(axis=1)[..., None], corners[1:].max(axis=1)[..., None]
    shadow = (low[0] <= offsets[:, 0]) & (offsets[:, 0] <= high[0])
    shadow &= (low[1] <= offsets[:, 1]) & (offsets[:, 1] <= high[1])
    triangle, line = np.nonzero(shadow)
    x, y, z = corners[:, :, triangle]  # corner, then pair of triangle and line
    y, z = y - offsets[line, 0], z - offsets[line, 1]
    # Edge functions of the edges opposite to corners 0, 1, 2: their sum is twice the area.
    a = y[1] * z[2] - z[1] * y[2]
    b = y[2] * z[0] - z[2] * y[0]
    c = y[0] * z[1] - z[0] * y[1]
    area = a + b + c
    facing = (a >= 0) & (b >= 0) & (c >= 0) & (area > 0)  # outward normal along +axis
    backing = (a <= 0) & (b <= 0) & (c <= 0) & (area < 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (a * x[0] + b * x[1] + c * x[2]) / area
    between = np.abs(along) <= half

    distance = np.full((2, len(offsets)), np.nan)
    which = np.full((2, len(offsets)), -1)
    for finger, (sign, enters, leaves) in enumerate(
        [(1.0, backing, facing), (-1.0, facing, backing)]
    ):
        entry, entered = _first(sign * along, line, enters & between, len(offsets))
        leaving, _ = _first(sign * along, line, leaves & between, len(offsets))
        touches = np.isfinite(entry) & (leaving >= entry - _SAME_CROSSING)
        distance[finger, touches] = sign * entry[touches]
        which[finger, touches] = triangle[entered[touches]]
    return distance, which


def _first(
    travel: Float[Array, "p"], line: Int[Array, "p"], among: Bool[Array, "p"], lines: int
) -> tuple[Float[Array, "l"], Int[Array, "l"]]:
    """The least travel on each line, infinite without any, and which of the p pairs has it."""
    pairs = np.flatnonzero(among)
    order = pairs[np.lexsort((travel[pairs], line[pairs]))]
    order = order[np.diff(line[order], prepend=-1) > 0]
    least, pair = np.full(lines, np.inf), np.full(lines, -1)
    least[line[order]], pair[line[order]] = travel[order], order
    return least, pair
