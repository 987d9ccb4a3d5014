"""What a first touch is: which of the lines and triangles that may meet do, and where."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

if TYPE_CHECKING:
    Array = np.ndarray[Any, np.dtype[Any]]
else:
    Array = np.ndarray

SAME_CROSSING = 1e-9  # m, crossings closer than this are one: a line through a silhouette edge


@dataclass(frozen=True)
class FirstTouch:
    """First touches of l lines a grasp; finger 0 comes from the axis' negative side."""

    distance: Float[Array, "n 2 l"]  # m along the axis from the centre; NaN where none
    triangle: Int[Array, "n 2 l"]  # index of the touched triangle; -1 where none


@dataclass(frozen=True)
class Problem:
    """A closed surface and the lines of n grasps; see `closing_lines`."""

    corners: Float[Array, "3 3 f"]  # m: coordinate, corner, triangle
    center: Float[Array, "n 3"]  # m
    frame: Float[Array, "n 3 3"]  # rows: along the axis, across, up
    half: Float[Array, "n"]  # m, from the centre to where either finger starts
    offsets: Float[Array, "l 2"]  # m, across and up


@dataclass(frozen=True)
class Pairs:
    """Lines and triangles that may meet; every pair that does meet is among them."""

    line: Int[Array, "p"]  # grasp x l + line
    triangle: Int[Array, "p"]


@dataclass(frozen=True)
class Crossings:
    """Where each pair's line crosses its triangle."""

    along: Float[Array, "p"]  # m along the axis from the centre; NaN where they do not meet
    leaves: Bool[Array, "p"]  # the solid, for who goes along the axis
    enters: Bool[Array, "p"]


def corner_coordinate(
    problem: Problem, row: int, grasp: Int[Array, "p"], triangle: Int[Array, "p"]
) -> Float[Array, "3 p"]:
    """One coordinate (0 along, 1 across, 2 up) of a triangle's corners 0, 1, 2, m.

    Products are added from left to right, for every vertex alike: what two triangles share
    has exactly the same coordinates in both.
    """
    x, y, z = problem.frame[grasp, row].T
    a, b, c = problem.center[grasp].T
    u, v, w = (coordinate.take(triangle, axis=1) for coordinate in problem.corners)
    return np.asarray((u - a) * x + (v - b) * y + (w - c) * z)


def crossings(problem: Problem, pairs: Pairs) -> Crossings:
    """Where lines cross triangles, if they do, and in which direction.

    Edge functions of the edges opposite to corners 0, 1, 2 say on which side a line passes;
    their sum is twice the area of the triangle's shadow.
    """
    grasp, number = np.divmod(pairs.line, len(problem.offsets))
    y = corner_coordinate(problem, 1, grasp, pairs.triangle) - problem.offsets[number, 0]
    z = corner_coordinate(problem, 2, grasp, pairs.triangle) - problem.offsets[number, 1]
    a = y[1] * z[2] - z[1] * y[2]
    b = y[2] * z[0] - z[2] * y[0]
    c = y[0] * z[1] - z[0] * y[1]
    area = a + b + c
    leaves = (a >= 0) & (b >= 0) & (c >= 0) & (area > 0)  # outward normal along +axis
    enters = (a <= 0) & (b <= 0) & (c <= 0) & (area < 0)
    met = np.flatnonzero(leaves | enters)
    x = corner_coordinate(problem, 0, grasp[met], pairs.triangle[met])
    along = np.full(len(area), np.nan)
    along[met] = (a[met] * x[0] + b[met] * x[1] + c[met] * x[2]) / area[met]
    between = np.zeros(len(area), bool)
    between[met] = np.abs(along[met]) <= problem.half[grasp[met]]
    return Crossings(along, leaves & between, enters & between)


def decide(problem: Problem, pairs: Pairs) -> FirstTouch:
    """The first touches among all the pairs that may meet."""
    n, lines = len(problem.center), len(problem.offsets)
    found = crossings(problem, pairs)
    distance, triangle = np.full((2, n * lines), np.nan), np.full((2, n * lines), -1)
    for finger, (sign, enters, leaves) in enumerate(
        [(1.0, found.enters, found.leaves), (-1.0, found.leaves, found.enters)]
    ):
        travel = sign * found.along
        entry, leaving = np.full((2, n * lines), np.inf)
        np.minimum.at(entry, pairs.line[enters], travel[enters])
        np.minimum.at(leaving, pairs.line[leaves], travel[leaves])
        touches = np.isfinite(entry) & (leaving >= entry - SAME_CROSSING)
        # Of triangles crossed at one place the first counts, whatever the rounding.
        first = np.flatnonzero(enters)
        first = first[touches[pairs.line[first]]]
        first = first[travel[first] <= entry[pairs.line[first]] + SAME_CROSSING]
        first = first[np.argsort(-pairs.triangle[first], kind="stable")]
        triangle[finger, pairs.line[first]] = pairs.triangle[first]
        distance[finger, pairs.line[first]] = found.along[first]
    return FirstTouch(
        np.ascontiguousarray(distance.reshape(2, n, lines).transpose(1, 0, 2)),
        np.ascontiguousarray(triangle.reshape(2, n, lines).transpose(1, 0, 2)),
    )
