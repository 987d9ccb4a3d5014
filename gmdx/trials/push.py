"""The push: a growing force on the mass centre of what is held, until it slips out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.trials import observations
from gmdx.trials.observations import ObservedSteps
from gmdx.trials.protocol import Phase, TrialConfig
from gmdx.trials.stepping import Stepping


@dataclass(frozen=True)
class Pushed:
    """How the push of each of n trials ended."""

    force: Float[Array, "n"]  # N, that the grip bore last before the object slipped
    is_lower_bound: Bool[Array, "n"]  # the force had grown to its end, and the object still held
    failed: Bool[Array, "n"]  # the simulation failed: the force means nothing


def push_out(
    stepping: Stepping,
    phases: Sequence[Phase],
    rows: Int[Array, "n"],
    *,
    mass: Float[Array, "n"],
    timestep: float,
    config: TrialConfig,
) -> Pushed:
    """Push the objects of some trials out of the gripper.

    Args:
        stepping: The trials, lifted and held.
        phases: Of each batch; the force grows alike in all.
        rows: Which trials.
        mass: kg, of their objects.
        timestep: s, of the simulation.
        config: Direction of the push, and what counts as slipping.
    """
    slip = _Slip(stepping, phases[0], rows, mass, timestep, config)
    # What is out may be fast.
    ended_badly = stepping.advance(phases, rows, slip.watch, fastest=np.inf)
    return Pushed(
        force=np.where(slip.out, slip.bore, slip.strength[-1]),
        is_lower_bound=~slip.out,
        failed=np.isin(rows, np.concatenate(ended_badly)),
    )


class _Slip:
    """What a push has come to so far, and the watch that sees which objects slip out."""

    def __init__(
        self,
        stepping: Stepping,
        phase: Phase,
        rows: Int[Array, "n"],
        mass: Float[Array, "n"],
        timestep: float,
        config: TrialConfig,
    ) -> None:
        self.config, self.mass, self.timestep = config, mass, timestep
        self.direction = np.array(config.push_direction)
        self.place = np.full(len(stepping.batch_of), -1)  # of a row among the n
        self.place[rows] = np.arange(len(rows))
        self.strength = self._along(phase.force)  # N, by step
        self.offset = self._along(observations.from_tool(stepping.qpos[rows]))
        self.velocity = self._along(stepping.qvel[rows, :3])
        self.bore = np.zeros(len(rows))  # N, what the grip held last
        self.out = np.zeros(len(rows), bool)

    def watch(
        self, rows: Int[Array, "a"], steps: ObservedSteps, count: Int[Array, "a"], span: slice
    ) -> Bool[Array, "a"]:
        """Which objects are out: slipping, and no longer where they were held."""
        at = self.place[rows]
        ran = observations.within(count, steps.rise.shape[1])
        moved = self._along(steps.offset) - self.offset[at, None]
        velocity = self._along(steps.velocity)
        slip = velocity - steps.rise * self.direction[2]
        out = ran & (slip > self.config.slip_speed) & (moved > self.config.push_distance)
        first = np.where(out.any(axis=1), out.argmax(axis=1), count)
        # The grip bore the force less what already accelerated the object, as long as the object
        # did not slip.
        change = np.diff(velocity, axis=1, prepend=self.velocity[at, None])
        bore = self.strength[span] - self.mass[at, None] * change / self.timestep
        self.velocity[at] = velocity[np.arange(len(rows)), count - 1]
        held = observations.within(first, out.shape[1]) & (slip <= self.config.slip_speed)
        last = held.shape[1] - 1 - held[:, ::-1].argmax(axis=1)
        some = held.any(axis=1)
        self.bore[at[some]] = bore[some, last[some]].clip(min=0.0)
        ended: Array = first < count
        self.out[at] |= ended
        return ended

    def _along(self, vectors: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        # Not `@`: BLAS may round one trial's numbers in another way than a batch's.
        component: Array = np.einsum("...i,i->...", vectors, self.direction)
        return component
