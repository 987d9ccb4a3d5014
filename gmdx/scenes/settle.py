"""An object falls onto the table from a random orientation and comes to rest."""

from copy import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import ConfigError, SceneError
from gmdx.geometry import quaternion_matrix, random_quaternion
from gmdx.objects.model import ObjectModel
from gmdx.rng import generator
from gmdx.scenes.build import scene_model
from gmdx.scenes.physics import GRAVITY, PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.scenes.warnings import quiet_warnings

_LOOK = 10  # steps between two looks at whether the object is calm, or lost


@dataclass(frozen=True)
class SettleConfig:
    """How an object falls, and when it counts as settled.

    The fall dissipates quickly, so that the faces an object comes to rest on are as frequent
    as quasi-static analysis says: it falls from little height, contacts take its speed away
    within about a step (they are as stiff as in the trials, and heavily overdamped: nothing
    bounces), and its rotation is damped. That damping also stops what rolls; rolling friction
    would do so too, but can hold an object where the trials would let it topple. What has
    come to rest must then stay at rest under the physics of the trials, without damping.
    """

    drop_height: float = 0.01  # m, of the lowest point above the table at the start
    timestep: float = 0.001  # s, the longest step of the fall
    depth: float = 2e-6  # m, which no step sinks the object deeper than the step before it
    rotation_damping: float = 2.0  # rate at which spin decays in the air / sqrt(gravity / radius)
    linear_speed: float = 0.002  # m/s, the most a calm object's centre of mass has
    angular_speed: float = 0.02  # rad/s, the most a calm object has
    calm_time: float = 0.1  # s, for which both speeds stay that low
    rest_time: float = 0.5  # s, under the trials' physics, within which no point moves by
    rest_motion: float = 1e-4  # m
    max_time: float = 10.0  # s of simulation, after which the object counts as never settling
    table_radius: float = 0.5  # m, from under the start to the table's edge
    max_speed: float = 20.0  # m/s, beyond which the simulation has diverged

    def __post_init__(self) -> None:
        may_be_zero = ("drop_height", "rotation_damping")
        for name, value in vars(self).items():
            if not (value > 0 or (value == 0 and name in may_be_zero)):
                raise ConfigError(f"settling: {name} must be positive, got {value}")


@dataclass(frozen=True)
class LowestPoints:
    """How deep a resting object reaches: what its hulls add to its surface, or leave out."""

    hulls: float  # m, height of the hulls' lowest vertex, on which physics rests
    surface: float  # m, height of the surface's lowest vertex, which is seen and grasped


def lowest_points(scene: Scene) -> LowestPoints:
    """Heights of the lowest points of the hulls and of the surface above the table."""
    down = scene.rotation[2]
    return LowestPoints(
        hulls=min(float((hull @ down).min()) for hull in scene.object.hulls) + scene.position[2],
        surface=float((scene.object.vertices @ down).min()) + scene.position[2],
    )


def settle(
    obj: ObjectModel,
    seed: int = 0,
    *,
    scene_id: int = 0,
    physics: PhysicsConfig | None = None,
    config: SettleConfig | None = None,
) -> Scene:
    """Drop the object onto the table and wait until it rests.

    Args:
        obj: The object.
        seed: The run's seed; with the object's id and `scene_id` it fixes the orientation.
        scene_id: Which of the object's scenes.
        physics: Under which the object is to rest, and which the scene carries to its trials and
            metrics; the default one if not given.
        config: How it falls and when it counts as settled.

    Returns:
        The scene, moved (not turned) so that the centre of mass is above the world's origin.

    Raises:
        SceneError: The object never settled, left the table or diverged; the message says which.
    """
    config = SettleConfig() if config is None else config
    physics = PhysicsConfig() if physics is None else physics
    rng = generator(seed, obj.object_id, "scene", scene_id, "orientation")
    where = f"object {obj.object_id!r}, scene {scene_id}"
    try:
        model = scene_model(obj, physics)
    except ValueError as error:
        raise SceneError(f"{where}: MuJoCo cannot simulate the object: {error}") from error
    fall = Fall(obj, random_quaternion(rng), model=model, physics=physics, config=config)
    with quiet_warnings():
        rest = _come_to_rest(fall, model, config, where)
    return Scene(
        object=obj,
        scene_id=scene_id,
        seed=seed,
        position=np.array([0.0, 0.0, rest.qpos[2]]),
        quaternion=rest.qpos[3:] / np.linalg.norm(rest.qpos[3:]),
        settle_time=float(rest.time),
        physics=physics,
    )


def _come_to_rest(
    fall: "Fall", model: mujoco.MjModel, config: SettleConfig, where: str
) -> mujoco.MjData:
    """The state in which the object stays put under the physics of the trials."""
    while True:
        calm_since = fall.data.time
        while fall.data.time - calm_since < config.calm_time:
            for _ in range(_LOOK):
                fall.step()
            _check(fall.data, fall.steps, config, where)
            if not fall.calm:
                calm_since = fall.data.time

        rest = mujoco.MjData(model)
        rest.time = fall.data.time
        rest.qpos[:] = fall.data.qpos
        for _ in range(int(np.ceil(config.rest_time / model.opt.timestep / _LOOK))):
            mujoco.mj_step(model, rest, _LOOK)
            _check(rest, fall.steps, config, where)
        if _motion(fall.data.qpos, rest.qpos, fall.radius) <= config.rest_motion:
            return rest
        # It was only balanced: let it fall on from where it has got to.
        fall.data.qpos[:], fall.data.qvel[:], fall.data.time = rest.qpos, rest.qvel, rest.time


class Fall:
    """The dissipative fall of an object onto the table, step by step.

    Steps are as long as configured while nothing happens. One that would sink the object into
    the table is taken again, shorter, so that it ends where the object touches: contacts then
    have no depth to push the object out of, which would give it energy.
    """

    def __init__(
        self,
        obj: ObjectModel,
        quaternion: Float[Array, "4"],
        *,
        model: mujoco.MjModel,
        physics: PhysicsConfig,
        config: SettleConfig,
    ) -> None:
        self.model: mujoco.MjModel = copy(model)
        self.data: mujoco.MjData = mujoco.MjData(self.model)
        self.radius = obj.radius
        self._physics, self._config = physics, config
        self._vertices = np.concatenate(obj.hulls)
        self.steps = 0
        self._rotation = np.zeros(9)
        self._timestep = config.timestep
        self.data.qpos[:3] = 0.0
        self.data.qpos[3:] = quaternion
        self.data.qpos[2] = config.drop_height + self._depth()
        # Rolling turns an object about its axis of least inertia, so that one sets the scale.
        rate = config.rotation_damping * np.sqrt(GRAVITY / obj.radius)
        self.model.dof_damping[3:6] = rate * np.linalg.eigvalsh(obj.inertia)[0]

    @property
    def calm(self) -> bool:
        """Whether both speeds are low."""
        slow = np.linalg.norm(self.data.qvel[:3]) < self._config.linear_speed
        return bool(slow and np.linalg.norm(self.data.qvel[3:]) < self._config.angular_speed)

    def step(self) -> None:
        """One step, of the configured length or shorter."""
        data, config = self.data, self._config
        qpos, qvel, warmstart = data.qpos.copy(), data.qvel.copy(), data.qacc_warmstart.copy()
        time, start = data.time, self._depth()
        allowed = max(start, 0.0) + config.depth
        while True:
            self._use(self._timestep)
            mujoco.mj_step(self.model, data)
            self.steps += 1
            depth = self._depth()
            if not depth > allowed or self._timestep < config.timestep / 500:
                break
            # Aim for half of what is allowed, as if the descent were steady.
            share = (allowed - 0.5 * config.depth - start) / (depth - start)
            self._timestep *= min(max(share, 0.02), 0.5)
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = qpos, qvel, warmstart
            data.time = time
        self._timestep = min(2 * self._timestep, config.timestep)

    def _use(self, timestep: float) -> None:
        """Set the time step, and contacts that take a speed away in about a step.

        Two steps is the shortest time constant that is stable; the damping ratio keeps the
        stiffness that contacts have in the trials, 1 / (time constant * ratio)^2.
        """
        time_constant, ratio = self._physics.solref
        self.model.opt.timestep = timestep
        self.model.geom_solref[:] = 2 * timestep, max(1.0, time_constant * ratio / (2 * timestep))

    def _depth(self) -> float:
        """Of the lowest point under the table, m."""
        mujoco.mju_quat2Mat(self._rotation, self.data.qpos[3:])
        return float(-(self._vertices @ self._rotation[6:]).min() - self.data.qpos[2])


def _check(data: mujoco.MjData, steps: int, config: SettleConfig, where: str) -> None:
    """Raise if the simulation cannot end in a scene any more."""
    speed = np.linalg.norm(data.qvel[:3])
    spin = np.linalg.norm(data.qvel[3:])
    warnings = [
        mujoco.mjtWarning(kind).name for kind, count in enumerate(data.warning.number) if count > 0
    ]
    if warnings or not (np.isfinite(data.qpos).all() and speed <= config.max_speed):
        raise SceneError(
            f"{where}: the simulation diverged after {data.time:.3f} s, at {speed:.3g} m/s and "
            f"{spin:.3g} rad/s {warnings}: check the object's inertia and hulls, or lower "
            "SettleConfig.timestep"
        )
    if np.hypot(*data.qpos[:2]) > config.table_radius or data.qpos[2] < 0:
        raise SceneError(
            f"{where}: the object left the table after {data.time:.3f} s, at "
            f"{np.round(data.qpos[:3], 3)} m: raise SettleConfig.table_radius or rotation_damping"
        )
    # Shortened steps could otherwise go on for as long as they are short.
    if data.time > config.max_time or steps > 5 * config.max_time / config.timestep:
        raise SceneError(
            f"{where}: the object never settled within {data.time:.3g} s and {steps} steps, "
            f"and still moves at {speed:.2g} m/s and {spin:.2g} rad/s: raise "
            "SettleConfig.max_time or rotation_damping"
        )


def _motion(before: Float[Array, "7"], after: Float[Array, "7"], radius: float) -> float:
    """The most that a point of an object of the given radius has moved between two poses, m."""
    turn = quaternion_matrix(before[3:]).T @ quaternion_matrix(after[3:])
    # |R - 1|_F = 2 sqrt(2) sin(angle / 2), and 2 sin(angle / 2) is the chord at radius 1.
    chord = np.linalg.norm(turn - np.eye(3)) / np.sqrt(2)
    return float(np.linalg.norm(after[:3] - before[:3]) + radius * chord)
