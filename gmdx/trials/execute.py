"""The phases of a trial on any engine, and how each trial ends.

Phases run in turn, in chunks of steps. After each chunk the trials that have ended drop out, so
that nothing is simulated whose end is known. What is a collision, a lost object or a success is
decided here alone, from states and contacts: engines differ in nothing but how they step.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.layout import HEIGHT_QPOS, OBJECT_QPOS
from gmdx.trials import observations
from gmdx.trials.observations import ChunkResult, ObservedSteps
from gmdx.trials.outcome import Outcome
from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import Phase, Schedule, TrialConfig
from gmdx.trials.results import Snapshot
from gmdx.trials.stepper import Stepper

_Observe = Callable[[Int[Array, "a"], ObservedSteps, Int[Array, "a"], slice], Bool[Array, "a"]]


class Execution:
    """The running state of some batches; rows are their trials, one batch after the other.

    A trial runs its own batch's schedule and sees nothing of the other trials.
    """

    def __init__(
        self, stepper: Stepper, batches: Sequence[TrialBatch], config: TrialConfig
    ) -> None:
        self.stepper, self.batches, self.config = stepper, tuple(batches), config
        self.timestep = self.batches[0].physics.timestep  # of all, as of the engine
        self.layout = stepper.sensors
        self.nq, nv = stepper.size
        sizes = [len(batch) for batch in batches]
        count = sum(sizes)
        self.batch_of = np.repeat(np.arange(len(sizes)), sizes)
        self.mass = np.repeat([batch.object.mass for batch in batches], sizes)
        self.grasp_height = _joined(batches, "grasp_height")
        self.start_height = _joined(batches, "start_height")
        self.state = np.zeros((count, 1 + self.nq + nv))  # time, qpos, qvel
        self.qpos_at_sensors = np.zeros((count, self.nq))
        self.sensors = np.zeros((count, stepper.sensor_count))

        self.outcome = np.full(count, -1)
        self.collision = np.zeros(count, bool)
        self.touched = np.zeros(count, bool)
        self.pose = np.full((count, len(Snapshot), 7), np.nan)
        self.height = np.full((count, len(Snapshot)), np.nan)
        self.opening = np.full(count, np.nan)
        slots = self.layout.slots
        self.points = np.full((count, 2, slots, 3), np.nan)
        self.normals = np.full((count, 2, slots, 3), np.nan)
        self.valid = np.zeros((count, 2, slots), bool)
        self.held_force = np.zeros(count)
        self.pushed_out = np.zeros(count, bool)
        self.push_failed = np.zeros(count, bool)
        self.force = np.zeros(count)
        self.lower_bound = np.zeros(count, bool)
        self.steps = np.zeros(count, int)
        self.step_seconds = 0.0

    def run(self, schedules: Sequence[Schedule]) -> None:
        """All phases in turn, each batch by its own schedule."""
        self._start()
        self._live([schedule.approach for schedule in schedules], self._watch_approach)
        self._snapshot(Snapshot.CLOSING)
        self._live([schedule.close for schedule in schedules], self._watch_closing)
        self._snapshot(Snapshot.CLOSED)
        self._read_grip()
        self._live([schedule.lift for schedule in schedules], self._watch_lift)
        self._live([schedule.hold for schedule in schedules], self._watch_hold)
        self._snapshot(Snapshot.HELD)
        self._judge()
        self._push([schedule.push for schedule in schedules])

    def results(self) -> list[RawTrials]:
        """What was measured, a record a batch; after `run`."""
        unknown = Outcome.is_failure(self.outcome) | self.push_failed
        per_step = self.step_seconds / max(self.steps.sum(), 1)
        return [
            RawTrials(
                outcome=self.outcome[rows],
                collision=self.collision[rows],
                object_pose=self.pose[rows],
                tool_height=self.height[rows],
                contacts=PadContacts(self.points[rows], self.normals[rows], self.valid[rows]),
                opening=self.opening[rows],
                push_force=np.where(unknown, np.nan, self.force)[rows],
                push_force_is_lower_bound=(self.lower_bound & ~unknown)[rows],
                steps=int(self.steps[rows].sum()),
                step_seconds=float(self.steps[rows].sum() * per_step),
            )
            for rows in (self.batch_of == number for number in range(len(self.batches)))
        ]

    # Phases

    def _start(self) -> None:
        qpos = np.zeros((len(self.batch_of), self.nq))
        qpos[:, OBJECT_QPOS] = _joined(self.batches, "object_pose")
        qpos[:, HEIGHT_QPOS] = self.start_height
        openings = [batch.gripper.finger_positions(batch.opening) for batch in self.batches]
        qpos[:, self.stepper.finger_qpos] = np.concatenate(openings)
        self.state[:, 1 : 1 + self.nq] = qpos
        self._snapshot(Snapshot.START)

    def _watch_approach(
        self, rows: Int[Array, "a"], steps: ObservedSteps, count: Int[Array, "a"], _: slice
    ) -> Bool[Array, "a"]:
        """A touch by anything but a pad's face ends the trial."""
        collided = _any(steps.collides, count)
        self.collision[rows] |= collided
        self.outcome[rows[collided]] = Outcome.COLLISION_IN_APPROACH
        return collided

    def _watch_closing(
        self, rows: Int[Array, "a"], steps: ObservedSteps, count: Int[Array, "a"], _: slice
    ) -> Bool[Array, "a"]:
        """The phase ends early where neither fingers nor object move any more."""
        self.touched[rows] |= _any(steps.touches, count)
        return self._still(rows)

    def _watch_lift(
        self, rows: Int[Array, "a"], steps: ObservedSteps, count: Int[Array, "a"], _: slice
    ) -> Bool[Array, "a"]:
        """An object that no pad touches any more will not come back."""
        lost = observations.lets_go(steps, count)
        self.outcome[rows[lost]] = Outcome.LOST_IN_LIFT
        return lost

    def _watch_hold(
        self, rows: Int[Array, "a"], steps: ObservedSteps, count: Int[Array, "a"], span: slice
    ) -> Bool[Array, "a"]:
        return self._watch_lift(rows, steps, count, span) | self._still(rows)

    def _read_grip(self) -> None:
        """Contacts and opening at the end of closing; trials without a grip end here."""
        alive = np.flatnonzero(self._alive())
        fingers = self.state[alive, 1:][:, self.stepper.finger_qpos]
        self.opening[alive] = self.batches[0].gripper.opening(fingers)
        # Sensors belong to the start of their step, so they go with the pose before it.
        pose = self.qpos_at_sensors[alive, OBJECT_QPOS]
        contacts = observations.pad_contacts(self.sensors[alive], pose, self.layout)
        self.points[alive], self.normals[alive] = contacts.points, contacts.normals
        self.valid[alive] = contacts.valid
        missed = alive[~contacts.both]
        touched = self.touched[missed]
        self.outcome[missed] = np.where(touched, Outcome.KNOCKED_AWAY, Outcome.NO_CONTACT)

    def _judge(self) -> None:
        """Success: risen with the gripper, off the table, between both pads."""
        alive = self._alive()
        rise = self.pose[:, Snapshot.HELD, 2] - self.pose[:, Snapshot.CLOSED, 2]
        held = (
            (rise >= self.config.risen * self.config.lift_height)
            & (self.sensors[:, self.layout.object_table] == 0)
            & np.all(observations.pads_press(self.sensors, self.layout), axis=1)
        )
        self.outcome[alive & held] = Outcome.SUCCESS
        self.outcome[alive & ~held] = Outcome.LOST_IN_LIFT

    def _push(self, phases: Sequence[Phase]) -> None:
        """Push the nominal trial's object with a growing force until it slips out."""
        rows = np.flatnonzero(_joined(self.batches, "nominal") & (self.outcome == Outcome.SUCCESS))
        direction = np.array(self.config.push_direction)

        def along(vectors: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
            # Not `@`: BLAS may round one trial's numbers in another way than a batch's.
            component: Array = np.einsum("...i,i->...", vectors, direction)
            return component

        strength = along(phases[0].force)
        offset = along(observations.from_tool(self.state[:, 1 : 1 + self.nq]))

        dt = self.timestep
        last_velocity = along(self.state[:, 1 + self.nq :][:, :3])

        def watch(
            rows: Int[Array, "a"], steps: ObservedSteps, count: Int[Array, "a"], span: slice
        ) -> Bool[Array, "a"]:
            ran = observations.within(count, steps.rise.shape[1])
            moved = along(steps.offset) - offset[rows, None]
            velocity = along(steps.velocity)
            slip = velocity - steps.rise * direction[2]
            out = ran & (slip > self.config.slip_speed) & (moved > self.config.push_distance)
            first = np.where(out.any(axis=1), out.argmax(axis=1), count)
            # The grip bore the force less what already accelerated the object, as long as
            # the object did not slip.
            change = np.diff(velocity, axis=1, prepend=last_velocity[rows, None])
            bore = strength[span] - self.mass[rows, None] * change / dt
            last_velocity[rows] = velocity[np.arange(len(rows)), count - 1]
            held = observations.within(first, out.shape[1]) & (slip <= self.config.slip_speed)
            last = held.shape[1] - 1 - held[:, ::-1].argmax(axis=1)
            some = held.any(axis=1)
            self.held_force[rows[some]] = bore[some, last[some]].clip(min=0.0)
            ended: Array = first < count
            self.pushed_out[rows] |= ended
            return ended

        # What is out may be fast, and a push that fails takes no success away.
        failed, overflowed = self._advance(phases, watch, rows, fastest=np.inf)
        self.push_failed[failed] = self.push_failed[overflowed] = True
        out = self.pushed_out[rows]
        self.force[rows] = np.where(out, self.held_force[rows], strength[-1])
        self.lower_bound[rows] = ~out

    # Stepping

    def _advance(
        self,
        phases: Sequence[Phase],
        observe: _Observe,
        rows: Int[Array, "a"],
        *,
        fastest: float,
    ) -> tuple[Int[Array, "f"], Int[Array, "o"]]:
        """Step rows through a phase until it, or what `observe` watches for, ends.

        Returns the rows whose simulation failed, and those for which the engine had too little
        memory; nothing else sees them.
        """
        lengths = np.array([len(phase) for phase in phases])
        failed, overflowed = [], []
        chunk = self.config.chunk(self.timestep)
        for start in range(0, int(lengths.max()), chunk):
            rows = rows[lengths[self.batch_of[rows]] > start]
            if len(rows) == 0:
                break
            count = np.minimum(lengths[self.batch_of[rows]] - start, chunk)
            span = slice(start, start + int(count.max()))
            found = self._step(rows, phases, span, count)
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
            rows = rows[~observe(rows, steps, count, span)]
        none = np.zeros(0, int)
        return np.concatenate([none, *failed]), np.concatenate([none, *overflowed])

    def _live(self, phases: Sequence[Phase], observe: _Observe) -> None:
        """Step every living row through a phase; those that fail get the failure's name."""
        rows = np.flatnonzero(self._alive())
        failed, overflowed = self._advance(phases, observe, rows, fastest=self.config.mad_speed)
        self.outcome[failed] = Outcome.DIVERGED
        self.outcome[overflowed] = Outcome.OVERFLOWED

    def _step(
        self, rows: Int[Array, "a"], phases: Sequence[Phase], span: slice, count: Int[Array, "a"]
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

    # Reading

    def _alive(self) -> Bool[Array, "m"]:
        alive: Array = self.outcome < 0
        return alive

    def _snapshot(self, moment: Snapshot) -> None:
        alive = self._alive()
        qpos = self.state[alive, 1 : 1 + self.nq]
        self.pose[alive, moment] = qpos[:, OBJECT_QPOS]
        self.height[alive, moment] = qpos[:, HEIGHT_QPOS]

    def _still(self, rows: Int[Array, "a"]) -> Bool[Array, "a"]:
        qvel = self.state[rows, 1 + self.nq :]
        return observations.still(qvel, speed=self.config.still_speed, spin=self.config.still_spin)


def _joined(batches: Sequence[TrialBatch], name: str) -> Array:
    """One array of every batch, trial after trial."""
    return np.concatenate([getattr(batch, name) for batch in batches])


def _any(flags: Bool[Array, "n s"], count: Int[Array, "n"]) -> Bool[Array, "n"]:
    """Whether a flag was up in any step that a trial was to run."""
    up: Array = np.any(flags & observations.within(count, flags.shape[1]), axis=1)
    return up
