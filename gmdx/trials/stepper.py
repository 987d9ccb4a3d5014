"""The seam between the outcome rules and an engine: what steps trials, and what it hands back."""

from typing import Protocol, runtime_checkable

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.scenes.layout import ContactSensors, GraspModel
from gmdx.trials import observations
from gmdx.trials.observations import ChunkResult


@runtime_checkable
class Stepper(Protocol):
    """What steps trials. States are time, qpos and qvel, laid out as in `GraspModel`."""

    @property
    def size(self) -> tuple[int, int]:
        """Numbers in qpos and in qvel."""
        ...

    @property
    def finger_qpos(self) -> tuple[int, int]:
        """Addresses of finger 0 and 1 in qpos."""
        ...

    @property
    def sensors(self) -> ContactSensors:
        """Where each contact sensor's numbers lie."""
        ...

    @property
    def sensor_count(self) -> int:
        """How many numbers the sensors are."""
        ...

    def step(
        self,
        rows: Int[Array, "a"],
        state: Float[Array, "a n"],
        control: Float[Array, "a s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "a"],
    ) -> ChunkResult:
        """Run each trial for its number of steps, at most s.

        Args:
            rows: Which trials of the batches these are.
            state: A time of 0 is a trial's start.
            control: As of `Phase.controls`; of no meaning after a trial's last step.
            force: N, on the object's centre of mass.
            count: Steps to run, at least 1; the same for trials of one batch.
        """
        ...


class ModelLayout:
    """The part of a `Stepper` that follows from a compiled model: how states and sensors lie."""

    scene: GraspModel

    @property
    def size(self) -> tuple[int, int]:
        """Numbers in qpos and in qvel."""
        return self.scene.model.nq, self.scene.model.nv

    @property
    def finger_qpos(self) -> tuple[int, int]:
        """Addresses of finger 0 and 1 in qpos."""
        return self.scene.finger_qpos

    @property
    def sensors(self) -> ContactSensors:
        """Where each contact sensor's numbers lie."""
        return self.scene.sensors

    @property
    def sensor_count(self) -> int:
        """How many numbers the sensors are."""
        count: int = self.scene.model.nsensordata
        return count


def chunk_result(
    start: Float[Array, "n d"],
    states: Float[Array, "n s d"],
    sensors: Float[Array, "n s k"],
    stepper: Stepper,
    timestep: float,
) -> ChunkResult:
    """What an engine that keeps every step hands back, all of its trials having run all steps.

    Args:
        start: The states before the first step.
        states: After each step; an engine's clock stops where it fails.
        sensors: At the start of each step.
        stepper: For the layout of both.
        timestep: s.
    """
    nq, steps = stepper.size[0], states.shape[1]
    before = states[:, -2] if steps > 1 else start
    elapsed = states[:, -1, 0] - start[:, 0]
    return ChunkResult(
        state=states[:, -1],
        qpos_at_sensors=before[:, 1 : 1 + nq],
        sensors=sensors[:, -1],
        failed=~(elapsed > (steps - 0.5) * timestep),
        overflowed=np.zeros(len(states), bool),
        steps=observations.observe(
            states[..., 1 : 1 + nq], states[..., 1 + nq :], sensors, stepper.sensors
        ),
    )
