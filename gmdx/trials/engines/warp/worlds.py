"""Batched trials on MuJoCo Warp: every NVIDIA device there is, or else the CPU.

MuJoCo Warp computes in single precision, and stops its solver at a tolerance of 1e-6.
"""

import importlib.metadata
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from gmdx.arrays import Array, Float, Int
from gmdx.scenes.layout import GraspModel
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.engines.warp.buffers import bytes_per_world
from gmdx.trials.engines.warp.device import LANES, DeviceWorlds
from gmdx.trials.engines.warp.library import build_library, largest_mesh, slots_for
from gmdx.trials.engines.warp.log import listen
from gmdx.trials.observations import ChunkResult, joined

CONTACTS = 12  # of a trial on average: room to begin with, as most trials need fewer
CONTACT_LIMIT = 128  # of one trial: one that has more has overflowed
_MEMORY_SHARE = 0.6  # of a device's free memory


class WarpWorlds:
    """Some objects, and room for many trials of them side by side on all devices."""

    def __init__(
        self,
        models: Sequence[GraspModel],
        *,
        capacity: int,
        physics: PhysicsConfig,
        contacts: int = CONTACTS,
        contact_limit: int = CONTACT_LIMIT,
    ) -> None:
        """Put the objects on every device.

        Args:
            models: The objects, compiled with one gripper and `physics`.
            capacity: Trials side by side, over all devices.
            physics: As compiled.
            contacts: Room for so many contacts a trial on average, to begin with.
            contact_limit: Contacts of one trial: one that has more has overflowed.

        Raises:
            DeviceMemoryError: A device has no room for this.
            UsageError: An object has too many hulls, or differs in what cannot differ.
        """
        devices = _devices()
        library = build_library(models, physics)
        self.capacity = capacity
        self.parts = [
            DeviceWorlds(
                library,
                models[0],
                device,
                capacity=-(-capacity // len(devices)),
                contacts=contacts,
                contact_limit=contact_limit,
            )
            for device in devices
        ]

    @property
    def lanes(self) -> int:
        """How many launches may be under way at once."""
        return LANES

    def launch(
        self,
        index: Int[Array, "n"],
        state: Float[Array, "n d"],
        control: Float[Array, "n s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "n"],
    ) -> Callable[[], ChunkResult]:
        """As `parallel.Worlds.launch`: each device takes its share."""
        shares = [
            share
            for share in np.array_split(np.arange(len(index)), len(self.parts))
            if len(share) > 0
        ]
        waiting = [
            part.launch(index[rows], state[rows], control[rows], force, count[rows])
            for part, rows in zip(self.parts, shares, strict=False)
        ]
        return lambda: joined([wait() for wait in waiting])


def bucket(model: GraspModel) -> int:
    """Objects of one bucket can be side by side: those with about as many hulls."""
    return slots_for(model.model)


def open_worlds(
    models: Sequence[GraspModel], *, capacity: int, physics: PhysicsConfig
) -> WarpWorlds:
    """Room for so many trials of these objects, all of one bucket and of these physics."""
    return WarpWorlds(models, capacity=capacity, physics=physics)


def version() -> str:
    """Warp's version and its devices, as records name them."""
    found = _devices()
    names = [one.name if one.is_cuda else "cpu" for one in found]
    several = f"{len(found)} x " if len(found) > 1 else ""
    mjx = importlib.metadata.version("mujoco-mjx")
    return f"mujoco-mjx {mjx}, warp {wp.__version__} on {several}{names[0]}"


def suggested_capacity(models: Sequence[GraspModel]) -> int | None:
    """Trials side by side that fit into the free memory of the devices; None on a CPU."""
    found = _devices()
    if not found[0].is_cuda:
        return None
    free = min(one.free_memory for one in found)
    return max(1, int(_MEMORY_SHARE * free / bytes_per_trial(models))) * len(found)


def bytes_per_trial(models: Sequence[GraspModel]) -> int:
    """About how much device memory one more trial takes, all sizes of buffers together."""
    listen()
    sizes = [largest_mesh(grasp.model) for grasp in models]
    each = bytes_per_world(
        models[0].model,
        contacts=CONTACTS,
        contact_limit=CONTACT_LIMIT,
        corners=max(size["npolygonmax"] for size in sizes),
        faces=max(size["nmeshdegmax"] for size in sizes),
    )
    return 4 * each // 3  # buffers of a quarter of the size, a sixteenth, ...


def _devices() -> list[Any]:
    """All CUDA devices, or else the CPU."""
    listen()
    cuda: list[Any] = wp.get_cuda_devices()
    return cuda if cuda else [wp.get_device("cpu")]
