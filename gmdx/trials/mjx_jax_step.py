"""One step of one world: MuJoCo's forward dynamics and its implicitfast integrator.

State: the object's position and quaternion, the height, and two fingers; see `GraspModel`.
Sums over products are written out instead of matrix products, which accelerators compute in
reduced precision and whose order of sums may depend on the batch.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from gmdx.scenes.build import HEIGHT_QPOS, HEIGHT_QVEL
from gmdx.trials.mjx_jax_constraints import Contacts, Moment, Shape, cones, contacts, rows
from gmdx.trials.mjx_jax_narrow import turn
from gmdx.trials.mjx_jax_rig import DOFS, Body, Rig
from gmdx.trials.mjx_jax_sensors import Touches, sensor_data
from gmdx.trials.mjx_jax_solver import Solution, solve, solve_positive


class Seen(NamedTuple):
    """What was read at the start of a step."""

    sensors: Any  # (d)
    overflowed: Any  # bool
    iterations: Any


def step(
    rig: Rig, body: Body, number: Array, now: Moment, control: Array, push: Array, shape: Shape
) -> tuple[Moment, Seen]:
    """Read the sensors and go one step on.

    Args:
        rig: The gripper.
        body: Several objects.
        number: Which of them is in this world.
        now: The state.
        control: (3) of the actuators.
        push: (3) N, on the object's mass centre.
        shape: Bounds.
    """
    inertia, free, force, slope = _smooth(rig, body, number, now, control, push)
    found = contacts(rig, body, number, now, shape)
    solution = solve(
        inertia,
        free,
        rows(rig, now),
        cones(rig, body, number, now, found),
        now.guess,
        scale=body.scale[number],
        tolerance=rig.tolerance,
        iterations=shape.iterations,
        line_iterations=shape.line_iterations,
    )
    seen = _seen(rig, found, solution, shape)

    acceleration = solve_positive(inertia - rig.timestep * slope, force + solution.force)
    qvel = now.qvel + rig.timestep * acceleration
    place = now.qpos[:3] + rig.timestep * qvel[:3]
    turned = _spun(now.qpos[3:HEIGHT_QPOS], qvel[3:HEIGHT_QVEL], rig.timestep)
    slides = now.qpos[HEIGHT_QPOS:] + rig.timestep * qvel[HEIGHT_QVEL:]
    after = Moment(jnp.concatenate([place, turned, slides]), qvel, solution.acceleration)
    return after, seen


def _spun(quaternion: Array, spin: Array, duration: Array) -> Array:
    """A quaternion after turning with `spin` rad/s in its own frame."""
    speed = jnp.sqrt(jnp.sum(spin**2))
    half = 0.5 * duration * speed
    axis = spin / jnp.where(speed > 0, speed, 1.0)
    w, v = jnp.cos(half), jnp.sin(half) * axis
    q = quaternion / jnp.sqrt(jnp.sum(quaternion**2))
    real = q[0] * w - jnp.sum(q[1:] * v)
    imaginary = q[0] * v + w * q[1:] + jnp.cross(q[1:], v)
    turned = jnp.concatenate([real[None], imaginary])
    return turned / jnp.sqrt(jnp.sum(turned**2))


def _smooth(
    rig: Rig, body: Body, number: Array, now: Moment, control: Array, push: Array
) -> tuple[Array, Array, Array, Array]:
    """Inertia, acceleration without constraints, its force, and the force's slope by speed."""
    mass, moment_of_inertia = body.mass[number], body.inertia[number]
    slides, speeds = now.qpos[HEIGHT_QPOS:], now.qvel[HEIGHT_QVEL:]
    spin = now.qvel[3:HEIGHT_QVEL]

    length = jnp.sum(rig.moment * slides, axis=1)
    rate = jnp.sum(rig.moment * speeds, axis=1)
    drive = rig.gain * control + rig.bias[:, 0] + rig.bias[:, 1] * length + rig.bias[:, 2] * rate
    low, high = rig.force_range[:, 0], rig.force_range[:, 1]
    clamped = (drive <= low) | (drive >= high)
    on_joints = jnp.sum(rig.moment * jnp.clip(drive, low, high)[:, None], axis=0)
    on_joints = jnp.clip(on_joints, rig.joint_range[:, 0], rig.joint_range[:, 1])
    passive = -rig.damping * speeds - rig.stiffness * (slides - rig.rest)
    force = jnp.concatenate(
        [mass * rig.gravity + push, -jnp.cross(spin, turn(moment_of_inertia, spin)), on_joints]
    )
    force = force.at[HEIGHT_QVEL:].add(passive)

    damping = jnp.where(clamped, 0.0, rig.bias[:, 2])  # a force at its limit does not vary
    slope = jnp.sum(rig.moment[:, :, None] * damping[:, None, None] * rig.moment[:, None], axis=0)
    # C keeps what has a place in the inertia matrix: nothing between the two fingers.
    slope = jnp.where(rig.related, slope, 0.0) - jnp.diag(rig.damping)
    inertia = jnp.zeros((DOFS, DOFS), force.dtype)
    inertia = inertia.at[:3, :3].set(mass * jnp.eye(3, dtype=force.dtype))
    inertia = inertia.at[3:HEIGHT_QVEL, 3:HEIGHT_QVEL].set(moment_of_inertia)
    inertia = inertia.at[HEIGHT_QVEL:, HEIGHT_QVEL:].set(rig.inertia)
    all_slopes = jnp.zeros_like(inertia).at[HEIGHT_QVEL:, HEIGHT_QVEL:].set(slope)
    return inertia, solve_positive(inertia, force), force, all_slopes


def _seen(rig: Rig, found: Contacts, solution: Solution, shape: Shape) -> Seen:
    touches = found.touches
    count = touches.distance.shape[0]
    sensors = sensor_data(
        Touches(
            touches.distance,
            touches.position,
            touches.normal,
            solution.contact_force[:count, :3],
            rig.is_pad[:, found.box],
        ),
        jnp.sum(found.of_gripper.distance < 0),
        jnp.sum(found.of_object.distance < 0),
        shape.layout,
        size=shape.sensors,
    )
    return Seen(sensors, found.overflowed, solution.iterations)
