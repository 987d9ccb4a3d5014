"""Where to grasp: candidates over an object, filtered by what the gripper can do.

A sampler is a stream of numbered candidates that depends on the scene's key alone. They are
looked at in order until n of them pass, so a grasp does not depend on how many are asked for,
and the first n of the dense ones cover positions, angles and heights evenly.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import ConfigError, GraspError, UsageError
from gmdx.grasps.candidates import Candidates, antipodal, dense
from gmdx.grasps.collide import collides
from gmdx.grasps.contact import LineConfig, closing_contacts
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.hand import HandShape, hand_shape
from gmdx.objects.surface import Surface, random_points, surface_of
from gmdx.rng import generator
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.layout import GraspModel
from gmdx.scenes.scene import Scene

SAMPLERS = ("dense", "antipodal")
DEFAULT_SAMPLER = SAMPLERS[0]

_LOG = logging.getLogger("gmdx")
_MARGIN = 0.001  # m, around the fingers' swept boxes: the hulls lie that close to the surface


@dataclass(frozen=True)
class SampleConfig:
    """Which candidates there are, and which of them become grasps."""

    candidates: int = 16384  # of a scene; sampling ends there even if fewer grasps were found
    clearance: tuple[float, float] = (0.005, 0.010)  # m, range of the room beside the open pads
    least_clearance: float = 0.003  # m, where the stroke or the object allows no more
    table_clearance: float = 0.002  # m, between the fingertips and the table
    least_table_clearance: float = 0.0012  # m, where half the object's height is less than that
    colliding_share: float = 0.15  # of the grasps, at most: those at which the gripper collides
    surface_points: int = 4000  # random ones that, with the vertices, decide on the opening

    def __post_init__(self) -> None:
        if self.candidates < 1 or self.surface_points < 1:
            raise ConfigError("candidates and surface_points must be at least 1")
        if not 0 <= self.least_clearance <= self.clearance[0] <= self.clearance[1]:
            raise ConfigError("clearance must be a range above least_clearance, itself 0 or more")
        if not 0 <= self.least_table_clearance <= self.table_clearance:
            raise ConfigError("table_clearance must not be below least_table_clearance, nor that 0")
        if not 0 <= self.colliding_share <= 1:
            raise ConfigError(f"colliding_share is a share, {self.colliding_share} is not")


def sample_grasps(
    scene: Scene,
    n: int,
    *,
    sampler: str = DEFAULT_SAMPLER,
    gripper: Gripper | None = None,
    config: SampleConfig | None = None,
    lines: LineConfig | None = None,
) -> PlanarGrasp:
    """Choose n grasps of a scene's object, the same ones for the same scene and its seed.

    `dense` spreads the tool point over the object's silhouette, its height from just above the
    table to the object's top, and the angle over half a turn. `antipodal` takes pairs of surface
    points that face each other within their friction cones along a horizontal line. Both choose
    the smallest opening at which the fingers straddle the object with clearance, and leave out
    what the table forbids and what misses the object. Where the open gripper collides even so,
    or cannot open far enough to straddle, a grasp is kept as data on collisions as long as
    their share is small.

    Args:
        scene: The object at rest.
        n: How many; fewer are returned, with a warning, if the object has no more.
        sampler: `dense` or `antipodal`.
        gripper: The hand; the default one if None.
        config: Clearances and shares.
        lines: The intersection-line analysis, by which a candidate misses the object or not: as for
            the metrics, so that every grasp has analytical contacts.

    Returns:
        The grasps in the order of `grasp_id`, which is the number of the candidate.

    Raises:
        UsageError: The sampler is unknown, or n is not positive.
        GraspError: No candidate passed.
    """
    if sampler not in SAMPLERS:
        raise UsageError(f"no sampler '{sampler}': give one of {', '.join(SAMPLERS)}")
    if n < 1:
        raise UsageError(f"cannot sample {n} grasps: ask for 1 or more")
    config = SampleConfig() if config is None else config
    gripper = load_gripper() if gripper is None else gripper
    obj = scene.object
    key = (obj.object_id, "scene", scene.scene_id, "grasps")
    place = _workplace(scene, gripper, config, lines, generator(scene.seed, *key))

    kept = _Kept()
    for candidates in _stream(place, sampler, generator(scene.seed, *key, sampler)):
        kept.add(_opened(place, candidates), place)
        if len(kept) >= n:
            break
    grasps = kept.grasps()[:n]

    where = f"object '{obj.object_id}', scene {scene.scene_id}"
    if not len(grasps):
        raise GraspError(
            f"{where}: none of {config.candidates} {sampler} candidates fits the gripper "
            f"'{gripper.name}' (stroke {1e3 * gripper.stroke:.0f} mm): the object is too wide for "
            "it, or too flat to be held above the table; scale the object or take another gripper"
        )
    if len(grasps) < n:
        _LOG.warning("%s: only %d grasps found, %d asked for", where, len(grasps), n)
    return grasps


@dataclass(frozen=True)
class _Workplace:
    """What every candidate of one scene is looked at with."""

    scene: Scene
    gripper: Gripper
    config: SampleConfig
    lines: LineConfig
    model: GraspModel
    hand: HandShape
    surface: Surface  # in the world
    points: Float[Array, "s 3"]  # m, that stand for the surface, in the world
    clearance: Float[Array, "c"]  # m, of each candidate by number


def _workplace(
    scene: Scene,
    gripper: Gripper,
    config: SampleConfig,
    lines: LineConfig | None,
    rng: np.random.Generator,
) -> _Workplace:
    model = grasp_model(scene.object, gripper, scene.physics)
    surface = surface_of(scene.to_world(scene.object.vertices), scene.object.faces)
    drawn = random_points(surface, config.surface_points, rng)
    return _Workplace(
        scene=scene,
        gripper=gripper,
        config=config,
        lines=LineConfig() if lines is None else lines,
        model=model,
        hand=hand_shape(model),
        surface=surface,
        points=np.concatenate([surface.vertices, drawn.points]),
        clearance=rng.uniform(*config.clearance, config.candidates),
    )


def _stream(place: _Workplace, sampler: str, rng: np.random.Generator) -> Iterator[Candidates]:
    config, top = place.config, place.surface.top
    # The fingertips stay above the table, and the palm above the object's highest point.
    above = np.clip(0.5 * top, config.least_table_clearance, config.table_clearance)
    lowest = max(place.gripper.tip + float(above), top + config.least_clearance - place.hand.palm)
    if sampler == "dense":
        return dense(place.surface, config.candidates, lowest, rng)
    return antipodal(
        place.surface,
        config.candidates,
        lowest,
        rng,
        friction=place.scene.object.friction,
        stroke=place.gripper.stroke,
    )


def _opened(place: _Workplace, candidates: Candidates) -> PlanarGrasp:
    """The candidates with their openings, as far as they have the object between the pads."""
    half = np.array(
        [
            _half_opening(place, center, angle, place.clearance[number])
            for center, angle, number in zip(
                candidates.center, candidates.angle, candidates.number, strict=True
            )
        ]
    ).reshape(len(candidates))
    grasps = PlanarGrasp(candidates.number, candidates.center, candidates.angle, 2 * half)
    contacts = closing_contacts(place.scene, grasps, gripper=place.gripper, config=place.lines)
    return grasps[contacts.pads.both]


def _half_opening(
    place: _Workplace, center: Float[Array, "3"], angle: float, clearance: float
) -> float:
    """Half the smallest opening at which both fingers come down free of the object, m.

    Half the stroke if there is none. Seen along the closing axis, a finger that stands off by h
    fills [h, h + thickness]; so both are free if no surface point in the slab that they sweep
    has |x| in that interval.
    """
    x, y = place.points[:, 0] - center[0], place.points[:, 1] - center[1]
    cos, sin = np.cos(angle), np.sin(angle)
    swept = np.abs(y * cos - x * sin) <= place.hand.half_span + _MARGIN
    swept &= place.points[:, 2] >= center[2] - place.gripper.tip - _MARGIN
    off = np.sort(np.abs(x[swept] * cos + y[swept] * sin))
    # Room behind each point for a finger's clearance: in the gap before the next point, and in
    # the stroke.
    gap = np.diff(off, append=np.inf)
    room = np.minimum(0.5 * (gap - place.hand.thickness), 0.5 * place.gripper.stroke - off)
    enough = np.flatnonzero(room >= place.config.least_clearance)
    if not len(enough):
        return 0.5 * place.gripper.stroke
    return float(off[enough[0]] + min(clearance, room[enough[0]]))


class _Kept:
    """Grasps kept so far; whether another is kept depends on those before it alone."""

    def __init__(self) -> None:
        self._batches: list[PlanarGrasp] = []
        self._free = self._colliding = 0

    def __len__(self) -> int:
        return self._free + self._colliding

    def add(self, grasps: PlanarGrasp, place: _Workplace) -> None:
        """Keep the grasps that collide with nothing, and a share of others among them."""
        hits = collides(place.scene, grasps, gripper=place.gripper, model=place.model)
        keep = ~hits
        for i, hit in enumerate(hits):
            if hit:
                keep[i] = self._colliding + 1 <= place.config.colliding_share * (len(self) + 1)
            self._free += int(not hit)
            self._colliding += int(hit and keep[i])
        self._batches.append(grasps[keep])

    def grasps(self) -> PlanarGrasp:
        """All of them, in the order they came."""
        batches = self._batches
        return PlanarGrasp(
            np.concatenate([batch.grasp_id for batch in batches]),
            np.concatenate([batch.center for batch in batches]),
            np.concatenate([batch.angle for batch in batches]),
            np.concatenate([batch.width for batch in batches]),
        )
