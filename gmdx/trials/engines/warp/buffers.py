"""Arrays that go to a device and come back, and how much memory trials take there."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import mujoco
import mujoco.mjx.third_party.mujoco_warp as mjw
import numpy as np
import warp as wp
from mujoco.mjx.third_party.mujoco_warp._src import types

from gmdx.arrays import Array, Float
from gmdx.trials.engines.warp import kernels
from gmdx.trials.observations import ChunkResult, ObservedSteps

# What makes a trial overflow; a solver that stops at its last iteration is no such thing.
_FAILURES = (
    types.OverflowType.NEFC | types.OverflowType.NJMAX_NNZ | types.OverflowType.CONTACT_MATCH
)


@dataclass(frozen=True)
class ChunkArrays:
    """What goes to the device for a chunk of s steps of n worlds, and what comes back."""

    index: Any  # (n) int, -1 for none
    state: Any  # (n, q + v)
    control: Any  # (n, s, 3)
    force: Any  # (s, 3)
    count: Any  # (n) int
    flags: Any  # (n, s) int, of `ObservedSteps`
    motion: Any  # (n, s, MOTION), of `ObservedSteps`
    last_state: Any  # (n, q + v)
    qpos_before: Any  # (n, q)
    last_sensors: Any  # (n, d)
    last_overflow: Any  # (n) int, OverflowType
    need: Any  # (2) int: most contacts and most pairs of geoms in any step

    INPUTS = ("index", "state", "control", "force", "count")

    @property
    def outputs(self) -> list[str]:
        """Names of what comes back."""
        return [f.name for f in dataclasses.fields(self) if f.name not in self.INPUTS]


def chunk_arrays(
    shared: mujoco.MjModel, size: int, steps: int, device: Any, *, pinned: bool
) -> ChunkArrays:
    """Arrays for `steps` steps of `size` worlds, all zero."""
    shapes = {
        "index": (size,),
        "state": (size, shared.nq + shared.nv),
        "control": (size, steps, 3),
        "force": (steps, 3),
        "count": (size,),
        "flags": (size, steps),
        "motion": (size, steps, kernels.MOTION),
        "last_state": (size, shared.nq + shared.nv),
        "qpos_before": (size, shared.nq),
        "last_sensors": (size, shared.nsensordata),
        "last_overflow": (size,),
        "need": (2,),
    }
    whole = ("index", "count", "flags", "last_overflow", "need")
    return ChunkArrays(
        **{
            name: wp.zeros(
                shape, dtype=int if name in whole else float, device=device, pinned=pinned
            )
            for name, shape in shapes.items()
        }
    )


def chunk_result(host: ChunkArrays, n: int, nq: int, time: Float[Array, "n"]) -> ChunkResult:
    """What came back of the first n worlds, copied."""

    def own(name: str) -> Array:
        values: Array = getattr(host, name).numpy()[:n]
        return values.copy() if values.dtype.kind == "i" else values.astype(float)

    flags, motion = own("flags"), own("motion")
    return ChunkResult(
        state=np.concatenate([time[:, None], own("last_state")], axis=1),
        qpos_at_sensors=own("qpos_before"),
        sensors=own("last_sensors"),
        failed=np.zeros(n, bool),
        overflowed=(own("last_overflow") & int(_FAILURES)) != 0,
        steps=ObservedSteps(
            collides=(flags & kernels.COLLIDES) != 0,
            touches=(flags & kernels.TOUCHES) != 0,
            presses=(flags & kernels.PRESSES) != 0,
            speed=motion[..., 0],
            offset=motion[..., 1:4],
            velocity=motion[..., 4:7],
            rise=motion[..., 7],
        ),
    )


def constraint_rows(shared: mujoco.MjModel, contacts: int) -> int:
    """Rows of the constraints of one world with so many contacts."""
    condim = int(shared.geom_condim.max())
    return condim * contacts + int(shared.neq) + int(shared.jnt_limited.sum())


def bytes_per_world(
    shared: mujoco.MjModel, *, contacts: int, contact_limit: int, corners: int, faces: int
) -> int:
    """About how much device memory one more world takes.

    Args:
        shared: The library's model.
        contacts: There is room for, a world on average.
        contact_limit: Contacts of one world at most.
        corners: Of any polygon of a hull, at most.
        faces: At any vertex of a hull, at most.
    """
    rows, worlds = constraint_rows(shared, contact_limit), 8
    with wp.ScopedDevice("cpu"):
        data = mjw.make_data(shared, nworld=worlds, naconmax=contacts * worlds, njmax=rows)
    kept = _bytes(data) // worlds
    solver = rows * (4 + 4 + 12) + 2 * data.efc.J.shape[2] ** 2 * 4
    sensors = int(shared.nsensor) * contact_limit * 3 * 4
    iterations = int(shared.opt.ccd_iterations)
    vertices, triangles = 10 + 2 * iterations, 6 + types.MJ_MAX_EPAFACES * iterations
    # Of each pair that may touch: the expanding polytope, and the polygons that are clipped.
    pair = 16 * vertices + 20 * triangles + 4 * types.MJ_MAX_EPAHORIZON
    pair += 88 * max(corners, 4) + 44 * max(faces, 3)
    by_world = 4 * shared.ngeom * (1 + 3 + 6 + 1 + 3 + 4 + 3)
    return int(kept + solver + sensors + contacts * pair + by_world)


def _bytes(record: Any) -> int:
    total = 0
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if isinstance(value, wp.array):
            total += int(value.capacity)
        elif dataclasses.is_dataclass(value):
            total += _bytes(value)
    return total
