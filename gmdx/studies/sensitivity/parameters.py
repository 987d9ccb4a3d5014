"""What a sensitivity study varies: each parameter with its range, the reason, and what it changes.

Scenes and grasps are settled and sampled once, at the defaults; a parameter changes only what
the trials of those grasps see. `seed` changes nothing that matters: its effect is the noise floor.
"""

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.objects.decompose import DecomposeConfig
from gmdx.objects.model import ObjectModel
from gmdx.rng import generator
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene
from gmdx.scenes.settle import lowest_points
from gmdx.trials.protocol import NoiseConfig, TrialConfig

Hulls = tuple[Float[Array, "_ 3"], ...]  # m, vertices of each
Change = Callable[["Setup", float], "Setup"]

JITTER = 1e-5  # m, and JITTER / 0.01 rad: of the grasps under another seed, below any robot's
_HULL_BOUND = DecomposeConfig().fidelity.distance
HULL_BOUNDS = (0.5 * _HULL_BOUND, _HULL_BOUND, 2.0 * _HULL_BOUND)  # m, fine, default and coarse
_SEEDS = 2**20  # how many there are to draw from
_NOISE = NoiseConfig()


@dataclass(frozen=True)
class Setup:
    """Everything that the trials of one object's grasps depend on."""

    scene: Scene
    grasps: PlanarGrasp
    gripper: Gripper
    trials: int  # of each grasp
    config: TrialConfig
    hulls: Mapping[float, Hulls]  # by the bound that they keep to; others than the scene's
    hull_bound: float = _HULL_BOUND  # m, that the scene's object keeps to


@dataclass(frozen=True)
class Parameter:
    """One parameter of a study. `units` in [0, 1] are stretched over its range."""

    name: str
    unit: str  # "" for a pure number
    low: float
    high: float
    scale: str  # linear, log, levels (the values of `levels` in turn) or integers
    reason: str  # why this range
    default: Callable[[Setup], float]  # the value in a setup that nothing has changed
    change: Change  # the same setup with another value
    levels: tuple[float, ...] = ()

    def values(self, units: Float[Array, "n"]) -> Float[Array, "n"]:
        """Values at places in [0, 1] of the range."""
        found: Array
        if self.scale == "log":
            found = self.low * (self.high / self.low) ** units
        elif self.scale == "linear":
            found = self.low + (self.high - self.low) * units
        elif self.scale == "levels":
            count = len(self.levels)
            found = np.asarray(self.levels)[np.minimum((units * count).astype(int), count - 1)]
        else:
            found = np.floor(self.low + (self.high - self.low) * units)
        return found

    def record(self) -> dict[str, Any]:
        """Everything about it that runs depend on, as JSON."""
        return {
            "name": self.name,
            "unit": self.unit,
            "low": self.low,
            "high": self.high,
            "scale": self.scale,
            "levels": list(self.levels),
        }


def parameters_named(names: Sequence[str]) -> tuple[Parameter, ...]:
    """Parameters by name, in the table's order, with `seed` as the noise floor at the end.

    Raises:
        UsageError: A name is unknown, or given twice.
    """
    for name in names:
        if name not in PARAMETERS:
            close = difflib.get_close_matches(name, PARAMETERS, n=1)
            hint = f" (did you mean '{close[0]}'?)" if close else ""
            raise UsageError(f"unknown parameter '{name}'{hint}: there are {', '.join(PARAMETERS)}")
    if len(set(names)) < len(names) or not set(names) - {SEED}:
        raise UsageError("give each parameter once, and one besides 'seed' at least")
    return tuple(PARAMETERS[name] for name in PARAMETERS if name in names or name == SEED)


def decomposition_for(bound: float) -> DecomposeConfig:
    """How hulls are made that keep to another bound: all bounds and attempts scale with it."""
    config = DecomposeConfig()
    factor = bound / config.fidelity.distance
    fidelity = replace(config.fidelity, distance=bound, volume=config.fidelity.volume * factor)
    attempts = tuple(replace(a, threshold=a.threshold * factor) for a in config.attempts)
    return replace(config, fidelity=fidelity, attempts=attempts)


def _object(change: Callable[[ObjectModel, float], ObjectModel]) -> Change:
    def changed(setup: Setup, value: float) -> Setup:
        scene = setup.scene
        return replace(setup, scene=replace(scene, object=change(scene.object, value)))

    return changed


def _trial(change: Callable[[TrialConfig, float], TrialConfig]) -> Change:
    return lambda setup, value: replace(setup, config=change(setup.config, value))


def _physics(change: Callable[[float], dict[str, Any]]) -> Change:
    def changed(setup: Setup, value: float) -> Setup:
        physics = replace(setup.scene.physics, **change(value))
        return replace(setup, scene=replace(setup.scene, physics=physics))

    return changed


def _noise(change: Callable[[float], dict[str, float]]) -> Change:
    return _trial(lambda c, value: replace(c, noise=replace(c.noise, **change(value))))


def _weigh(obj: ObjectModel, mass: float) -> ObjectModel:
    """Another density: the inertia goes with the mass."""
    return replace(obj, mass=mass, inertia=obj.inertia * (mass / obj.mass))


def _raise(setup: Setup, height: float) -> Setup:
    """All grasps moved up by `height` m."""
    center = setup.grasps.center + np.array([0.0, 0.0, height])
    return replace(setup, grasps=replace(setup.grasps, center=center))


def _rehull(setup: Setup, bound: float) -> Setup:
    """Other hulls. The object is put back to where its lowest hull was: no gap, no depth."""
    if bound == setup.hull_bound:
        return setup
    scene = setup.scene
    changed = replace(scene, object=replace(scene.object, hulls=setup.hulls[bound]))
    sunk = lowest_points(scene).hulls - lowest_points(changed).hulls
    position = scene.position + np.array([0.0, 0.0, sunk])
    return replace(setup, scene=replace(changed, position=position), hull_bound=bound)


def _reseed(setup: Setup, seed: float) -> Setup:
    """Another pose noise, and grasps moved by much less than any robot repeats them.

    The nominal trial has no pose noise, so without the jitter its results would not show what
    of them is chance.
    """
    scene = replace(setup.scene, seed=int(seed))
    rng = generator(int(seed), scene.object.object_id, "scene", scene.scene_id, "jitter")
    draws = np.clip(rng.standard_normal((len(setup.grasps), 4)), -2.0, 2.0) * JITTER
    grasps = replace(
        setup.grasps,
        center=setup.grasps.center + draws[:, :3],
        angle=setup.grasps.angle + draws[:, 3] / 0.01,
    )
    return replace(setup, scene=scene, grasps=grasps)


SEED = "seed"
_TABLE = (
    Parameter(
        "friction", "", 0.4, 1.0, "linear",
        "rubber pads on household surfaces: about 0.4 on wet or dusty plastic, 1 on clean glass",
        lambda s: s.scene.object.friction,
        _object(lambda obj, v: replace(obj, friction=v)),
    ),
    Parameter(
        "mass", "kg", 0.03, 0.5, "log",
        "things that fit between the fingers, from an empty cup to a full small bottle",
        lambda s: s.scene.object.mass,
        _object(_weigh),
    ),
    Parameter(
        "closing_force", "N", 10.0, 40.0, "log",
        "half to twice the default gripper's: what users commonly set on grippers that allow more",
        lambda s: s.gripper.force,
        lambda s, v: replace(s, gripper=replace(s.gripper, force=v)),
    ),
    Parameter(
        "pose_noise", "m", 0.0, 0.005, "linear",
        "standard deviation in the plane, from none to twice the default, as from a poorly "
        "calibrated camera; the height's goes along in proportion",
        lambda s: s.config.noise.position,
        _noise(lambda v: {"position": v, "height": v * _NOISE.height / _NOISE.position}),
    ),
    Parameter(
        "angle_noise", "rad", 0.0, 0.1, "linear",
        "standard deviation of the closing axis, from none to twice the default",
        lambda s: s.config.noise.angle,
        _noise(lambda v: {"angle": v}),
    ),
    Parameter(
        "grasp_height", "m", -0.001, 0.003, "linear",
        "all grasps lower or higher, as by an error of the table's height; lower ones than the "
        "least clearance would hit the table",
        lambda s: 0.0,
        _raise,
    ),
    Parameter(
        "closing_speed", "m/s", 0.05, 0.25, "log",
        "of each finger: slow electric grippers to fast ones",
        lambda s: s.scene.physics.closing_speed,
        _physics(lambda v: {"closing_speed": v}),
    ),
    Parameter(
        "lift_time", "s", 0.15, 0.6, "log",
        "half to twice the default: peak accelerations of about 20 to 1.3 m/s^2",
        lambda s: s.config.lift_time,
        _trial(lambda c, v: replace(c, lift_time=v)),
    ),
    Parameter(
        "timestep", "s", 0.001, 0.005, "log",
        "numerical: a quarter of the default up to half of the contacts' time constant, beyond "
        "which MuJoCo softens them by itself",
        lambda s: s.scene.physics.timestep,
        _physics(lambda v: {"timestep": v}),
    ),
    Parameter(
        "impratio", "", 1.0, 100.0, "log",
        "numerical: from MuJoCo's default, at which grips creep, to where they hardly do",
        lambda s: s.scene.physics.impratio,
        _physics(lambda v: {"impratio": v}),
    ),
    Parameter(
        "solref", "s", 0.008, 0.02, "log",
        "numerical: time constant of contacts, from two default steps, the least that is stable "
        "(with longer steps MuJoCo raises it), to MuJoCo's default",
        lambda s: s.scene.physics.solref[0],
        _physics(lambda v: {"solref": (v, 1.0)}),
    ),
    Parameter(
        "solimp", "", 0.003, 0.1, "log",
        "numerical: softness 1 - d of contacts at no depth (a tenth of it when deep), from the "
        "hardest that the default step resolves (at 0.001 trials diverge) to MuJoCo's default",
        lambda s: round(1.0 - s.scene.physics.solimp[0], 12),
        _physics(lambda v: {"solimp": (1.0 - v, 1.0 - v / 10.0, 0.001)}),
    ),
    Parameter(
        "patch_radius", "m", 0.001, 0.01, "log",
        "radius of a contact's patch: hard pads touch almost in a point, soft ones with half "
        "their width",
        lambda s: s.scene.physics.patch_radius,
        _physics(lambda v: {"patch_radius": v}),
    ),
    Parameter(
        "hulls", "m", HULL_BOUNDS[0], HULL_BOUNDS[-1], "levels",
        "numerical: bound on the hulls' distance from the surface, half, once and twice the "
        "default: what one chooses between fidelity and speed",
        lambda s: s.hull_bound,
        _rehull,
        levels=HULL_BOUNDS,
    ),
    Parameter(
        SEED, "", 0.0, float(_SEEDS), "integers",
        "the noise floor: other draws of the pose noise, and grasps moved by 10 micrometres and "
        "1 mrad",
        lambda s: float(s.scene.seed),
        _reseed,
    ),
)  # fmt: skip
PARAMETERS = {parameter.name: parameter for parameter in _TABLE}
