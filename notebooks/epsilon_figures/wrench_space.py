"""The grasp wrench space cut by planes through 0, and how approximations close in on it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import ConfigError, MetricError
from gmdx.metrics.epsilon import Epsilon, directional_strength, epsilon
from gmdx.metrics.epsilon.wrench import tangents
from gmdx.studies.epsilon import Contacts, HullEpsilon, linearised_epsilon, sampled_epsilon


@dataclass(frozen=True)
class WrenchSlice:
    """Where three dimensions of wrenches, the worst direction among them, cut the space.

    The first axis is the worst direction, so the ball touches the boundary where it leaves
    along that axis; the others are torques across the line between two contacts, made
    perpendicular to it.
    """

    epsilon: Epsilon
    axes: Float[Array, "3 6"]  # orthonormal rows: (force, torque / torque_scale)
    directions: Float[Array, "r c 3"]  # unit, in these axes: from pole to pole, all around
    reach: Float[Array, "r c"]  # of the wrench space along them, for unit grip

    @property
    def surface(self) -> Float[Array, "r c 3"]:
        """Points of the boundary."""
        points: Array = self.directions * self.reach[..., None]
        return points


@dataclass(frozen=True)
class WrenchSection:
    """Where the plane of the worst direction and one other cuts the space and two hulls."""

    epsilon: Epsilon
    angle: Float[Array, "n"]  # rad, from the worst direction; all around
    reach: Float[Array, "n"]  # of the wrench space
    linearised: Float[Array, "n"]
    sampled: Float[Array, "n"]
    edges: int  # of the linearised cones
    samples: int  # of each limit surface


@dataclass(frozen=True)
class HullErrors:
    """By how much hulls miss epsilon on n grasps, for growing numbers of wrenches a contact."""

    edges: Int[Array, "a"]
    linearised: Float[Array, "a n"]  # 1 - value / certified
    linearised_ms: Float[Array, "a"]  # processor time a grasp
    samples: Int[Array, "b"]
    sampled: Float[Array, "b n"]
    sampled_ms: Float[Array, "b"]
    gap: Float[Array, "n"]  # proved, of the certified values, relative
    certified_ms: float


def slice_axes(contacts: Contacts, worst: Float[Array, "6"]) -> Float[Array, "3 6"]:
    """The worst direction, and two torques across the line between a pair's contacts.

    Raises:
        MetricError: There are not two contacts, or they coincide.
    """
    if len(contacts.points) != 2:
        raise MetricError(f"this slice is one of a pair, not of {len(contacts.points)} contacts")
    line = contacts.points[1] - contacts.points[0]
    length = float(np.linalg.norm(line))
    if length == 0.0:
        raise MetricError("both contacts are at the same point: there is no line between them")
    across = tangents(line / length)
    rows = [worst, *(np.concatenate([np.zeros(3), t]) for t in across)]
    q, r = np.linalg.qr(np.stack(rows, axis=1))
    axes: Array = (q * np.sign(np.diag(r))).T
    return axes


def wrench_slice(contacts: Contacts, *, rings: int = 29, spokes: int = 48) -> WrenchSlice:
    """Cut a pair's wrench space by the three dimensions of `slice_axes`.

    Args:
        contacts: A pair with force closure.
        rings: Points from pole to pole.
        spokes: Points around the poles, which lie along the worst direction.

    Raises:
        MetricError: It is no such pair.
        ConfigError: There are too few points.
    """
    if rings < 3 or spokes < 3:
        raise ConfigError(f"a slice needs 3 rings and 3 spokes or more, not {rings} and {spokes}")
    found = _closed(contacts)
    axes = slice_axes(contacts, found.direction)
    tilt = np.linspace(0.0, np.pi, rings)[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, spokes + 1)[None]
    around = np.ones_like(turn)
    directions = np.stack(
        [np.cos(tilt) * around, np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)], axis=-1
    )
    reach = np.empty((rings, spokes + 1))
    for i in range(rings):
        for j in range(spokes):
            poles = i in (0, rings - 1) and j > 0
            reach[i, j] = reach[i, 0] if poles else _reach(contacts, _unit(directions[i, j] @ axes))
    reach[:, -1] = reach[:, 0]
    return WrenchSlice(found, axes, directions, reach)


def wrench_section(
    contacts: Contacts, *, edges: int = 8, samples: int = 16, points: int = 240
) -> WrenchSection:
    """Cut the space and its approximations by the plane of the first two of `slice_axes`.

    Args:
        contacts: A pair with force closure.
        edges: Of the linearised cones.
        samples: Points of each limit surface.
        points: Of the curves.

    Raises:
        MetricError: It is no such pair.
    """
    found = _closed(contacts)
    axes = slice_axes(contacts, found.direction)
    angle = np.linspace(0.0, 2.0 * np.pi, points + 1)
    directions = np.column_stack([np.cos(angle), np.sin(angle)]) @ axes[:2]
    grasp = (contacts.points, contacts.normals)
    return WrenchSection(
        epsilon=found,
        angle=angle,
        reach=np.array([_reach(contacts, _unit(d)) for d in directions]),
        linearised=_hull_reach(
            linearised_epsilon(*grasp, **contacts.parameters, edges=edges), directions
        ),
        sampled=_hull_reach(
            sampled_epsilon(*grasp, **contacts.parameters, samples=samples), directions
        ),
        edges=edges,
        samples=samples,
    )


def hull_errors(
    grasps: Sequence[Contacts],
    *,
    edges: Sequence[int] = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64),
    samples: Sequence[int] = (6, 8, 12, 16, 24, 32, 48, 64),
) -> HullErrors:
    """The errors of both hulls on the same grasps, and what they and the certified value cost.

    Args:
        grasps: With force closure.
        edges: Of the linearised cones, to try.
        samples: Points of each limit surface, to try.

    Raises:
        MetricError: A grasp has no force closure, so no relative error.
    """
    start = time.process_time()
    exact = [_closed(grasp) for grasp in grasps]
    certified = 1e3 * (time.process_time() - start) / len(grasps)
    value = np.array([found.upper for found in exact])
    cones, surfaces = (np.empty((len(counts), len(grasps))) for counts in (edges, samples))
    cones_ms, surfaces_ms = np.empty(len(edges)), np.empty(len(samples))
    for i, count in enumerate(edges):
        start = time.process_time()
        cones[i] = [
            linearised_epsilon(g.points, g.normals, **g.parameters, edges=count).value
            for g in grasps
        ]
        cones_ms[i] = 1e3 * (time.process_time() - start) / len(grasps)
    for i, count in enumerate(samples):
        start = time.process_time()
        surfaces[i] = [
            sampled_epsilon(g.points, g.normals, **g.parameters, samples=count).value
            for g in grasps
        ]
        surfaces_ms[i] = 1e3 * (time.process_time() - start) / len(grasps)
    return HullErrors(
        edges=np.array(edges),
        linearised=1.0 - cones / value,
        linearised_ms=cones_ms,
        samples=np.array(samples),
        sampled=1.0 - surfaces / value,
        sampled_ms=surfaces_ms,
        gap=np.array([found.gap for found in exact]),
        certified_ms=certified,
    )


def _closed(contacts: Contacts) -> Epsilon:
    found = epsilon(contacts.points, contacts.normals, **contacts.parameters)
    if not found.closure:
        raise MetricError(f"the grasp has no force closure (epsilon {found.upper:.3g}): choose one")
    return found


def _reach(contacts: Contacts, direction: Float[Array, "6"]) -> float:
    """How far the wrench space reaches along a (force, torque / torque_scale) of length 1."""
    load = -direction * np.repeat([1.0, contacts.torque_scale], 3)
    return directional_strength(
        contacts.points, contacts.normals, **contacts.parameters, wrench=load
    ).value


def _hull_reach(hull: HullEpsilon, directions: Float[Array, "n 6"]) -> Float[Array, "n"]:
    """How far a hull reaches along unit directions from 0, which must lie inside."""
    slopes = directions @ hull.facets[:, :6].T
    with np.errstate(divide="ignore"):
        cuts = np.where(slopes > 0, -hull.facets[:, 6] / slopes, np.inf)
    return np.asarray(cuts.min(axis=1))


def _unit(v: Float[Array, "6"]) -> Float[Array, "6"]:
    scaled: Array = v / np.linalg.norm(v)
    return scaled
