"""Closed forms that every engine should meet: to which of two does a difference belong?

Rigid bodies with Coulomb friction, friction mu, closing force N of each pad, weight W = m g:

- push: a box between the pads comes out at 2 mu N - W downwards, at 2 mu N + W upwards, and at
  sqrt((2 mu N)^2 - W^2) sideways, since friction bears the weight as well;
- tilt: faces that lean inward by theta press the grip off: 2 N tan(phi - theta) - W downwards,
  with phi = arctan mu, and nothing is held beyond phi;
- lift: a box is held if 2 mu N > m (g + a), with a the lift's largest acceleration, and lost if
  2 mu N < W;
- creep, rest, closing: what is held or lies still does not move; coupled fingers centre a box,
  and end as far apart as it is wide.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from gmdx.arrays import Array, Float
from gmdx.geometry import quaternion_matrix, rotation_angle
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.physics import GRAVITY, PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import Snapshot, TrialResults
from gmdx.trials.run import run_trials

logger = logging.getLogger("gmdx")

_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
_BOX = (0.03, 0.04, 0.05)  # m


@dataclass(frozen=True)
class TruthRow:
    """One closed form and what one engine makes of it."""

    quantity: str
    setting: str
    engine: str
    expected: float
    measured: float  # NaN where the trial did not come that far
    unit: str  # "" for 1 held, 0 lost

    @property
    def error(self) -> float:
        """Measured - expected, in the unit."""
        return self.measured - self.expected

    @property
    def ratio(self) -> float:
        """Measured / expected; NaN where 0 is expected."""
        return self.measured / self.expected if self.expected else float("nan")


@dataclass(frozen=True)
class _Case:
    quantity: str
    setting: str
    expected: float
    unit: str
    object: ObjectModel
    config: TrialConfig
    x: float = 0.0  # m, of the tool point beside the object
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    width: float = 0.05  # m
    height: float | None = None  # m, of the tool point; None: of the centre of mass


def truth_table(
    engines: Sequence[str],
    *,
    gripper: Gripper | None = None,
    physics: PhysicsConfig | None = None,
    config: TrialConfig | None = None,
) -> tuple[TruthRow, ...]:
    """Every closed form on every engine; those too wide for the gripper are left out.

    Args:
        engines: Names.
        gripper: The default one if not given.
        physics: But friction, which is the cases' own; the default one if not given.
        config: The protocol; directions, ramps and times are the cases' own.

    Raises:
        UsageError: An engine is not known.
    """
    gripper = load_gripper() if gripper is None else gripper
    physics = PhysicsConfig() if physics is None else physics
    config = TrialConfig() if config is None else config
    rows = []
    for case in _cases(gripper, config):
        if case.width > gripper.stroke:
            logger.info("closed form left out: %s, %s is too wide for the gripper %s",
                        case.quantity, case.setting, gripper.name)  # fmt: skip
            continue
        scene = _scene(case.object, np.array(case.quaternion), physics)
        height = float(scene.position[2]) if case.height is None else case.height
        grasp = PlanarGrasp(
            np.array([0]),
            np.array([[case.x, 0.0, height]]),
            np.array([0.0]),
            np.array([case.width]),
        )
        for engine in engines:
            trials = run_trials(scene, grasp, engine, trials=1, gripper=gripper, config=case.config)
            measured = _measured(case, trials)
            rows.append(
                TruthRow(case.quantity, case.setting, engine, case.expected, measured, case.unit)
            )
    return tuple(rows)


def _cases(gripper: Gripper, config: TrialConfig) -> Iterator[_Case]:
    force = gripper.force
    down, up = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
    for friction in (0.3, 0.8):
        for mass in (0.1, 0.5):
            grip, weight = 2 * friction * force, mass * GRAVITY
            box = _box(_BOX, friction=friction, mass=mass)
            setting = f"mu {friction:g}, {mass:g} kg"
            for name, direction, expected in (
                ("down", down, grip - weight),
                ("up", up, grip + weight),
                ("sideways", (0.0, 1.0, 0.0), (grip**2 - weight**2) ** 0.5),
            ):
                pushed = replace(config, push_direction=direction)
                yield _Case(f"push {name}", setting, expected, "N", box, pushed)
    yield from _tilts(gripper, config, down)
    yield from _lifts(force, config)
    held = replace(config, hold_time=2.0, still_speed=0.0)
    box = _box(_BOX)
    yield _Case("creep in 2 s", "mu 0.8, 0.1 kg", 0.0, "mm", box, held)
    yield _Case("opening", "box 30 mm wide", 30.0, "mm", box, config)
    yield _Case("centring", "8 mm beside the middle", 0.0, "mm", box, config, x=0.008, width=0.06)
    half = 0.5**0.5
    for setting, quaternion in (
        ("on 30 x 40 mm", (1.0, 0.0, 0.0, 0.0)),
        ("on 30 x 50 mm", (half, half, 0.0, 0.0)),
        ("on 40 x 50 mm", (half, 0.0, half, 0.0)),
    ):
        width = 0.06 if quaternion[2] else 0.05
        options = {"quaternion": quaternion, "width": width}
        yield _Case("shift at rest", setting, 0.0, "mm", box, config, **options)  # type: ignore[arg-type]
        yield _Case("turn at rest", setting, 0.0, "mrad", box, config, **options)  # type: ignore[arg-type]


def _tilts(
    gripper: Gripper, config: TrialConfig, down: tuple[float, float, float]
) -> Iterator[_Case]:
    friction, mass = 0.8, 0.1
    steepest = float(np.arctan(friction))
    pushed = replace(config, push_direction=down)
    middle = 0.5 * _WEDGE_HEIGHT

    def opening(tilt: float) -> float:
        """Wide enough for the fingertips to pass the wedge down to its middle."""
        return 2 * (_WEDGE_HALF + (gripper.tip + 0.002) * float(np.tan(tilt)))

    for degrees in (5.0, 10.0, 20.0):
        tilt = float(np.radians(degrees))
        grip = 2 * gripper.force * float(np.tan(steepest - tilt))
        wedge = _wedge(tilt, friction=friction, mass=mass)
        yield _Case("push down, tilted faces", f"{degrees:g} deg", grip - mass * GRAVITY, "N",
                    wedge, pushed, width=opening(tilt), height=middle)  # fmt: skip
    for degrees, held in ((-5.0, 1.0), (5.0, 0.0)):
        tilt = steepest + float(np.radians(degrees))
        wedge = _wedge(tilt, friction=friction, mass=mass)
        yield _Case("tilted faces held", f"friction angle {degrees:+g} deg", held, "", wedge,
                    config, width=opening(tilt), height=middle)  # fmt: skip


def _lifts(force: float, config: TrialConfig) -> Iterator[_Case]:
    friction = 0.3
    grip = 2 * friction * force
    # Minimum jerk: the largest acceleration is 10 / sqrt(3) of height / time^2.
    fastest = 10.0 / 3.0**0.5 * config.lift_height / config.lift_time**2
    for share, expected, pull in ((0.85, 1.0, GRAVITY + fastest), (1.15, 0.0, GRAVITY)):
        mass = share * grip / pull
        setting = f"{share:g} of the {'largest' if expected else 'static'} load"
        box = _box(_BOX, friction=friction, mass=mass)
        yield _Case("box lifted", setting, expected, "", box, config)


def _measured(case: _Case, trials: TrialResults) -> float:
    """The quantity of the one trial."""
    position, quaternion = trials.object_position[0], trials.object_quaternion[0]
    success = bool(trials.outcome[0, 0] == Outcome.SUCCESS)
    if case.quantity.startswith("push"):
        return float(trials.push_force[0]) if success else float("nan")
    if case.quantity in ("tilted faces held", "box lifted"):
        return float(success)
    if case.quantity == "creep in 2 s":
        held = position - trials.tool_position[0]
        return 1e3 * float(np.linalg.norm(held[Snapshot.HELD] - held[Snapshot.CLOSED]))
    if case.quantity == "opening":
        return 1e3 * float(trials.opening[0])
    if case.quantity == "centring":
        beside = position[Snapshot.CLOSED] - trials.tool_position[0, Snapshot.CLOSED]
        return 1e3 * float(beside[0])
    if case.quantity == "shift at rest":
        return 1e3 * float(np.linalg.norm(position[Snapshot.CLOSING] - position[Snapshot.START]))
    turn = rotation_angle(quaternion[[Snapshot.START]], quaternion[[Snapshot.CLOSING]])
    return 1e3 * float(turn[0])


def _scene(obj: ObjectModel, quaternion: Float[Array, "4"], physics: PhysicsConfig) -> Scene:
    """The object on the table in the given orientation."""
    lowest = float((obj.vertices @ quaternion_matrix(quaternion).T)[:, 2].min())
    return Scene(obj, 0, 0, np.array([0.0, 0.0, -lowest]), quaternion, 0.0, physics)


def _box(
    extents: tuple[float, float, float], *, friction: float = 0.8, mass: float = 0.1
) -> ObjectModel:
    return _solid("box", np.asarray(trimesh.creation.box(extents).vertices, float), friction, mass)


_WEDGE_HEIGHT, _WEDGE_HALF = 0.045, 0.0225  # m, and half its width midway up


def _wedge(tilt: float, *, friction: float, mass: float) -> ObjectModel:
    """A prism whose faces across x lean inward by `tilt` rad, so that it is wide at its foot."""
    lean = 0.5 * _WEDGE_HEIGHT * float(np.tan(tilt))
    corners = [
        (side * (_WEDGE_HALF - end * lean), y, end * 0.5 * _WEDGE_HEIGHT)
        for side in (-1, 1)
        for y in (-0.02, 0.02)
        for end in (-1, 1)
    ]
    return _solid("wedge", np.array(corners), friction, mass)


def _solid(name: str, corners: Float[Array, "v 3"], friction: float, mass: float) -> ObjectModel:
    mesh = trimesh.convex.convex_hull(corners)
    vertices = np.asarray(mesh.vertices, float) - mesh.center_mass
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    order = np.argsort(low - high, kind="stable")
    return ObjectModel(
        object_id=name,
        vertices=vertices,
        faces=np.asarray(mesh.faces, np.int64),
        hulls=(vertices,),
        mass=mass,
        friction=friction,
        inertia=np.asarray(mesh.moment_inertia, float) * (mass / float(mesh.volume)),
        scale=1.0,
        box=OrientedBox(0.5 * (low + high), np.eye(3)[:, order], (high - low)[order]),
        stable_poses=StablePoses(_UPRIGHT[None], -low[2:], np.ones(1)),
    )
