"""Reading a stretch of simulated steps: pure functions that every MuJoCo-like backend shares."""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float
from gmdx.geometry import quaternion_matrix
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.build import HEIGHT_QPOS, HEIGHT_QVEL, SLOT_SIZE, ContactSensors

_FACE_COSINE = np.cos(np.pi / 4)  # a contact this close to the closing axis is on a pad's face
_RECENT = 5  # steps: contacts may bounce for one or two
_FOUND, _FORCE, _POSITION, _NORMAL = 0, 1, slice(5, 8), slice(8, 11)  # in a pad's slot


@dataclass(frozen=True)
class Frames:
    """States after, and sensors at the start of, each of s steps of n trials."""

    qpos: Float[Array, "n s q"]
    qvel: Float[Array, "n s v"]
    sensors: Float[Array, "n s d"]

    def __getitem__(self, rows: Bool[Array, "n"]) -> "Frames":
        return Frames(self.qpos[rows], self.qvel[rows], self.sensors[rows])


def pad_slots(
    sensors: Float[Array, "*n d"], layout: ContactSensors
) -> tuple[Float[Array, "*n k s"], Float[Array, "*n k s"]]:
    """The contact slots of both pads."""
    shape = (*sensors.shape[:-1], layout.slots, SLOT_SIZE)
    return sensors[..., layout.pads[0]].reshape(shape), sensors[..., layout.pads[1]].reshape(shape)


def collides(frames: Frames, layout: ContactSensors) -> Bool[Array, "n"]:
    """Whether anything but a pad's face touched the object, or the gripper the table."""
    hit = frames.sensors[..., layout.hand_table] > 0
    by_pads = np.zeros(hit.shape)
    for slots in pad_slots(frames.sensors, layout):
        by_pads += slots[..., 0, _FOUND]
        off_face = np.abs(slots[..., _NORMAL.start]) < _FACE_COSINE
        hit |= np.any(off_face & (slots[..., _FOUND] > 0), axis=-1)
    hit |= frames.sensors[..., layout.hand] > by_pads
    collided: Array = np.any(hit, axis=1)
    return collided


def touches(frames: Frames, layout: ContactSensors) -> Bool[Array, "n"]:
    """Whether any part of the gripper touched the object in any of the steps."""
    touched: Array = np.any(frames.sensors[..., layout.hand] > 0, axis=1)
    return touched


def pads_press(sensors: Float[Array, "n d"], layout: ContactSensors) -> Bool[Array, "n 2"]:
    """Whether any contact of each pad with the object carries force."""
    return np.stack(
        [slots[..., _FORCE].max(axis=-1) > 0 for slots in pad_slots(sensors, layout)], axis=-1
    )


def lets_go(frames: Frames, layout: ContactSensors) -> Bool[Array, "n"]:
    """Whether no pad pressed on the object in any of the last steps."""
    count, steps, size = frames.sensors[:, -_RECENT:].shape
    press = pads_press(frames.sensors[:, -_RECENT:].reshape(count * steps, size), layout)
    gone: Array = ~np.any(press.reshape(count, -1), axis=1)
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


def still(frames: Frames, *, speed: float, spin: float) -> Bool[Array, "n"]:
    """Nothing moves at the end of the steps, the gripper's own rise aside.

    Args:
        frames: The steps.
        speed: m/s, of the object relative to the gripper and of the fingers: slower is still.
        spin: rad/s, of the object: slower is still.
    """
    last = frames.qvel[:, -1].copy()
    last[:, 2] -= last[:, HEIGHT_QVEL]
    fastest = np.maximum(
        np.linalg.norm(last[:, :3], axis=1), np.abs(last[:, HEIGHT_QVEL + 1 :]).max(axis=1)
    )
    quiet: Array = (fastest < speed) & (np.linalg.norm(last[:, 3:6], axis=1) < spin)
    return quiet


def sane(frames: Frames, *, fastest: float) -> Bool[Array, "n"]:
    """Every state is finite, and nothing moves faster than `fastest` m/s."""
    finite = np.isfinite(frames.qpos).all(axis=(1, 2)) & np.isfinite(frames.qvel).all(axis=(1, 2))
    linear = np.delete(frames.qvel, [3, 4, 5], axis=2)  # the object's spin aside
    calm = np.abs(np.nan_to_num(linear, nan=np.inf)).max(axis=(1, 2)) < fastest
    well: Array = finite & calm
    return well


def from_tool(qpos: Float[Array, "*n q"]) -> Float[Array, "*n 3"]:
    """The object's position relative to the tool point, m."""
    offset: Array = qpos[..., :3].copy()
    offset[..., 2] -= qpos[..., HEIGHT_QPOS]
    return offset
