"""Trials in PyBullet: a small reference, to see how far labels depend on the engine.

The same schedule, poses and perturbations as on MuJoCo, and the same rules for what a trial's end
is called; it runs one trial at a time, each in a world that is built anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from importlib.metadata import version

import numpy as np

from gmdx.arrays import Array, Float, Int
from gmdx.grasps.grasp import PadContacts
from gmdx.scenes.build import grasp_model
from gmdx.scenes.layout import ContactSensors
from gmdx.trials.engines.bullet.world import BulletConfig, BulletWorld
from gmdx.trials.execute import Execution
from gmdx.trials.observations import ChunkResult
from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.stepper import ModelLayout, chunk_result


@dataclass(frozen=True)
class BulletEngine:
    """PyBullet on one core."""

    config: BulletConfig = field(default_factory=BulletConfig)

    @property
    def version(self) -> str:
        """Name and version."""
        return f"pybullet {version('pybullet')}"

    def run(self, batches: Sequence[TrialBatch], *, config: TrialConfig) -> list[RawTrials]:
        """Run every trial to its named end, one after the other."""
        return [self._run(batch, config) for batch in batches]

    def _run(self, batch: TrialBatch, config: TrialConfig) -> RawTrials:
        scene = grasp_model(batch.object, batch.gripper, batch.physics)
        schedules = [batch.schedule(config)]
        world = BulletWorld(scene, batch.object, batch.physics, self.config)
        try:
            stepper = _Stepper(world)
            found = Execution(stepper, [batch[:0]], config).results()
            for row in range(len(batch)):
                trial = Execution(stepper, [batch[row : row + 1]], config)
                trial.run(schedules)
                found += trial.results()
        finally:
            world.close()
        return _joined(found)


class _Stepper(ModelLayout):
    """One world that follows one trial; a start takes the place of the trial before it."""

    def __init__(self, world: BulletWorld) -> None:
        self.world, self.scene = world, world.scene

    @property
    def sensors(self) -> ContactSensors:
        return self.world.sensors

    @property
    def sensor_count(self) -> int:
        return self.world.sensor_count

    def step(
        self,
        rows: Int[Array, "a"],
        state: Float[Array, "a n"],
        control: Float[Array, "a s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "a"],
    ) -> ChunkResult:
        steps, nq = control.shape[1], self.size[0]
        timestep = self.world.physics.timestep
        states = np.full((1, steps, state.shape[1]), np.nan)
        sensors = np.zeros((1, steps, self.sensor_count))
        if np.isfinite(state).all():
            if state[0, 0] == 0.0:
                self.world.reset(state[0, 1 : 1 + nq])
            for step in range(steps):
                sensors[0, step] = self.world.step(control[0, step], force[step])
                states[0, step, 1 : 1 + nq], states[0, step, 1 + nq :] = self.world.state()
            states[0, :, 0] = state[0, 0] + timestep * np.arange(1, steps + 1)
        return chunk_result(state, states, sensors, self, timestep)


def _joined(parts: list[RawTrials]) -> RawTrials:
    """Trials one after the other."""

    def contacts(name: str) -> Array:
        return np.concatenate([getattr(part.contacts, name) for part in parts])

    arrays = {
        item.name: np.concatenate([getattr(part, item.name) for part in parts])
        for item in fields(RawTrials)
        if item.name not in ("contacts", "steps", "step_seconds")
    }
    return RawTrials(
        **arrays,
        contacts=PadContacts(contacts("points"), contacts("normals"), contacts("valid")),
        steps=sum(part.steps for part in parts),
        step_seconds=sum(part.step_seconds for part in parts),
    )
