"""The phases of a trial, declared as data and compiled to controls and forces a step.

Every engine runs this one schedule: heights and speeds for the gripper, a closing speed for
its fingers, and an external force on the object. It is open loop. What an engine may do is to
stop a trial early: when it has ended (see `outcome`), or when nothing moves any more.
"""

from dataclasses import dataclass, field

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.errors import ConfigError
from gmdx.scenes.physics import PhysicsConfig

TRIALS = 5  # a grasp, unless told otherwise: the nominal one, and the rest with pose noise


@dataclass(frozen=True)
class NoiseConfig:
    """Standard deviations of the pose noise of every trial but the nominal one.

    Draws are cut off at two standard deviations.
    """

    position: float = 0.0025  # m, of the grasp's centre along each horizontal axis
    height: float = 0.0005  # m
    angle: float = 0.05  # rad, of the closing axis

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value >= 0:
                raise ConfigError(f"trial noise: {name} must not be negative, got {value}")


@dataclass(frozen=True)
class TrialConfig:
    """Durations, heights and forces of a trial."""

    clearance: float = 0.005  # m, of the fingertips above the object where the approach starts
    approach_speed: float = 0.5  # m/s, mean
    closing_pause: float = 0.12  # s, after the fingers could have crossed the whole stroke
    lift_height: float = 0.08  # m
    lift_time: float = 0.3  # s
    hold_time: float = 0.6  # s, at most: it ends when nothing moves
    risen: float = 0.5  # of the lift height: success needs the mass centre to have risen this much
    push_direction: tuple[float, float, float] = (0.0, 0.0, -1.0)  # tool frame: out of the gripper
    push_ramp: float = 5.0  # closing forces a second
    push_limit: float = 3.0  # closing forces, where the ramp ends
    push_distance: float = 0.003  # m, moved relative to the gripper: pushed out
    slip_speed: float = 0.01  # m/s, relative to the gripper: slip; slower is creep of soft contacts
    look_interval: float = 0.08  # s, between looks at what has ended; phases end early only there
    still_speed: float = 0.002  # m/s, and
    still_spin: float = 0.05  # rad/s: slower than both counts as not moving
    mad_speed: float = 30.0  # m/s: faster is a diverged simulation
    noise: NoiseConfig = field(default_factory=NoiseConfig)

    def __post_init__(self) -> None:
        may_be_zero = ("still_speed", "still_spin", "push_distance")
        for name, value in vars(self).items():
            number = isinstance(value, int | float)
            if number and not (value > 0 or (value == 0 and name in may_be_zero)):
                raise ConfigError(f"trial: {name} must be positive, got {value}")
        if abs(np.linalg.norm(self.push_direction) - 1.0) > 1e-9:
            raise ConfigError("push_direction must be a unit vector")

    def chunk(self, timestep: float) -> int:
        """Steps of `timestep` s between two looks: about the interval, and at least 2."""
        return max(2, round(self.look_interval / timestep))


@dataclass(frozen=True)
class Phase:
    """One phase compiled to steps: heights at the start of each step, speeds during it.

    Heights are relative to the grasp's.
    """

    name: str
    approach: Float[Array, "s"]  # share of the start's height above the grasp that is left
    approach_rate: Float[Array, "s"]  # its derivative, 1/s
    height: Float[Array, "s"]  # m, above the grasp
    speed: Float[Array, "s"]  # m/s, upward
    closing: Float[Array, "s"]  # m/s, of the opening
    force: Float[Array, "s 3"]  # N, on the object's centre of mass, tool frame
    lead: float  # s^2: reference height gained for each m/s^2, so that the servo does not lag
    timestep: float  # s

    def __len__(self) -> int:
        return len(self.height)

    def controls(
        self,
        grasp_height: Float[Array, "n"],
        start_height: Float[Array, "n"],
        steps: slice = slice(None),
    ) -> Float[Array, "n s 3"]:
        """Tool height (m), its speed (m/s) and closing speed (m/s) of n trials at some steps."""
        drop = (start_height - grasp_height)[:, None]
        first, last, _ = steps.indices(len(self))
        height = grasp_height[:, None] + drop * self.approach[steps] + self.height[steps]
        before = slice(max(first - 1, 0), last)  # the phase starts at rest
        speed = drop * self.approach_rate[before] + self.speed[before]
        rest = np.zeros((len(drop), 0 if first else 1))
        acceleration = np.diff(np.concatenate([rest, speed], axis=1), axis=1) / self.timestep
        height, speed = height + self.lead * acceleration, speed[:, -height.shape[1] :]
        closing = np.broadcast_to(self.closing[steps], height.shape)
        return np.stack([height, speed, closing], axis=-1)


@dataclass(frozen=True)
class Schedule:
    """The phases of a trial, in order."""

    approach: Phase
    close: Phase
    lift: Phase
    hold: Phase
    push: Phase  # nominal trial only


def compile_schedule(
    config: TrialConfig,
    *,
    physics: PhysicsConfig,
    stroke: float,
    closing_force: float,
    descent: float,
) -> Schedule:
    """The phases as arrays.

    Args:
        config: Durations, heights and forces.
        physics: Of the scene: the time step, the speed of closing, the height's servo.
        stroke: m, largest opening of the gripper.
        closing_force: N, of each pad.
        descent: m, from the start of the approach to the table: sets the approach's duration.
    """
    dt = physics.timestep
    closing = 2.0 * physics.closing_speed
    lifted = config.lift_height

    left, left_rate = _minimum_jerk(_steps(descent / config.approach_speed, dt), dt)
    lift, lift_rate = _minimum_jerk(_steps(config.lift_time, dt), dt)
    ramp_steps = _steps(config.push_limit / config.push_ramp, dt)
    ramp = closing_force * config.push_ramp * dt * np.arange(1, ramp_steps + 1)
    close_steps = _steps(stroke / closing + config.closing_pause, dt)
    hold_steps = _steps(config.hold_time, dt)
    return Schedule(
        approach=_phase(
            "approach", len(left), physics, approach=1.0 - left, approach_rate=-left_rate
        ),
        close=_phase("close", close_steps, physics, closing=closing),
        lift=_phase(
            "lift",
            len(lift),
            physics,
            height=lifted * lift,
            speed=lifted * lift_rate,
            closing=closing,
        ),
        hold=_phase("hold", hold_steps, physics, height=lifted, closing=closing),
        push=_phase(
            "push",
            ramp_steps,
            physics,
            height=lifted,
            closing=closing,
            force=ramp[:, None] * np.array(config.push_direction),
        ),
    )


def _steps(duration: float, dt: float) -> int:
    return max(1, round(duration / dt))


def _minimum_jerk(steps: int, dt: float) -> tuple[Float[Array, "s"], Float[Array, "s"]]:
    """A rise from 0 to 1 that starts and ends at rest (Flash and Hogan 1985).

    Returns the height at the start of each step and the speed during it, which is what a
    servo needs to follow a motion exactly under semi-implicit integration.
    """
    s = np.arange(steps + 1) / steps
    rise = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return rise[:-1], np.diff(rise) / dt


def _phase(
    name: str, steps: int, physics: PhysicsConfig, **given: Float[Array, "..."] | float
) -> Phase:
    def line(key: str) -> Float[Array, "s"]:
        return np.broadcast_to(np.asarray(given.get(key, 0.0), float), (steps,))

    return Phase(
        name=name,
        approach=line("approach"),
        approach_rate=line("approach_rate"),
        height=line("height"),
        speed=line("speed"),
        closing=line("closing"),
        force=np.broadcast_to(np.asarray(given.get("force", 0.0), float), (steps, 3)),
        lead=physics.drive_frequency**-2,
        timestep=physics.timestep,
    )
