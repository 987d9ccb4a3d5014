"""How the compiled model of a gripper, an object and a table lies in memory."""

from dataclasses import dataclass

import mujoco

from gmdx.scenes.gripper import Gripper

OBJECT, TABLE, MOUNT = "object", "table", "mount"
PREFIX = "gripper/"

OBJECT_QPOS = slice(0, 7)
HEIGHT_QPOS, HEIGHT_QVEL = 7, 6

PAD_SLOTS = 12  # contacts kept for each pad
SLOT_SIZE = 11  # numbers in a pad's slot


@dataclass(frozen=True)
class GraspModel:
    """A compiled gripper, object and table, in the gripper's frame.

    The state's qpos is the object's position (3) and quaternion (4), the height of the tool
    point, and the two fingers; `ctrl` is the tool height (m), its speed (m/s), and the speed
    at which the opening closes (m/s).
    """

    model: mujoco.MjModel
    gripper: Gripper
    finger_qpos: tuple[int, int]  # addresses of finger 0 and 1 in qpos
    object_body: int
    sensors: "ContactSensors"


@dataclass(frozen=True)
class ContactSensors:
    """Where each contact sensor's numbers lie in `sensordata`.

    Pads report slots of (found, force (3), distance, position (3), normal (3)), strongest
    first, `found` being the number of all contacts of that pair; the others report `found`.
    """

    pads: tuple[slice, slice]  # each pad with the object; normals point into the object
    hand: int  # any part of the gripper with the object, pads included
    hand_table: int  # any part of the gripper with the table
    object_table: int
    slots: int = PAD_SLOTS
