"""What an engine is handed and what it hands back: trials in the gripper's frame.

The gripper's frame turns and shifts with each grasp: its z axis is the world's, its origin lies
on the table below the tool point, its x axis is the closing axis. The table is z = 0 in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.config import as_dict, differences
from gmdx.errors import UsageError
from gmdx.geometry import quaternion_matrix, quaternion_multiply, yaw_quaternion
from gmdx.grasps.collide import object_in_gripper
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.objects.model import ObjectModel
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.trials.perturb import perturb
from gmdx.trials.protocol import Schedule, TrialConfig, compile_schedule


@dataclass(frozen=True)
class TrialBatch:
    """m trials of one object with one gripper, under its scene's physics."""

    object: ObjectModel
    physics: PhysicsConfig
    gripper: Gripper
    nominal: Bool[Array, "m"]  # pushed at the end
    center: Float[Array, "m 3"]  # m, world, of the executed (perturbed) grasp
    angle: Float[Array, "m"]  # rad, world, of the executed closing axis
    object_pose: Float[Array, "m 7"]  # at the start, gripper's frame: position m, quaternion wxyz
    grasp_height: Float[Array, "m"]  # m, of the tool point at the grasp
    start_height: Float[Array, "m"]  # m, of the tool point where the approach starts
    opening: Float[Array, "m"]  # m, until the fingers close
    descent: float  # m, the longest way down to a grasp in this scene

    def __len__(self) -> int:
        return len(self.angle)

    def schedule(self, config: TrialConfig) -> Schedule:
        """The one schedule that every trial of the batch follows, on every engine."""
        return compile_schedule(
            config,
            physics=self.physics,
            stroke=self.gripper.stroke,
            closing_force=self.gripper.force,
            descent=self.descent,
        )

    def __getitem__(self, rows: slice) -> "TrialBatch":
        """Some of the trials, of the same object in the same scene."""
        return replace(
            self,
            nominal=self.nominal[rows],
            center=self.center[rows],
            angle=self.angle[rows],
            object_pose=self.object_pose[rows],
            grasp_height=self.grasp_height[rows],
            start_height=self.start_height[rows],
            opening=self.opening[rows],
        )


@dataclass(frozen=True)
class RawTrials:
    """What an engine measured on a `TrialBatch`; what was not reached is NaN or invalid."""

    outcome: Int[Array, "m"]
    collision: Bool[Array, "m"]
    object_pose: Float[Array, "m 4 7"]  # by Snapshot, gripper's frame
    tool_height: Float[Array, "m 4"]  # m, by Snapshot
    contacts: PadContacts  # object's frame, at CLOSED
    opening: Float[Array, "m"]  # m, at CLOSED
    push_force: Float[Array, "m"]  # N
    push_force_is_lower_bound: Bool[Array, "m"]
    steps: int
    step_seconds: float  # s, inside the engine's step


def place(
    scene: Scene, grasps: PlanarGrasp, *, trials: int, gripper: Gripper, config: TrialConfig
) -> TrialBatch:
    """The trials of a batch of grasps, grasp by grasp, seen from the gripper."""
    centers, angles = perturb(scene, grasps, trials=trials, noise=config.noise)
    center, angle = centers.reshape(-1, 3), angles.reshape(-1)

    position, quaternion = object_in_gripper(scene, center, angle)
    top = max(float(scene.to_world(hull)[:, 2].max()) for hull in scene.object.hulls)
    start = np.maximum(top + gripper.tip, center[:, 2]) + config.clearance
    return TrialBatch(
        object=scene.object,
        physics=scene.physics,
        gripper=gripper,
        nominal=np.tile(np.arange(trials) == 0, len(grasps)),
        center=center,
        angle=angle,
        object_pose=np.concatenate([position, quaternion], axis=1),
        grasp_height=center[:, 2],
        start_height=start,
        opening=np.repeat(grasps.width, trials),
        descent=top + config.clearance,
    )


def check_alike(batches: Sequence[TrialBatch]) -> None:
    """Refuse batches that cannot be run in one call.

    Raises:
        UsageError: Their grippers or their physics differ; the message says in what.
    """
    for batch in batches[1:]:
        if batch.gripper is not batches[0].gripper:
            raise UsageError("the scenes of one call are grasped by one gripper")
        if batch.physics != batches[0].physics:
            lines = differences(as_dict(batches[0].physics), as_dict(batch.physics))
            raise UsageError(
                f"the scenes of one call are under one physics, and that of "
                f"{batch.object.object_id!r} differs in {', '.join(lines)}: run them in two calls"
            )


def to_world(
    pose: Float[Array, "n s 7"], center: Float[Array, "n 3"], angle: Float[Array, "n"]
) -> tuple[Float[Array, "n s 3"], Float[Array, "n s 4"]]:
    """Poses from the gripper's frame to the world: positions (m) and quaternions (wxyz)."""
    turn = yaw_quaternion(angle)
    ground = np.concatenate([center[:, :2], np.zeros((len(center), 1))], axis=1)
    position = np.einsum("nij,nsj->nsi", quaternion_matrix(turn), pose[..., :3]) + ground[:, None]
    return position, quaternion_multiply(np.repeat(turn[:, None], pose.shape[1], 1), pose[..., 3:])
