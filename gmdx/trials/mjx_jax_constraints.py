"""Constraints of one world: contacts found and made into rows of the solver, coupling, limits."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from gmdx.scenes.build import HEIGHT_QPOS, HEIGHT_QVEL, SLOT_SIZE, ContactSensors
from gmdx.trials.mjx_jax_collide import (
    Boxes,
    hull_table_contacts,
    pair_contacts,
    table_contacts,
)
from gmdx.trials.mjx_jax_manifold import Manifold, dot
from gmdx.trials.mjx_jax_narrow import turn
from gmdx.trials.mjx_jax_rig import DOFS, SLIDES, Body, Rig
from gmdx.trials.mjx_jax_solver import Cones, Rows

_LEAST_IMPEDANCE, _MOST_IMPEDANCE = 1e-4, 0.9999  # mjMINIMP, mjMAXIMP
_TINY = 1e-15  # mjMINVAL
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


@dataclass(frozen=True)
class Shape:
    """What a compiled step is specialised to."""

    pairs: int  # boxes of the gripper and hulls that may be close at once
    contacts: int  # of the gripper with the object
    on_table: int  # contacts of the object with the table
    iterations: int
    line_iterations: int
    places: tuple[int, ...]  # of sensors: both pads, hand, hand on table, object on table
    slots: int  # of a pad
    sensors: int

    @property
    def layout(self) -> ContactSensors:
        """Where the sensors' numbers go; slices themselves cannot be looked up in a cache."""
        first, second, hand, hand_table, object_table = self.places
        length = self.slots * SLOT_SIZE
        pads = slice(first, first + length), slice(second, second + length)
        return ContactSensors(pads, hand, hand_table, object_table, self.slots)


class Moment(NamedTuple):
    """The state of a world, and the guess that the solver starts from."""

    qpos: Any  # (10)
    qvel: Any  # (9)
    guess: Any  # (9) acceleration


def rotation_matrix(quaternion: Array) -> Array:
    """Axes (3 3) as columns, of a quaternion (4) wxyz of any length."""
    w, x, y, z = quaternion / jnp.sqrt(jnp.sum(quaternion**2))
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


class Contacts(NamedTuple):
    """Contacts of the gripper with the object, of the object and of the gripper with the table."""

    touches: Manifold
    box: Array  # of each touch
    of_object: Manifold
    of_gripper: Manifold
    table_box: Array  # of each contact of the gripper with the table
    overflowed: Array


def contacts(rig: Rig, body: Body, number: Array, now: Moment, shape: Shape) -> Contacts:
    """Where the gripper, the object and the table touch; see `step` for the arguments."""
    place, axes = now.qpos[:3], rotation_matrix(now.qpos[3:HEIGHT_QPOS])
    shift = jnp.sum(rig.slide * now.qpos[HEIGHT_QPOS:], axis=2)
    boxes = Boxes(rig.half, rig.origin + shift, rig.rotation)
    found, box, missed = pair_contacts(boxes, body.hulls, number, place, axes, pairs=shape.pairs)
    _, kept = jax.lax.top_k(-found.distance, shape.contacts)
    touches = Manifold(found.distance[kept], found.position[kept], found.normal[kept])
    missed = missed | (jnp.sum(found.distance < 0) > shape.contacts)

    on_table = hull_table_contacts(body.hulls, number, place, axes)
    _, kept_below = jax.lax.top_k(-on_table.distance, min(shape.on_table, len(on_table.distance)))
    of_object = Manifold(*(values[kept_below] for values in on_table))
    missed = missed | (jnp.sum(on_table.distance < 0) > shape.on_table)
    corners = jnp.asarray(_CORNERS, place.dtype) * boxes.half[:, None]
    corners = boxes.position[:, None] + turn(boxes.rotation[:, None], corners)
    of_gripper, corner = table_contacts(corners.reshape(-1, 3))
    return Contacts(touches, box[kept], of_object, of_gripper, corner // len(_CORNERS), missed)


def cones(rig: Rig, body: Body, number: Array, now: Moment, contacts: Contacts) -> Cones:
    """Rows of all contacts, touches first."""
    axes = rotation_matrix(now.qpos[3:HEIGHT_QPOS])
    place = now.qpos[:3]

    def rows(found: Manifold, box: Array | None, *, with_object: bool) -> Array:
        frames = jax.vmap(_frame)(found.normal)  # (c 3 3)
        jacobian = jnp.zeros((*found.distance.shape, 4, DOFS), place.dtype)
        if with_object:
            arm = found.position - place
            turning = jnp.cross(axes.T[None], arm[:, None])  # (c 3 3) velocity by spin
            jacobian = jacobian.at[:, :3, :3].set(frames)
            jacobian = jacobian.at[:, :3, 3:HEIGHT_QVEL].set(
                jnp.sum(frames[:, :, None] * turning[:, None], axis=-1)
            )
            twist = jnp.sum(found.normal[:, :, None] * axes, axis=1)
            jacobian = jacobian.at[:, 3, 3:HEIGHT_QVEL].set(twist)
        if box is not None:
            moves = jnp.sum(frames[..., None] * rig.slide[box][:, None], axis=2)
            sign = -1.0 if with_object else 1.0
            jacobian = jacobian.at[:, :3, HEIGHT_QVEL:].set(sign * moves)
        return jacobian

    def repeated(value: Array, found: Manifold) -> Array:
        return jnp.broadcast_to(value, (*found.distance.shape, *value.shape))

    found = (contacts.touches, contacts.of_object, contacts.of_gripper)
    own = [body.friction[number], body.solref[number], body.solimp[number]]
    by_table = [rig.table_friction, rig.table_solref, rig.table_solimp]
    friction, solref, solimp = (
        jnp.concatenate(
            [repeated(value, found[0]), repeated(value, found[1]), table[contacts.table_box]]
        )
        for value, table in zip(own, by_table, strict=True)
    )
    weight = jnp.concatenate(
        [
            body.weight[number] + rig.weight[contacts.box],
            repeated(body.weight[number], found[1]),
            rig.weight[contacts.table_box],
        ]
    )
    jacobian = jnp.concatenate(
        [
            rows(found[0], contacts.box, with_object=True),
            rows(found[1], None, with_object=True),
            rows(found[2], contacts.table_box, with_object=False),
        ]
    )
    distance = jnp.concatenate([manifold.distance for manifold in found])
    return _cone_rows(rig, jacobian, distance, weight, friction, solref, solimp, now.qvel)


def _cone_rows(
    rig: Rig,
    jacobian: Array,
    distance: Array,
    weight: Array,
    friction: Array,
    solref: Array,
    solimp: Array,
    qvel: Array,
) -> Cones:
    there = distance < 0
    sliding, torsion = friction[:, 0], friction[:, 1]
    stiffness, damping, impedance = _impedance(solref, solimp, distance, rig.timestep)
    twists = torsion > 0
    share = jnp.where(twists, sliding**2 / jnp.where(twists, torsion, 1.0) ** 2, 1.0)
    ones = jnp.ones_like(share)
    weights = weight[:, None] * jnp.stack(
        [ones, ones / rig.impratio, ones / rig.impratio, share / rig.impratio], axis=1
    )
    resistance = jnp.maximum(weights * ((1 - impedance) / impedance)[:, None], _TINY)
    jacobian = jnp.where(there[:, None, None], jacobian, 0.0)
    jacobian = jacobian.at[:, 3].set(jnp.where(twists[:, None], jacobian[:, 3], 0.0))
    target = -damping[:, None] * jnp.sum(jacobian * qvel, axis=-1)
    target = target.at[:, 0].add(-jnp.where(there, stiffness * impedance * distance, 0.0))
    scale = jnp.stack([sliding / jnp.sqrt(rig.impratio), sliding, sliding, torsion], axis=1)
    return Cones(jacobian, jnp.where(there[:, None], 1.0 / resistance, 0.0), target, scale)


def _impedance(
    solref: Array, solimp: Array, position: Array, timestep: Array
) -> tuple[Array, Array, Array]:
    """Stiffness, damping and impedance (MuJoCo's documentation, "Solver parameters")."""
    time = jnp.maximum(solref[:, 0], 2 * timestep)
    least = jnp.clip(solimp[:, 0], _LEAST_IMPEDANCE, _MOST_IMPEDANCE)
    most = jnp.clip(solimp[:, 1], _LEAST_IMPEDANCE, _MOST_IMPEDANCE)
    middle = jnp.clip(solimp[:, 3], _LEAST_IMPEDANCE, _MOST_IMPEDANCE)
    power = jnp.maximum(solimp[:, 4], 1.0)
    x = jnp.minimum(jnp.abs(position) / jnp.maximum(solimp[:, 2], _TINY), 1.0)
    early = x**power / middle ** (power - 1)
    late = 1 - (1 - x) ** power / (1 - middle) ** (power - 1)
    impedance = least + jnp.where(x < middle, early, late) * (most - least)
    stiffness = 1 / (most * time * solref[:, 1]) ** 2
    return stiffness, 2 / (most * time), impedance


def rows(rig: Rig, now: Moment) -> Rows:
    """The coupling of the fingers and the slides' limits."""
    slides = now.qpos[HEIGHT_QPOS:]
    apart = jnp.sum(rig.coupling * slides) - rig.coupling_offset
    below, above = slides - rig.limits[:, 0], rig.limits[:, 1] - slides
    beyond = jnp.minimum(below, above)
    there = jnp.concatenate([jnp.ones(1, bool), beyond < 0])
    position = jnp.concatenate([apart[None], beyond])
    toward = jnp.diag(jnp.where(below < above, 1.0, -1.0).astype(slides.dtype))
    jacobian = jnp.zeros((1 + SLIDES, DOFS), slides.dtype)
    jacobian = jacobian.at[:, HEIGHT_QVEL:].set(jnp.concatenate([rig.coupling[None], toward]))
    jacobian = jnp.where(there[:, None], jacobian, 0.0)
    position = jnp.where(there, position, 0.0)
    solref = jnp.concatenate([rig.coupling_solref[None], rig.limit_solref])
    solimp = jnp.concatenate([rig.coupling_solimp[None], rig.limit_solimp])
    stiffness, damping, impedance = _impedance(solref, solimp, position, rig.timestep)
    weight = jnp.concatenate([rig.coupling_weight[None], rig.limit_weight])
    resistance = jnp.maximum(weight * (1 - impedance) / impedance, _TINY)
    target = -damping * jnp.sum(jacobian * now.qvel, axis=1) - stiffness * impedance * position
    return Rows(
        jacobian,
        jnp.where(there, 1.0 / resistance, 0.0),
        target,
        jnp.arange(1 + SLIDES) == 0,
    )


def _frame(normal: Array) -> Array:
    """Normal and two tangents as rows, as MuJoCo's mju_makeFrame chooses them."""
    guess = jnp.where(jnp.abs(normal[1]) < 0.5, jnp.eye(3)[1], jnp.eye(3)[2]).astype(normal.dtype)
    tangent = guess - normal * dot(normal, guess)
    tangent = tangent / jnp.sqrt(dot(tangent, tangent))
    return jnp.stack([normal, tangent, jnp.cross(normal, tangent)])
