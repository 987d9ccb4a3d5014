"""Trials side by side on a device, many objects at once.

An implementation steps a bounded number of trials side by side for one chunk of the schedule and
hands back what was observed; the outcome rules are those of `execute` on every engine. Between
chunks only the trials that are still alive go on, packed together, so that what has ended costs
nothing.
"""

import gc
import logging
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.errors import DeviceMemoryError
from gmdx.machine.devices import cuda_devices
from gmdx.scenes.build import grasp_model
from gmdx.scenes.layout import GraspModel
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.execute import Execution
from gmdx.trials.observations import ChunkResult, joined
from gmdx.trials.placement import RawTrials, TrialBatch, check_alike
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.stepper import ModelLayout

_LOG = logging.getLogger("gmdx")

MOST_OBJECTS = 64  # different objects side by side at most
_CAPACITIES = (16, 64, 256, 1024, 4096, 16384)  # few, as each may cost a compilation
_CPU_CAPACITY = 256  # trials side by side where memory says nothing: more are not faster on a CPU


@runtime_checkable
class Worlds(Protocol):
    """Some objects, and room for many trials of them side by side."""

    @property
    def lanes(self) -> int:
        """How many launches may be under way at once."""
        ...

    def launch(
        self,
        index: Int[Array, "n"],
        state: Float[Array, "n d"],
        control: Float[Array, "n s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "n"],
    ) -> Callable[[], ChunkResult]:
        """Queue the steps of trials on the device; the call of what comes back waits for them.

        Args:
            index: Which of the objects each trial is of.
            state: Time, qpos and qvel, as of `GraspModel`.
            control: As of `Phase.controls`, for a whole chunk.
            force: N, on the objects' centres of mass.
            count: Steps that each trial runs, at most s.

        Raises:
            DeviceMemoryError: From the launch or from the wait.
        """
        ...


@runtime_checkable
class Implementation(Protocol):
    """What computes: the door of an implementation's folder offers these functions."""

    def bucket(self, model: GraspModel) -> Hashable:
        """Objects of one bucket can be side by side."""
        ...

    def open_worlds(
        self, models: Sequence[GraspModel], *, capacity: int, physics: PhysicsConfig
    ) -> Worlds:
        """Room for so many trials of these objects, all of one bucket and of these physics."""
        ...

    def suggested_capacity(self, models: Sequence[GraspModel]) -> int | None:
        """Trials side by side that the device's free memory has room for; None if unknown."""
        ...

    def version(self) -> str:
        """Versions and the device, as records name them."""
        ...


class Cancelled(Exception):  # noqa: N818, it is no error
    """Another thread has ended this run."""


class ParallelEngine:
    """Batched trials on the devices that an implementation finds."""

    def __init__(
        self, name: str, implementation: Implementation, *, parallel_trials: int | None = None
    ) -> None:
        """Take an implementation as it is.

        Args:
            name: The engine's, for records.
            implementation: The folder that computes, as `engines.warp`.
            parallel_trials: Trials side by side; None lets the device's memory decide.
        """
        self.name, self.implementation = name, implementation
        self.parallel_trials = parallel_trials
        self._cancelled = threading.Event()

    @property
    def version(self) -> str:
        """Name, versions and device."""
        return f"{self.name} ({self.implementation.version()})"

    @property
    def wanted_trials(self) -> int:
        """How many trials at once keep the device at work."""
        if self.parallel_trials is not None:
            return self.parallel_trials
        return _CAPACITIES[-1] if cuda_devices() > 0 else _CPU_CAPACITY

    def cancel(self) -> None:
        """End a run that is under way in another thread at its next chunk of steps."""
        self._cancelled.set()

    def check_cancelled(self) -> None:
        """Raise if the run was cancelled.

        Raises:
            Cancelled: It was.
        """
        if self._cancelled.is_set():
            raise Cancelled

    def run(self, batches: Sequence[TrialBatch], *, config: TrialConfig) -> list[RawTrials]:
        """Run every trial to its named end; a batch's results do not depend on the others."""
        check_alike(batches)
        results: list[RawTrials | None] = [None] * len(batches)
        for group in self._groups(batches):
            physics = batches[0].physics
            stepper = _Stepper(
                self,
                group.models,
                group.index(batches),
                physics=physics,
                chunk=config.chunk(physics.timestep),
            )
            chosen = [batches[number] for number in group.numbers]
            trials = Execution(stepper, chosen, config)
            trials.run([batch.schedule(config) for batch in chosen])
            for number, found in zip(group.numbers, trials.results(), strict=True):
                results[number] = found
            del stepper, trials  # the next group needs the device's memory
        return [found for found in results if found is not None]

    def _groups(self, batches: Sequence[TrialBatch]) -> list["_Group"]:
        """Batches whose objects can be side by side, in order; an object is compiled once."""
        open_groups: dict[Hashable, _Group] = {}
        groups: list[_Group] = []
        home: dict[int, tuple[_Group, int]] = {}
        for number, batch in enumerate(batches):
            if id(batch.object) not in home:
                model = grasp_model(batch.object, batch.gripper, batch.physics)
                bucket = self.implementation.bucket(model)
                group = open_groups.get(bucket)
                if group is None or len(group.models) == MOST_OBJECTS:
                    group = open_groups[bucket] = _Group([], [], [])
                    groups.append(group)
                home[id(batch.object)] = group, len(group.models)
                group.models.append(model)
            group, position = home[id(batch.object)]
            group.numbers.append(number)
            group.positions.append(position)
        return groups


@dataclass(frozen=True)
class _Group:
    """Batches that share worlds."""

    models: list[GraspModel]
    numbers: list[int]  # of the batches
    positions: list[int]  # of each batch's object in `models`

    def index(self, batches: Sequence[TrialBatch]) -> Int[Array, "m"]:
        """The object of every trial."""
        return np.repeat(self.positions, [len(batches[number]) for number in self.numbers])


class _Stepper(ModelLayout):
    """Cuts trials into batches that fit, and puts the results together."""

    def __init__(
        self,
        engine: ParallelEngine,
        models: Sequence[GraspModel],
        index: Int[Array, "m"],
        *,
        physics: PhysicsConfig,
        chunk: int,
    ) -> None:
        self.engine, self.models, self.index = engine, models, index
        self.physics, self.chunk = physics, chunk
        self.scene = models[0]  # all lie alike
        self.capacity = _capacity(engine, models, len(index))
        self.worlds = self._open()

    def step(
        self,
        rows: Int[Array, "a"],
        state: Float[Array, "a n"],
        control: Float[Array, "a s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "a"],
    ) -> ChunkResult:
        asked = control.shape[1]
        missing = self.chunk - asked  # one length for all: one compilation
        control = np.pad(control, ((0, 0), (0, missing), (0, 0)), mode="edge")
        force = np.pad(force, ((0, missing), (0, 0)))
        while True:
            try:
                found = self._run(self.index[rows], state, control, force, count)
                return replace(found, steps=found.steps[:, :asked])
            except DeviceMemoryError as error:
                self._halve(error)
            del self.worlds  # its memory is needed, and what failed is no longer referred to
            self.worlds = self._open()

    def _run(
        self,
        index: Int[Array, "a"],
        state: Float[Array, "a n"],
        control: Float[Array, "a s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "a"],
    ) -> ChunkResult:
        waiting: list[Callable[[], ChunkResult]] = []
        found: list[ChunkResult] = []
        for start in range(0, len(index), self.capacity):
            if len(waiting) == self.worlds.lanes:
                found.append(waiting.pop(0)())
            self.engine.check_cancelled()
            part = slice(start, start + self.capacity)
            arrays = index[part], state[part], control[part]
            waiting.append(self.worlds.launch(*arrays, force, count[part]))
        return joined([*found, *(wait() for wait in waiting)])

    def _open(self) -> Worlds:
        while True:
            gc.collect()  # what a failure leaves in cycles may hold a device's memory
            try:
                return self.engine.implementation.open_worlds(
                    self.models, capacity=self.capacity, physics=self.physics
                )
            except DeviceMemoryError as error:
                self._halve(error)

    def _halve(self, error: DeviceMemoryError) -> None:
        if self.capacity == 1:
            raise error
        self.capacity = -(-self.capacity // 2)
        _LOG.warning("%s; going on with %d trials side by side", str(error), self.capacity)


def _capacity(engine: ParallelEngine, models: Sequence[GraspModel], trials: int) -> int:
    """Trials side by side: what was asked for or what memory allows, not more than there are."""
    most = engine.parallel_trials
    if most is None:
        room = engine.implementation.suggested_capacity(models)
        room = _CPU_CAPACITY if room is None else room
        # Of the few sizes, as free memory is never twice the same.
        most = max((size for size in _CAPACITIES if size <= room), default=room)
    enough = next((size for size in _CAPACITIES if size >= trials), _CAPACITIES[-1])
    return max(1, min(most, enough))
