"""Contact sensors in the layout of C MuJoCo's `sensordata`, from one world's contacts."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from gmdx.scenes.build import SLOT_SIZE, ContactSensors


class Touches(NamedTuple):
    """Contacts of the gripper with the object."""

    distance: Any  # (c) m, negative: in contact
    position: Any  # (c 3) m
    normal: Any  # (c 3) into the object
    force: Any  # (c 3) N: normal, two tangents
    pads: Any  # (2 c) bool, of each pad


def sensor_data(
    touches: Touches, hand_table: Array, object_table: Array, layout: ContactSensors, *, size: int
) -> Array:
    """All sensors' numbers.

    Args:
        touches: Contacts of the gripper with the object.
        hand_table: How many contacts the gripper has with the table.
        object_table: How many contacts the object has with the table.
        layout: Where the numbers go.
        size: How many there are.
    """
    there = touches.distance < 0
    data = jnp.zeros(size, touches.distance.dtype)
    for side in (0, 1):
        slots = _slots(touches, there & touches.pads[side], layout.slots)
        data = data.at[layout.pads[side]].set(slots.ravel())
    data = data.at[layout.hand].set(jnp.sum(there))
    data = data.at[layout.hand_table].set(hand_table)
    return data.at[layout.object_table].set(object_table)


def _slots(touches: Touches, mine: Array, slots: int) -> Array:
    """Found, force, distance, position and normal (slots 11), strongest first; zeros where none."""
    strength = jnp.where(mine, jnp.sum(touches.force**2, axis=1), -1.0)
    kept = min(slots, strength.shape[0])
    _, order = jax.lax.top_k(strength, kept)
    found = jnp.broadcast_to(jnp.sum(mine).astype(strength.dtype), (kept, 1))
    columns = [found, touches.force, touches.distance[:, None], touches.position, touches.normal]
    rows = jnp.concatenate([columns[0], *(column[order] for column in columns[1:])], axis=1)
    rows = jnp.where(mine[order, None], rows, 0.0)
    return jnp.zeros((slots, SLOT_SIZE), rows.dtype).at[:kept].set(rows)
