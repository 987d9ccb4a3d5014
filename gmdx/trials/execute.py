"""The phases of a trial on any engine, and how each trial ends.

What is a collision, a lost object or a success is decided here alone, from states and contacts:
engines differ in nothing but how they step.
"""

from collections.abc import Sequence

import numpy as np

from gmdx.arrays import Array, Bool, Int
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.layout import HEIGHT_QPOS, OBJECT_QPOS
from gmdx.trials import observations
from gmdx.trials.observations import ObservedSteps
from gmdx.trials.outcome import Outcome
from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import Phase, Schedule, TrialConfig
from gmdx.trials.push import push_out
from gmdx.trials.results import Snapshot
from gmdx.trials.stepper import Stepper
from gmdx.trials.stepping import Stepping, Watch, joined


class Execution:
    """What has come of some batches so far; rows are their trials, one batch after the other."""

    def __init__(
        self, stepper: Stepper, batches: Sequence[TrialBatch], config: TrialConfig
    ) -> None:
        self.batches, self.config, self.layout = tuple(batches), config, stepper.sensors
        self.timestep = self.batches[0].physics.timestep  # s, of all, as of the engine
        self.stepping = Stepping(stepper, batches, chunk=config.chunk(self.timestep))
        count, slots = len(self.stepping.batch_of), self.layout.slots
        self.outcome = np.full(count, -1)
        self.collision = np.zeros(count, bool)
        self.touched = np.zeros(count, bool)
        self.pose = np.full((count, len(Snapshot), 7), np.nan)
        self.height = np.full((count, len(Snapshot)), np.nan)
        self.opening = np.full(count, np.nan)
        self.points = np.full((count, 2, slots, 3), np.nan)
        self.normals = np.full((count, 2, slots, 3), np.nan)
        self.valid = np.zeros((count, 2, slots), bool)
        self.push_failed = np.zeros(count, bool)
        self.force = np.zeros(count)
        self.lower_bound = np.zeros(count, bool)

    def run(self, schedules: Sequence[Schedule]) -> None:
        """All phases in turn, each batch by its own schedule."""
        self._snapshot(Snapshot.START)
        self._through([schedule.approach for schedule in schedules], self._watch_approach)
        self._snapshot(Snapshot.CLOSING)
        self._through([schedule.close for schedule in schedules], self._watch_closing)
        self._snapshot(Snapshot.CLOSED)
        self._read_grip()
        self._through([schedule.lift for schedule in schedules], self._watch_lift)
        self._through([schedule.hold for schedule in schedules], self._watch_hold)
        self._snapshot(Snapshot.HELD)
        self._judge()
        self._push([schedule.push for schedule in schedules])

    def results(self) -> list[RawTrials]:
        """What was measured, a record a batch; after `run`."""
        unknown = Outcome.is_failure(self.outcome) | self.push_failed
        steps = self.stepping.steps
        per_step = self.stepping.step_seconds / max(steps.sum(), 1)
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
                steps=int(steps[rows].sum()),
                step_seconds=float(steps[rows].sum() * per_step),
            )
            for rows in (self.stepping.batch_of == number for number in range(len(self.batches)))
        ]

    # Approach and closing

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

    def _read_grip(self) -> None:
        """Contacts and opening at the end of closing; trials without a grip end here."""
        alive = np.flatnonzero(self._alive())
        fingers = self.stepping.qpos[alive][:, self.stepping.stepper.finger_qpos]
        self.opening[alive] = self.batches[0].gripper.opening(fingers)
        # Sensors belong to the start of their step, so they go with the pose before it.
        pose = self.stepping.qpos_at_sensors[alive, OBJECT_QPOS]
        contacts = observations.pad_contacts(self.stepping.sensors[alive], pose, self.layout)
        self.points[alive], self.normals[alive] = contacts.points, contacts.normals
        self.valid[alive] = contacts.valid
        missed = alive[~contacts.both]
        touched = self.touched[missed]
        self.outcome[missed] = np.where(touched, Outcome.KNOCKED_AWAY, Outcome.NO_CONTACT)

    # Lift and hold

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
        """As in the lift; the phase ends early where nothing moves any more."""
        return self._watch_lift(rows, steps, count, span) | self._still(rows)

    def _judge(self) -> None:
        """Success: risen with the gripper, off the table, between both pads."""
        alive, sensors = self._alive(), self.stepping.sensors
        rise = self.pose[:, Snapshot.HELD, 2] - self.pose[:, Snapshot.CLOSED, 2]
        held = (
            (rise >= self.config.risen * self.config.lift_height)
            & (sensors[:, self.layout.object_table] == 0)
            & np.all(observations.pads_press(sensors, self.layout), axis=1)
        )
        self.outcome[alive & held] = Outcome.SUCCESS
        self.outcome[alive & ~held] = Outcome.LOST_IN_LIFT

    # Push

    def _push(self, phases: Sequence[Phase]) -> None:
        """Push the nominal trials' objects out; a push that fails takes no success away."""
        rows = np.flatnonzero(joined(self.batches, "nominal") & (self.outcome == Outcome.SUCCESS))
        masses = np.array([batch.object.mass for batch in self.batches])
        mass = masses[self.stepping.batch_of[rows]]
        pushed = push_out(
            self.stepping, phases, rows, mass=mass, timestep=self.timestep, config=self.config
        )
        self.force[rows], self.lower_bound[rows] = pushed.force, pushed.is_lower_bound
        self.push_failed[rows] = pushed.failed

    # All phases but the push

    def _through(self, phases: Sequence[Phase], watch: Watch) -> None:
        """Step every living row through a phase; those that fail get the failure's name."""
        rows = np.flatnonzero(self._alive())
        failed, overflowed = self.stepping.advance(
            phases, rows, watch, fastest=self.config.mad_speed
        )
        self.outcome[failed] = Outcome.DIVERGED
        self.outcome[overflowed] = Outcome.OVERFLOWED

    def _alive(self) -> Bool[Array, "m"]:
        alive: Array = self.outcome < 0
        return alive

    def _snapshot(self, moment: Snapshot) -> None:
        alive = self._alive()
        self.pose[alive, moment] = self.stepping.qpos[alive, OBJECT_QPOS]
        self.height[alive, moment] = self.stepping.qpos[alive, HEIGHT_QPOS]

    def _still(self, rows: Int[Array, "a"]) -> Bool[Array, "a"]:
        qvel = self.stepping.qvel[rows]
        return observations.still(qvel, speed=self.config.still_speed, spin=self.config.still_spin)


def _any(flags: Bool[Array, "n s"], count: Int[Array, "n"]) -> Bool[Array, "n"]:
    """Whether a flag was up in any step that a trial was to run."""
    up: Array = np.any(flags & observations.within(count, flags.shape[1]), axis=1)
    return up
