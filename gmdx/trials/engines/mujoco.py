"""Trials on C MuJoCo through `mujoco.rollout`.

A trial's numbers depend on itself alone: not on the batch it runs in, nor on the number of
threads.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from gmdx.arrays import Array, Float, Int
from gmdx.scenes.build import grasp_model
from gmdx.scenes.layout import GraspModel
from gmdx.scenes.warnings import quiet_warnings
from gmdx.trials.execute import Execution
from gmdx.trials.observations import ChunkResult
from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.stepper import ModelLayout, chunk_result


@dataclass(frozen=True)
class MujocoEngine:
    """C MuJoCo on the CPU."""

    threads: int = 1

    @property
    def version(self) -> str:
        """Name and version."""
        return f"mujoco {mujoco.__version__}"

    def run(self, batches: Sequence[TrialBatch], *, config: TrialConfig) -> list[RawTrials]:
        """Run every trial to its named end, one batch after the other."""
        found = []
        for batch in batches:
            scene = grasp_model(batch.object, batch.gripper, batch.physics)
            with quiet_warnings(), rollout.Rollout(nthread=self.threads) as pool:
                trials = Execution(_Stepper(scene, pool, self.threads), [batch], config)
                trials.run([batch.schedule(config)])
            found += trials.results()
        return found


class _Stepper(ModelLayout):
    """Rollouts of one model; a rollout freezes at MuJoCo's first warning."""

    def __init__(self, scene: GraspModel, pool: rollout.Rollout, threads: int) -> None:
        self.scene, self.pool = scene, pool
        self.data = [mujoco.MjData(scene.model) for _ in range(threads)]

    def step(
        self,
        rows: Int[Array, "a"],
        state: Float[Array, "a n"],
        control: Float[Array, "a s 3"],
        force: Float[Array, "s 3"],
        count: Int[Array, "a"],
    ) -> ChunkResult:
        model = self.scene.model
        spec = mujoco.mjtState.mjSTATE_CTRL
        if np.any(force):
            spec |= mujoco.mjtState.mjSTATE_XFRC_APPLIED
            forces = np.zeros((*control.shape[:2], model.nbody, 6))
            forces[:, :, self.scene.object_body, :3] = force
            control = np.concatenate([control, forces.reshape(*control.shape[:2], -1)], axis=2)
        states, sensors = self.pool.rollout(
            model,
            self.data,
            state,
            control,
            control_spec=int(spec),
            initial_warmstart=np.zeros((len(state), model.nv)),
        )
        return chunk_result(state, states, sensors, self, model.opt.timestep)
