"""What the outcome rules look at: pure functions of states and contact sensors, for every engine.

`observed_fields` takes NumPy arrays and JAX's alike, so that an engine on an accelerator hands back
a few numbers a step, and not its states.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.geometry import quaternion_matrix
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.layout import HEIGHT_QPOS, HEIGHT_QVEL, SLOT_SIZE, ContactSensors

FACE_COSINE = float(np.cos(np.pi / 4))  # so close to the closing axis is on a pad's face
_RECENT = 5  # steps: contacts may bounce for one or two
_FOUND, _FORCE, _POSITION, _NORMAL = 0, 1, slice(5, 8), slice(8, 11)  # in a pad's slot


@dataclass(frozen=True)
class ObservedSteps:
    """All that the rules look at in each of s steps of n trials."""

    collides: Bool[Array, "n s"]  # not a pad's face touches the object, or the hand the table
    touches: Bool[Array, "n s"]  # any part of the gripper touches the object
    presses: Bool[Array, "n s"]  # a pad's contact with the object carries force
    speed: Float[Array, "n s"]  # m/s, the fastest, the object's spin aside; inf if not finite
    offset: Float[Array, "n s 3"]  # m, of the object from the tool point
    velocity: Float[Array, "n s 3"]  # m/s, of the object
    rise: Float[Array, "n s"]  # m/s, of the tool point

    def __getitem__(self, index: Bool[Array, "n"] | tuple[slice, slice]) -> "ObservedSteps":
        """Some of the trials, or of trials and steps."""
        return ObservedSteps(
            **{item.name: getattr(self, item.name)[index] for item in fields(self)}
        )


@dataclass(frozen=True)
class ChunkResult:
    """Some steps of n trials: where they ended, and what the rules look at on the way there."""

    state: Float[Array, "n d"]  # time, qpos, qvel after each trial's last step
    qpos_at_sensors: Float[Array, "n q"]  # before its last step, where sensors belong
    sensors: Float[Array, "n k"]  # at the start of its last step
    failed: Bool[Array, "n"]  # the engine gave up
    overflowed: Bool[Array, "n"]  # the engine's buffers for contacts or constraints were too small
    steps: ObservedSteps  # only the steps that a trial was to run mean anything


def pad_slots(sensors: Any, layout: ContactSensors) -> tuple[Any, Any]:
    """The contact slots of both pads, (..., slots, SLOT_SIZE), from sensors (..., d)."""
    shape = (*sensors.shape[:-1], layout.slots, SLOT_SIZE)
    return sensors[..., layout.pads[0]].reshape(shape), sensors[..., layout.pads[1]].reshape(shape)


def pads_press(sensors: Any, layout: ContactSensors) -> Any:
    """Whether any contact of each pad with the object carries force, (..., 2)."""
    first, second = pad_slots(sensors, layout)
    xp = sensors.__array_namespace__()
    return xp.stack([slots[..., _FORCE].max(axis=-1) > 0 for slots in (first, second)], axis=-1)


def observe(
    qpos: Float[Array, "n s q"],
    qvel: Float[Array, "n s v"],
    sensors: Float[Array, "n s d"],
    layout: ContactSensors,
) -> ObservedSteps:
    """Steps as the rules see them; states are after each step, sensors at its start."""
    return ObservedSteps(**observed_fields(qpos, qvel, sensors, layout))


def observed_fields(qpos: Any, qvel: Any, sensors: Any, layout: ContactSensors) -> dict[str, Any]:
    """The fields of a `ObservedSteps`, of any leading shape.

    Args:
        qpos: (..., q), after each step, of NumPy or of JAX.
        qvel: (..., v), after each step.
        sensors: (..., d), at the start of each step.
        layout: Where the sensors' numbers lie.
    """
    xp = sensors.__array_namespace__()
    slots = pad_slots(sensors, layout)
    off_face = [
        xp.any((xp.abs(pad[..., _NORMAL.start]) < FACE_COSINE) & (pad[..., _FOUND] > 0), axis=-1)
        for pad in slots
    ]
    by_pads = slots[0][..., 0, _FOUND] + slots[1][..., 0, _FOUND]
    hand = sensors[..., layout.hand]
    linear = xp.concatenate([qvel[..., :3], qvel[..., 6:]], axis=-1)
    finite = xp.isfinite(qpos).all(axis=-1) & xp.isfinite(qvel).all(axis=-1)
    return {
        "collides": (sensors[..., layout.hand_table] > 0)
        | off_face[0]
        | off_face[1]
        | (hand > by_pads),
        "touches": hand > 0,
        "presses": xp.any(pads_press(sensors, layout), axis=-1),
        "speed": xp.where(finite, xp.abs(linear).max(axis=-1), xp.inf),
        "offset": from_tool(qpos),
        "velocity": qvel[..., :3],
        "rise": qvel[..., HEIGHT_QVEL],
    }


def within(count: Int[Array, "n"], steps: int) -> Bool[Array, "n s"]:
    """Which of so many steps a trial was to run."""
    inside: Array = np.arange(steps) < count[:, None]
    return inside


def lets_go(steps: ObservedSteps, count: Int[Array, "n"]) -> Bool[Array, "n"]:
    """Whether no pad pressed on the object in any of the last steps."""
    ran = within(count, steps.presses.shape[1])
    recent = ran & ~within(count - _RECENT, steps.presses.shape[1])
    gone: Array = ~np.any(steps.presses & recent, axis=1)
    return gone


def pad_contacts(
    sensors: Float[Array, "n d"], pose: Float[Array, "n 7"], layout: ContactSensors
) -> PadContacts:
    """The contacts that carry force, in the object's frame.

    Args:
        sensors: At the start of a step.
        pose: Of the object at that same moment.
        layout: Where the sensors' numbers lie.
    """
    to_object = quaternion_matrix(pose[:, None, 3:])
    points, normals, valid = [], [], []
    for slots in pad_slots(sensors, layout):
        pressed = (slots[..., _FOUND] > 0) & (slots[..., _FORCE] > 0)
        local = np.einsum("nki,nkij->nkj", slots[..., _POSITION] - pose[:, None, :3], to_object)
        inward = np.einsum("nki,nkij->nkj", slots[..., _NORMAL], to_object)
        points.append(np.where(pressed[..., None], local, np.nan))
        normals.append(np.where(pressed[..., None], inward, np.nan))
        valid.append(pressed)
    return PadContacts(np.stack(points, 1), np.stack(normals, 1), np.stack(valid, 1))


def still(qvel: Float[Array, "n v"], *, speed: float, spin: float) -> Bool[Array, "n"]:
    """Nothing moves, the gripper's own rise aside.

    Args:
        qvel: At one moment.
        speed: m/s, of the object relative to the gripper and of the fingers: slower is still.
        spin: rad/s, of the object: slower is still.
    """
    last = qvel.copy()
    last[:, 2] -= last[:, HEIGHT_QVEL]
    fastest = np.maximum(
        np.linalg.norm(last[:, :3], axis=1), np.abs(last[:, HEIGHT_QVEL + 1 :]).max(axis=1)
    )
    quiet: Array = (fastest < speed) & (np.linalg.norm(last[:, 3:6], axis=1) < spin)
    return quiet


def from_tool(qpos: Any) -> Any:
    """The object's position relative to the tool point, (..., 3) m, from qpos (..., q)."""
    xp = qpos.__array_namespace__()
    height = qpos[..., HEIGHT_QPOS]
    return xp.stack([qpos[..., 0], qpos[..., 1], qpos[..., 2] - height], axis=-1)


def joined(parts: Sequence[ChunkResult]) -> ChunkResult:
    """Trials one after the other."""

    def both(name: str, records: Sequence[Any]) -> Array:
        return np.concatenate([getattr(record, name) for record in records])

    own = [item.name for item in fields(ChunkResult) if item.name != "steps"]
    steps = [part.steps for part in parts]
    seen = {item.name: both(item.name, steps) for item in fields(ObservedSteps)}
    return ChunkResult(**{name: both(name, parts) for name in own}, steps=ObservedSteps(**seen))
