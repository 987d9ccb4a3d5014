"""Warp kernels around MuJoCo Warp's step: what goes into a world, and what is read from it.

`observe` is the twin of `trials.observations.observe`.
"""

# ruff: noqa: UP018, RUF046 (Warp takes a literal for a constant: a variable is declared by a cast)
from typing import no_type_check

import warp as wp

COLLIDES, TOUCHES, PRESSES = 1, 2, 4  # bits of a step's flags
MOTION = 8  # numbers of a step: speed, offset (3), velocity (3), rise


@no_type_check
@wp.kernel(enable_backward=False)
def gather_numbers(
    index: wp.array[int], table: wp.array2d[float], column: int, out: wp.array2d[float]
):
    """Give each world its object's numbers; a world without one has the first object's."""
    world, item = wp.tid()
    out[world, item] = table[wp.max(index[world], 0), column + item]


@no_type_check
@wp.kernel(enable_backward=False)
def gather_meshes(index: wp.array[int], table: wp.array2d[int], out: wp.array2d[int]):
    """Give each world its object's meshes; a world without an object has none."""
    world, geom = wp.tid()
    if index[world] < 0:
        out[world, geom] = -1
    else:
        out[world, geom] = table[index[world], geom]


@no_type_check
@wp.kernel(enable_backward=False)
def start(
    size: int,
    state: wp.array2d[float],
    nq: int,
    nv: int,
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    qacc_warmstart: wp.array2d[float],
    overflow: wp.array[int],
    need: wp.array[int],
):
    """Put worlds where their trials are, as if nothing had been computed before."""
    world = wp.tid()
    if world < 2:
        need[world] = 0
    if world >= size:
        return
    for i in range(nq):
        qpos[world, i] = state[world, i]
    for i in range(nv):
        qvel[world, i] = state[world, nq + i]
        qacc_warmstart[world, i] = 0.0
    overflow[world] = 0


@no_type_check
@wp.kernel(enable_backward=False)
def drive(
    step: int,
    count: wp.array[int],
    control: wp.array3d[float],
    force: wp.array2d[float],
    body: int,
    nq: int,
    qpos: wp.array2d[float],
    ctrl: wp.array2d[float],
    xfrc_applied: wp.array2d[wp.spatial_vector],
    qpos_before: wp.array2d[float],
):
    """Set a step's controls and force; keep the pose that the last step's sensors see."""
    world = wp.tid()
    for i in range(3):
        ctrl[world, i] = control[world, step, i]
    xfrc_applied[world, body] = wp.spatial_vector(
        force[step, 0], force[step, 1], force[step, 2], 0.0, 0.0, 0.0
    )
    if step == count[world] - 1:
        for i in range(nq):
            qpos_before[world, i] = qpos[world, i]


@no_type_check
@wp.kernel(enable_backward=False)
def observe(
    step: int,
    count: wp.array[int],
    nq: int,
    nv: int,
    nsensor: int,
    pad_0: int,
    pad_1: int,
    slots: int,
    slot_size: int,
    hand: int,
    hand_table: int,
    face_cosine: float,
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    sensordata: wp.array2d[float],
    overflow: wp.array[int],
    nacon: wp.array[int],
    ncollision: wp.array[int],
    flags: wp.array2d[int],
    motion: wp.array3d[float],
    last_state: wp.array2d[float],
    last_sensors: wp.array2d[float],
    last_overflow: wp.array[int],
    need: wp.array[int],
):
    """ObservedSteps a step, and keep a trial's last state and sensors."""
    world = wp.tid()
    if world == 0:
        need[0] = wp.max(need[0], nacon[0])
        need[1] = wp.max(need[1], ncollision[0])
    if step >= count[world]:
        return

    by_pads = sensordata[world, pad_0] + sensordata[world, pad_1]
    collides = sensordata[world, hand_table] > 0.0 or sensordata[world, hand] > by_pads
    presses = bool(False)
    for side in range(2):
        first = pad_0
        if side == 1:
            first = pad_1
        for slot in range(slots):
            adr = first + slot * slot_size
            # In a slot: found, force (3), distance, position (3), normal (3).
            if sensordata[world, adr] > 0.0 and wp.abs(sensordata[world, adr + 8]) < face_cosine:
                collides = True
            if sensordata[world, adr + 1] > 0.0:
                presses = True
    bits = int(0)
    if collides:
        bits = bits | 1
    if sensordata[world, hand] > 0.0:
        bits = bits | 2
    if presses:
        bits = bits | 4
    flags[world, step] = bits

    speed = float(0.0)
    finite = bool(True)
    for i in range(nq):
        finite = finite and wp.isfinite(qpos[world, i])
    for i in range(nv):
        finite = finite and wp.isfinite(qvel[world, i])
        if i < 3 or i >= 6:
            speed = wp.max(speed, wp.abs(qvel[world, i]))
    if not finite:
        speed = wp.inf
    motion[world, step, 0] = speed
    motion[world, step, 1] = qpos[world, 0]
    motion[world, step, 2] = qpos[world, 1]
    motion[world, step, 3] = qpos[world, 2] - qpos[world, 7]
    for i in range(3):
        motion[world, step, 4 + i] = qvel[world, i]
    motion[world, step, 7] = qvel[world, 6]

    if step == count[world] - 1:
        for i in range(nq):
            last_state[world, i] = qpos[world, i]
        for i in range(nv):
            last_state[world, nq + i] = qvel[world, i]
        for i in range(nsensor):
            last_sensors[world, i] = sensordata[world, i]
        last_overflow[world] = overflow[world]
