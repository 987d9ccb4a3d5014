"""Closed triangle surfaces from profiles, sections and outlines. Lengths are in metres."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Solid:
    """A closed surface with outward, counter-clockwise triangles."""

    vertices: Floats  # (v, 3) m
    faces: Ints  # (f, 3)

    def moved(self, offset: Sequence[float]) -> "Solid":
        """The same solid, shifted by `offset`, m."""
        return Solid(self.vertices + np.asarray(offset, float), self.faces)


def densify(points: Floats, step: float, *, closed: bool = False) -> Floats:
    """A polyline with points added so that no segment is longer than `step`."""
    points = np.asarray(points, float)
    ends = np.roll(points, -1, axis=0) if closed else points[1:]
    pieces = []
    for start, end in zip(points, ends, strict=False):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / step - 1e-9)))
        pieces.append(start + (end - start) * (np.arange(count) / count)[:, None])
    if not closed:
        pieces.append(points[-1:])
    return np.concatenate(pieces)


def arc(center: Sequence[float], radius: float, start: float, end: float, count: int) -> Floats:
    """Points (count, 2) on a circle's arc, angles in degrees, both ends included."""
    angle = np.radians(np.linspace(start, end, count))
    return np.asarray(center, float) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def superellipse(a: float, b: float, power: float, count: int) -> Floats:
    """Points (count, 2) on |x/a|^power + |y/b|^power = 1; 2 is an ellipse, large a rectangle."""
    angle = 2 * np.pi * np.arange(count) / count
    c, s = np.cos(angle), np.sin(angle)
    radius = (np.abs(c) ** power + np.abs(s) ** power) ** (-1 / power)
    return np.stack([a * radius * c, b * radius * s], axis=1)


def _stitch(a: Ints, b: Ints, vertices: Floats) -> Ints:
    """Triangles between two rings of equal length, of half or double, or a single point."""
    a1, b1 = np.roll(a, -1), np.roll(b, -1)
    if len(a) == 1:
        return np.stack([np.broadcast_to(a, b.shape), b1, b], axis=1)
    if len(b) == 1:
        return np.stack([a, a1, np.broadcast_to(b, a.shape)], axis=1)
    if len(a) == len(b):
        rising = np.linalg.norm(vertices[a] - vertices[b1], axis=1)
        falling = np.linalg.norm(vertices[a1] - vertices[b], axis=1)
        straight = (rising <= falling + 1e-9)[:, None]
        first = np.where(straight, np.stack([a, a1, b1], 1), np.stack([a, a1, b], 1))
        second = np.where(straight, np.stack([a, b1, b], 1), np.stack([a1, b1, b], 1))
        return np.concatenate([first, second])
    if len(a) == 2 * len(b):
        even, odd, following = a[0::2], a[1::2], a1[1::2]
        corners = [[even, odd, b], [odd, b1, b], [odd, following, b1]]
    elif len(b) == 2 * len(a):
        even, odd, following = b[0::2], b[1::2], b1[1::2]
        corners = [[a, odd, even], [a, a1, odd], [a1, following, odd]]
    else:
        raise ValueError(f"cannot join rings of {len(a)} and {len(b)} points")
    return np.concatenate([np.stack(corner, axis=1) for corner in corners])


def loft(sections: Sequence[Floats], *, closed: bool = False) -> Solid:
    """The surface through sections that lie one above the other.

    Args:
        sections: (k, 3) closed curves, counter-clockwise seen from the direction they
            advance in; k may halve or double from one to the next. Unless `closed`, the
            first and the last are single points (1, 3); `cap` makes them.
        closed: Join the last section to the first.
    """
    vertices = np.concatenate(sections)
    starts = np.cumsum([0, *(len(section) for section in sections)])
    rings = [np.arange(a, b) for a, b in pairwise(starts)]
    if not closed and (len(rings[0]) > 1 or len(rings[-1]) > 1):
        raise ValueError("the first and last section of an open loft must be single points")
    following = rings[1:] + (rings[:1] if closed else [])
    faces = [_stitch(a, b, vertices) for a, b in zip(rings, following, strict=False)]
    return Solid(vertices, np.concatenate(faces))


def cap(section: Floats, step: float) -> list[Floats]:
    """Sections from near `section` to its centre: a flat end, with triangles about `step` wide."""
    center = section.mean(axis=0)
    radius = float(np.linalg.norm(section - center, axis=1).max())
    rings = max(1, round(radius / step))
    sections: list[Floats] = []
    current = section
    for i in range(1, rings):
        share = 1 - i / rings
        if len(current) % 2 == 0 and len(current) > 6 and share < 0.7 * len(current) / len(section):
            current = current[::2]
        sections.append(center + share * (current - center))
    return [*sections, center[None]]


def lofted(sections: Sequence[Floats], step: float) -> Solid:
    """A loft with flat ends."""
    below = cap(sections[0], step)[::-1]
    return loft([*below, *sections, *cap(sections[-1], step)])


def _ring_counts(radius: Floats, segments: int) -> list[int]:
    """Points on each ring: fewer towards a pole, at most halved from ring to ring."""
    counts = [segments if r > 0 else 1 for r in radius]
    for order in (1, -1):
        indices = list(range(len(radius)))[::order]
        if radius[indices[0]] > 0:
            continue
        rise = [indices[1]]
        for i in indices[2:]:
            if radius[i] <= radius[rise[-1]]:
                break
            rise.append(i)
        widest = radius[rise[-1]]
        allowed = segments
        for i in reversed(rise):
            if allowed % 2 == 0 and allowed > 6 and radius[i] / widest < 0.5 * allowed / segments:
                allowed //= 2
            counts[i] = min(counts[i], allowed)
    return counts


def revolve(profile: Floats, *, segments: int, closed: bool = False) -> Solid:
    """The solid that a profile sweeps out around the z axis.

    Args:
        profile: (m, 2) radius and height; the solid lies to the left of its direction of
            travel (outer walls go up). It starts and ends on the axis unless `closed`.
        segments: Points on the widest rings.
        closed: The profile is a closed curve off the axis, and the solid a ring.
    """
    radius, height = np.asarray(profile, float).T
    counts = [segments] * len(radius) if closed else _ring_counts(radius, segments)
    sections = []
    for r, z, count in zip(radius, height, counts, strict=True):
        angle = 2 * np.pi * np.arange(count) / count
        ring = np.stack([r * np.cos(angle), r * np.sin(angle), np.full(count, z)], axis=1)
        sections.append(ring)
    return loft(sections, closed=closed)


def sweep(path: Floats, section: Floats, step: float) -> Solid:
    """A section carried along a path in the xz plane, with flat ends.

    Args:
        path: (m, 2) x and z, m.
        section: (k, 2) counter-clockwise: along the path's normal and along y, m.
        step: Width of the triangles of the ends, m.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    sections = []
    for (x, z), (tx, tz) in zip(path, tangent, strict=True):
        normal = np.array([tz, 0.0, -tx])
        origin = np.array([x, 0.0, z])
        sections.append(origin + section[:, :1] * normal + section[:, 1:] * [0.0, 1.0, 0.0])
    return lofted(sections, step)


def _inside(points: Floats, loops: Sequence[Floats]) -> npt.NDArray[np.bool_]:
    """Even-odd test of points (n, 2) against closed loops."""
    inside = np.zeros(len(points), bool)
    for loop in loops:
        for (x0, y0), (x1, y1) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            if y0 == y1:
                continue
            crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
            at = x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0)
            inside ^= crosses & (points[:, 0] < at)
    return inside


def _distance(points: Floats, loops: Sequence[Floats]) -> Floats:
    """Distance of points (n, 2) from closed loops."""
    best = np.full(len(points), np.inf)
    for loop in loops:
        for start, end in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            edge = end - start
            share = np.clip((points - start) @ edge / (edge @ edge), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - start - share[:, None] * edge, axis=1))
    return best


def _fill(loops: Sequence[Floats], step: float, extra: Floats) -> tuple[Floats, Ints]:
    """A Delaunay mesh of the area between loops: the loops' points first, then inner ones."""
    from scipy.spatial import Delaunay

    outline = np.concatenate(loops)
    low, high = outline.min(axis=0), outline.max(axis=0)
    rows = np.arange(low[1] + 0.31 * step, high[1], step * np.sqrt(3) / 2)
    columns = np.arange(low[0] - step, high[0] + step, step)
    lattice = np.concatenate(
        [np.zeros((0, 2))]
        + [
            np.stack([columns + 0.5 * step * (i % 2), np.full(len(columns), y)], axis=1)
            for i, y in enumerate(rows)
        ]
    )
    lattice = lattice[_inside(lattice, loops) & (_distance(lattice, loops) > 0.6 * step)]
    if len(extra):
        extra = extra[_inside(extra, loops) & (_distance(extra, loops) > 0.4 * step)]
        gaps = np.linalg.norm(lattice[:, None] - extra[None], axis=2).min(axis=1)
        lattice = lattice[gaps > 0.6 * step]
    points = np.concatenate([outline, extra.reshape(-1, 2), lattice])
    faces = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[faces].transpose(1, 0, 2)
    double = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces[double < 0] = faces[double < 0][:, ::-1]
    keep = (np.abs(double) > 1e-6 * step**2) & _inside((a + b + c) / 3, loops)
    return points, faces[keep]


def extrude(
    loops: Sequence[Floats], height: float, *, step: float, extra: Floats | None = None
) -> Solid:
    """A prism over the area between closed loops, from z = 0 to `height`.

    Args:
        loops: (k, 2) outline, counter-clockwise, then holes, clockwise.
        height: m.
        step: Longest edge along the outline and typical edge inside, m.
        extra: (n, 2) points that the flat faces must have, if inside.

    Raises:
        ValueError: If the outline is too coarse or too narrow to be meshed at `step`.
    """
    loops = [densify(loop, step, closed=True) for loop in loops]
    flat, faces = _fill(loops, step, np.zeros((0, 2)) if extra is None else extra)
    rims = []
    start = 0
    for loop in loops:
        rims.append(np.arange(start, start + len(loop)))
        start += len(loop)
    edges = {(int(a), int(b)) for f in faces for a, b in zip(f, np.roll(f, -1), strict=True)}
    wanted = {(int(a), int(b)) for r in rims for a, b in zip(r, np.roll(r, -1), strict=True)}
    if {(a, b) for a, b in edges if (b, a) not in edges} != wanted:
        raise ValueError(f"the flat mesh does not follow its outline at a step of {step} m")
    layers = max(1, round(height / step))
    levels = [np.column_stack([flat, np.zeros(len(flat))])]
    levels += [np.column_stack([flat[:start], np.full(start, height * i / layers)])
               for i in range(1, layers)]  # fmt: skip
    levels.append(np.column_stack([flat, np.full(len(flat), height)]))
    vertices = np.concatenate(levels)
    offsets = np.cumsum([0, *(len(level) for level in levels[:-1])])
    walls = [
        _stitch(rim + below, rim + above, vertices)
        for rim in rims
        for below, above in pairwise(offsets)
    ]
    return Solid(vertices, np.concatenate([faces[:, ::-1], *walls, faces + offsets[-1]]))


def bend(solid: Solid, radius: float, angle: float) -> Solid:
    """Bends what lies at x > 0 upwards by `angle`, rad; the plane z = 0 keeps its lengths.

    Args:
        solid: Its height above and below z = 0 must be smaller than `radius`.
        radius: Of the plane z = 0 in the bend, m.
        angle: rad.
    """
    x, y, z = solid.vertices.T
    turn = np.clip(x / radius, 0.0, angle)
    straight = np.where(x < 0, x, np.maximum(x - radius * angle, 0.0))
    along, up = radius * np.sin(turn), radius * (1 - np.cos(turn))
    c, s = np.cos(turn), np.sin(turn)
    vertices = np.stack([along + straight * c - z * s, y, up + straight * s + z * c], axis=1)
    return Solid(vertices, solid.faces)
