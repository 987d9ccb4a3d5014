"""Chunks of trials on one device: buffers of a few sizes, and on CUDA one graph a chunk."""

import dataclasses
import logging
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco.mjx.third_party.mujoco_warp as mjw
import warp as wp

from gmdx.arrays import Array, Float, Int
from gmdx.errors import DeviceMemoryError
from gmdx.scenes.layout import HEIGHT_QPOS, SLOT_SIZE, GraspModel
from gmdx.trials.engines.warp import kernels
from gmdx.trials.engines.warp.buffers import (
    ChunkArrays,
    chunk_arrays,
    chunk_result,
    constraint_rows,
)
from gmdx.trials.engines.warp.edges import EdgeContacts
from gmdx.trials.engines.warp.library import LARGEST, MESH_OF_GEOM, Library
from gmdx.trials.engines.warp.log import listen
from gmdx.trials.observations import FACE_COSINE, ChunkResult

_LOG = logging.getLogger("gmdx")

LANES = 2  # launches under way at once: the host prepares one while the device runs the other
# Kernels are compiled for the number of worlds that a model's arrays are for, and look up row
# `world % number`. Arrays of any capacity say they are for this many, and share the kernels.
_WORLDS = 2**20


@contextmanager
def device_memory(what: str) -> Iterator[None]:
    """Warp's failed allocations as our own error."""
    try:
        yield
    except RuntimeError as error:
        text = str(error).lower()
        full = "failed to allocate" in text or "out of memory" in text
        if full and "memory pool" not in text:
            raise DeviceMemoryError(f"no device memory for {what}: {error}") from error
        raise


class DeviceWorlds:
    """Room for trials of a library's objects on one device."""

    def __init__(
        self,
        library: Library,
        grasp: GraspModel,
        device: Any,
        *,
        capacity: int,
        contacts: int,
        contact_limit: int,
    ) -> None:
        """Put the library on the device.

        Args:
            library: The objects.
            grasp: Any of them: for what they share.
            device: Of Warp.
            capacity: Trials side by side.
            contacts: Room for so many contacts, or pairs of geoms that may touch, a trial on
                average; it grows where they are more.
            contact_limit: Contacts of one trial: one that has more has overflowed.

        Raises:
            DeviceMemoryError: The library does not fit.
        """
        self.library, self.grasp, self.device = library, grasp, device
        self.capacity, self.contacts, self.contact_limit = capacity, contacts, contact_limit
        self.captures = bool(device.is_cuda)
        shared = library.model
        self.rows = constraint_rows(shared, contact_limit)
        self.runs: dict[tuple[int, int], _Run] = {}
        with wp.ScopedDevice(device), device_memory("a library of objects"):
            by_world = (*library.columns, MESH_OF_GEOM)
            self.model = mjw.put_model(shared, batch_sizes=dict.fromkeys(by_world, capacity))
            self.targets = {name: self._widen(name) for name in by_world}
            self.model.callback.contactfilter = EdgeContacts(shared.geom_type)
            self.numbers = wp.array(library.numbers, dtype=float)
            self.meshes = wp.array(library.meshes, dtype=int)
            for name, values in library.mesh_arrays.items():
                kind = getattr(self.model, name).dtype
                setattr(self.model, name, wp.array(values, dtype=kind))
        for name in LARGEST:
            setattr(self.model, name, library.largest[name])
        self.model.opt.contact_sensor_maxmatch = contact_limit
        self.model.opt.warn_overflow = 0  # overflows are counted and named, not printed

    def _widen(self, name: str) -> tuple[Any, Any]:
        """Let a field by world say that it is for `_WORLDS`; its memory as plain numbers."""
        own = getattr(self.model, name)
        kind = int if name == MESH_OF_GEOM else float
        width = int(getattr(self.library.model, name).size)
        flat = wp.array(ptr=own.ptr, dtype=kind, shape=(self.capacity, width))
        wide = wp.array(ptr=own.ptr, dtype=own.dtype, shape=(_WORLDS, *own.shape[1:]))
        wide._is_batched = True
        setattr(self.model, name, wide)
        return flat, own  # the owner of the memory is kept

    def size_for(self, count: int) -> int:
        """The smallest size of buffers for so many trials: capacity over a power of 2 or 4."""
        shrink = 4 if self.device.is_cuda else 2
        size = self.capacity
        while -(-size // shrink) >= count and size > 1:
            size = -(-size // shrink)
        return size

    def launch(
        self,
        index: Int[Array, "n"],
        state: Float[Array, "n d"],
        control: Float[Array, "n s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "n"],
    ) -> Callable[[], ChunkResult]:
        """As `parallel.Worlds.launch`, for at most `capacity` trials."""
        listen()
        key = self.size_for(len(index)), control.shape[1]
        with wp.ScopedDevice(self.device), device_memory(f"{key[0]} trials side by side"):
            if key not in self.runs:
                self.runs[key] = _Run(self, *key)
            wait = self.runs[key].start(index, state, control, force, count)

        def result() -> ChunkResult:
            with wp.ScopedDevice(self.device), device_memory(f"{key[0]} trials side by side"):
                found = wait()
                while isinstance(found, int):
                    found = self._run_with(key, found).start(index, state, control, force, count)()
                return found

        return result

    def _run_with(self, key: tuple[int, int], need: int) -> "_Run":
        """Buffers with room for at least so many contacts."""
        if key not in self.runs or self.runs[key].room < need:
            self.contacts = max(self.contacts, -(-5 * need // (4 * key[0])))
            _LOG.info("room for %d contacts a trial on average", self.contacts)
            self.runs.pop(key, None)  # its memory is needed
            self.runs[key] = _Run(self, *key)
        return self.runs[key]


class _Run:
    """Buffers for chunks of `steps` steps of `size` worlds."""

    def __init__(self, owner: DeviceWorlds, size: int, steps: int) -> None:
        # No cycle: an owner that is dropped gives its memory back at once.
        self.owner, self.size, self.steps = weakref.proxy(owner), size, steps
        shared = owner.library.model
        self.room = max(owner.contacts * size, owner.contact_limit)
        self.data = mjw.make_data(shared, nworld=size, naconmax=self.room, njmax=owner.rows)
        self.arrays = chunk_arrays(shared, size, steps, owner.device, pinned=False)
        cuda = owner.device.is_cuda
        # One set for each launch under way, and one for a launch that runs again.
        self.free = [
            chunk_arrays(shared, size, steps, "cpu", pinned=cuda) for _ in range(LANES + 1)
        ]
        self.graph: Any = None

    def start(
        self,
        index: Int[Array, "n"],
        state: Float[Array, "n d"],
        control: Float[Array, "n s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "n"],
    ) -> Callable[[], ChunkResult | int]:
        """Queue a chunk; where contacts had no room, what comes back says how many there were."""
        host = self.free.pop()
        n, nq = len(index), self.owner.library.model.nq
        for name, values in (("index", index), ("count", count), ("control", control)):
            getattr(host, name).numpy()[:n] = values
        host.state.numpy()[:n] = state[:, 1:]
        host.force.numpy()[:] = force
        # Worlds without a trial have no object, and a gripper out of the table's reach.
        host.index.numpy()[n:], host.count.numpy()[n:] = -1, 0
        host.control.numpy()[n:] = [1.0, 0.0, 0.0]
        host.state.numpy()[n:] = 0.0
        host.state.numpy()[n:, [2, 3, HEIGHT_QPOS]] = 1.0

        for name in ChunkArrays.INPUTS:
            wp.copy(getattr(self.arrays, name), getattr(host, name))
        self._run()
        for name in host.outputs:
            wp.copy(getattr(host, name), getattr(self.arrays, name))
        queued = wp.record_event() if self.owner.device.is_cuda else None

        def wait() -> ChunkResult | int:
            if queued is not None:
                wp.synchronize_event(queued)
            need = int(host.need.numpy().max())
            time = state[:, 0] + count * float(self.owner.library.model.opt.timestep)
            found = need if need > self.room else chunk_result(host, n, nq, time)
            self.free.append(host)
            return found

        return wait

    def _run(self) -> None:
        if not self.owner.captures:
            self._chunk()
        elif self.graph is None:
            self._chunk()  # loads, and may compile, what a capture must find ready
            self._capture()
        else:
            wp.capture_launch(self.graph)

    def _capture(self) -> None:
        """Record the chunk's launches once, to be replayed at once."""
        try:
            with wp.ScopedCapture() as capture:
                self._chunk()
        except RuntimeError as error:
            _LOG.warning(
                "steps are launched one by one, which is slower: no CUDA graph of them (%s)", error
            )
            self.owner.captures = False
        else:
            self.graph = capture.graph

    def _chunk(self) -> None:
        """All steps, from the inputs' buffers to the outputs'."""
        owner, data, arrays = self.owner, self.data, self.arrays
        shared, layout = owner.library.model, owner.grasp.sensors
        for name, columns in owner.library.columns.items():
            flat = owner.targets[name][0]
            wp.launch(
                kernels.gather_numbers,
                dim=(self.size, flat.shape[1]),
                inputs=[arrays.index, owner.numbers, columns.start],
                outputs=[flat],
            )
        wp.launch(
            kernels.gather_meshes,
            dim=(self.size, shared.ngeom),
            inputs=[arrays.index, owner.meshes],
            outputs=[owner.targets[MESH_OF_GEOM][0]],
        )
        _clear(data.efc)  # numbers of an earlier trial, if not finite, would stay in sums
        wp.launch(
            kernels.start,
            dim=max(self.size, 2),
            inputs=[self.size, arrays.state, shared.nq, shared.nv],
            outputs=[data.qpos, data.qvel, data.qacc_warmstart, data.overflow, arrays.need],
        )
        for step in range(self.steps):
            wp.launch(
                kernels.drive,
                dim=self.size,
                inputs=[
                    step,
                    arrays.count,
                    arrays.control,
                    arrays.force,
                    owner.grasp.object_body,
                    shared.nq,
                    data.qpos,
                ],
                outputs=[data.ctrl, data.xfrc_applied, arrays.qpos_before],
            )
            mjw.step(owner.model, data)
            wp.launch(
                kernels.observe,
                dim=self.size,
                inputs=[
                    step,
                    arrays.count,
                    shared.nq,
                    shared.nv,
                    shared.nsensordata,
                    layout.pads[0].start,
                    layout.pads[1].start,
                    layout.slots,
                    SLOT_SIZE,
                    layout.hand,
                    layout.hand_table,
                    FACE_COSINE,
                    data.qpos,
                    data.qvel,
                    data.sensordata,
                    data.overflow,
                    data.nacon,
                    data.ncollision,
                ],
                outputs=[
                    arrays.flags,
                    arrays.motion,
                    arrays.last_state,
                    arrays.last_sensors,
                    arrays.last_overflow,
                    arrays.need,
                ],
            )


def _clear(record: Any) -> None:
    for field in dataclasses.fields(record):
        values = getattr(record, field.name)
        if isinstance(values, wp.array) and values.size > 0:
            values.zero_()
