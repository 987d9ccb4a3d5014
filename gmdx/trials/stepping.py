"""Trials on their way through a phase: their states, and which of them still run.

Phases run in chunks of steps. After each chunk the trials that have ended drop out, so that
nothing is simulated whose end is known.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.scenes.layout import HEIGHT_QPOS, OBJECT_QPOS
from gmdx.trials import observations
from gmdx.trials.observations import ChunkResult, ObservedSteps
from gmdx.trials.placement import TrialBatch
from gmdx.trials.protocol import Phase
from gmdx.trials.stepper import Stepper

# Which of the rows end here: from the rows, their steps, how many each ran, and of which span of
# the phase they are.
Watch = Callable[[Int[Array, "a"], ObservedSteps, Int[Array, "a"], slice], Bool[Array, "a"]]


class Stepping:
    """The states of some batches; rows are their trials, one batch after the other.

    A trial runs its own batch's phases and sees nothing of the other trials.
    """

    def __init__(self, stepper: Stepper, batches: Sequence[TrialBatch], *, chunk: int) -> None:
        """Put every trial at its start.

        Args:
            stepper: What steps them.
            batches: Some, of at least one trial or none.
            chunk: Steps that run before it is seen which trials have ended.
        """
        self.stepper, self.chunk = stepper, chunk
        self.nq, nv = stepper.size
        sizes = [len(batch) for batch in batches]
        self.batch_of = np.repeat(np.arange(len(sizes)), sizes)
        self.grasp_height = joined(batches, "grasp_height")
        self.start_height = joined(batches, "start_height")
        count = sum(sizes)
        self.state = np.zeros((count, 1 + self.nq + nv))  # time, qpos, qvel
        self.qpos_at_sensors = np.zeros((count, self.nq))
        self.sensors = np.zeros((count, stepper.sensor_count))
        self.steps = np.zeros(count, int)  # run so far
        self.step_seconds = 0.0

        self.qpos[:, OBJECT_QPOS] = joined(batches, "object_pose")
        self.qpos[:, HEIGHT_QPOS] = self.start_height
        openings = [batch.gripper.finger_positions(batch.opening) for batch in batches]
        self.qpos[:, stepper.finger_qpos] = np.concatenate(openings)

    @property
    def qpos(self) -> Float[Array, "m q"]:
        """Positions of every trial; a view of `state`."""
        return self.state[:, 1 : 1 + self.nq]

    @property
    def qvel(self) -> Float[Array, "m v"]:
        """Velocities of every trial; a view of `state`."""
        return self.state[:, 1 + self.nq :]

    def advance(
        self, phases: Sequence[Phase], rows: Int[Array, "a"], watch: Watch, *, fastest: float
    ) -> tuple[Int[Array, "f"], Int[Array, "o"]]:
        """Step rows through a phase until it, or what `watch` looks for, ends.

        Args:
            phases: Of each batch.
            rows: Which trials.
            watch: Called after each chunk with the rows that are still sane.
            fastest: m/s; what is faster has failed.

        Returns:
            The rows whose simulation failed, and those for which the engine had too little
            memory; `watch` does not see them, and their states stay what they were.
        """
        lengths = np.array([len(phase) for phase in phases])
        failed, overflowed = [], []
        for start in range(0, int(lengths.max()), self.chunk):
            rows = rows[lengths[self.batch_of[rows]] > start]
            if len(rows) == 0:
                break
            count = np.minimum(lengths[self.batch_of[rows]] - start, self.chunk)
            span = slice(start, start + int(count.max()))
            found = self._step(phases, rows, span, count)
            steps = found.steps
            ran = observations.within(count, steps.speed.shape[1])
            wild = found.failed | ~np.all((steps.speed < fastest) | ~ran, axis=1)
            sane = ~wild & ~found.overflowed
            overflowed.append(rows[found.overflowed])
            failed.append(rows[wild & ~found.overflowed])
            rows, steps, count = rows[sane], steps[sane], count[sane]
            self.qpos_at_sensors[rows] = found.qpos_at_sensors[sane]
            self.sensors[rows] = found.sensors[sane]
            self.state[rows] = found.state[sane]
            rows = rows[~watch(rows, steps, count, span)]
        none = np.zeros(0, int)
        return np.concatenate([none, *failed]), np.concatenate([none, *overflowed])

    def _step(
        self, phases: Sequence[Phase], rows: Int[Array, "a"], span: slice, count: Int[Array, "a"]
    ) -> ChunkResult:
        """One call of the engine, each trial with its own batch's controls."""
        width = span.stop - span.start
        control = np.zeros((len(rows), width, 3))
        force = np.zeros((width, 3))
        for number in np.unique(self.batch_of[rows]):
            mine = self.batch_of[rows] == number
            heights = self.grasp_height[rows[mine]], self.start_height[rows[mine]]
            given = phases[number].controls(*heights, span)
            control[mine, : given.shape[1]] = given
            control[mine, given.shape[1] :] = given[:, -1:]  # engines may step on unseen
            part = phases[number].force[span]
            force[: len(part)] = part
        begin = time.perf_counter()
        found = self.stepper.step(rows, self.state[rows], control, force, count)
        self.step_seconds += time.perf_counter() - begin
        self.steps[rows] += count
        return found


def joined(batches: Sequence[TrialBatch], name: str) -> Array:
    """One array of every batch, trial after trial."""
    return np.concatenate([getattr(batch, name) for batch in batches])
