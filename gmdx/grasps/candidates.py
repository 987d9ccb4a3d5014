"""Streams of numbered grasp candidates over an object at rest, before any opening is chosen."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from gmdx_kernels.closing_lines import closing_lines

from gmdx.arrays import Array, Float, Int
from gmdx.objects.surface import Surface, random_points

_BLOCK = 128  # candidates looked at together: only a matter of speed
_ONE_LINE = np.zeros((1, 2))
_SKIN = 1e-6  # m, in front of a surface point: where a line through it starts


@dataclass(frozen=True)
class Candidates:
    """A batch of candidates; their numbers are unique in a scene."""

    number: Int[Array, "n"]
    center: Float[Array, "n 3"]  # m, of the tool point
    angle: Float[Array, "n"]  # rad in [0, pi), of the closing axis

    def __len__(self) -> int:
        return len(self.number)


def dense(
    surface: Surface, n: int, lowest: float, rng: np.random.Generator
) -> Iterator[Candidates]:
    """Candidates spread evenly over silhouette x height x angle.

    They follow Halton's low-discrepancy sequence (1960), shifted at random (Cranley and
    Patterson 1976): its first m members cover all four dimensions evenly, whatever m is.
    Positions fill the rectangle along the principal axes of the object's footprint; those that
    are not above the object are left out. Heights go from `lowest` to the surface's top there.

    Args:
        surface: The object at rest.
        n: How many candidates are numbered.
        lowest: Least height of the tool point, m.
        rng: Shifts the sequence.
    """
    fractions = np.mod(rng.random(4) + _halton(n), 1.0)
    footprint = surface.vertices[:, :2]
    spread = footprint - footprint.mean(axis=0)
    axes = np.linalg.eigh(np.einsum("va,vb->ab", spread, spread))[1]
    extent = np.einsum("va,ab->vb", footprint, axes)
    low, high = extent.min(axis=0), extent.max(axis=0)
    for number in _blocks(n):
        u = fractions[number]
        xy = np.einsum("nb,ab->na", low + u[:, :2] * (high - low), axes)
        top = _height_at(surface, xy)
        above = np.isfinite(top)
        height = lowest + u[:, 2] * np.maximum(top - lowest, 0.0)
        center = np.column_stack([xy, height])
        yield Candidates(number[above], center[above], half_turn(np.pi * u[above, 3]))


def antipodal(
    surface: Surface,
    n: int,
    lowest: float,
    rng: np.random.Generator,
    *,
    friction: float,
    stroke: float,
) -> Iterator[Candidates]:
    """Candidates midway between surface points that face each other along a horizontal line.

    From a random point a line enters the object within the point's friction cone; the second
    point is where the line last leaves it within a random part of the stroke (so that a wall
    is found as well as the whole vessel), and must have the line in its friction cone, too.

    Args:
        surface: The object at rest.
        n: How many first points are drawn.
        lowest: Least height of the tool point, m.
        rng: Draws points and directions.
        friction: Sliding coefficient of the pads on the object.
        stroke: Largest distance of the two points, m.
    """
    drawn = random_points(surface, n, rng)
    first = drawn.points
    turn, reach = rng.uniform(-1, 1, n), stroke * rng.random(n)
    inward = -surface.normals[drawn.face]
    level = np.hypot(inward[:, 0], inward[:, 1])
    cone = 1.0 / np.hypot(1.0, friction)  # cosine of the friction cone's half angle
    with np.errstate(divide="ignore"):
        spread = np.arccos(np.minimum(cone / level, 1.0))
    direction = np.arctan2(inward[:, 1], inward[:, 0]) + turn * spread
    axis = np.column_stack([np.cos(direction), np.sin(direction), np.zeros(n)])
    up = np.array([0.0, 0.0, 1.0])
    for block in _blocks(n):
        number = block[level[block] >= cone]
        half = 0.5 * reach[number] + _SKIN
        touch = closing_lines(
            surface.vertices,
            surface.faces,
            first[number] + (half - _SKIN)[:, None] * axis[number],
            axis[number],
            np.broadcast_to(up, (len(number), 3)),
            2 * half,
            offsets=_ONE_LINE,
        )
        near, far = touch.distance[:, 0, 0], touch.distance[:, 1, 0]
        grip = (surface.normals[touch.triangle[:, 1, 0]] * axis[number]).sum(axis=1)
        pair = (np.abs(near + half - _SKIN) < _SKIN) & np.isfinite(far) & (grip >= cone)
        number, far, half = number[pair], far[pair], half[pair]
        center = first[number] + (0.5 * (half - _SKIN + far))[:, None] * axis[number]
        center[:, 2] = np.maximum(center[:, 2], lowest)
        yield Candidates(number, center, half_turn(direction[number]))


def half_turn(angle: Float[Array, "n"]) -> Float[Array, "n"]:
    """Undirected axes' angles, rad, brought into [0, pi)."""
    angle = np.mod(angle, np.pi)
    return np.where(angle < np.pi, angle, 0.0)  # mod rounds up to pi just below 0


def _halton(n: int) -> Float[Array, "n 4"]:
    """The first n members in four dimensions: each number's digits mirrored, in bases 2 to 7."""
    columns = []
    for base in (2, 3, 5, 7):
        rest, value, digit = np.arange(n), np.zeros(n), 1.0
        while rest.any():
            digit /= base
            value += digit * (rest % base)
            rest = rest // base
        columns.append(value)
    return np.stack(columns, axis=1)


def _blocks(n: int) -> Iterator[Int[Array, "m"]]:
    for start in range(0, n, _BLOCK):
        yield np.arange(start, min(start + _BLOCK, n))


def _height_at(surface: Surface, xy: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Height of the highest surface point above each place, m; NaN beside the object."""
    n = len(xy)
    touch = closing_lines(
        surface.vertices,
        surface.faces,
        np.column_stack([xy, np.zeros(n)]),
        np.broadcast_to([0.0, 0.0, 1.0], (n, 3)),
        np.broadcast_to([1.0, 0.0, 0.0], (n, 3)),
        np.full(n, 2.0 * surface.top + 1.0),
        offsets=_ONE_LINE,
    )
    height: Array = touch.distance[:, 1, 0]
    return height
