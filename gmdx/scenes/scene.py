"""A scene: one object at rest on the table."""

from dataclasses import dataclass

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.geometry import quaternion_matrix
from gmdx.objects.model import ObjectModel
from gmdx.scenes.physics import PhysicsConfig


@dataclass(frozen=True)
class Scene:
    """One object at rest on the table z = 0, its centre of mass above the world's origin.

    It carries the physics under which it rests, so that grasps, trials and metrics of it cannot
    be computed under another; `dataclasses.replace` gives the same scene under other physics.
    """

    object: ObjectModel
    scene_id: int
    seed: int  # of the run: every key of this scene's grasps and trials starts with it
    position: Float[Array, "3"]  # m, of the centre of mass (the object frame's origin)
    quaternion: Float[Array, "4"]  # wxyz, object to world
    settle_time: float  # s, simulated until rest
    physics: PhysicsConfig  # of its contacts, wherever it is simulated or valued

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """Rotation matrix, object to world."""
        return quaternion_matrix(self.quaternion)

    def to_world(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Points from the object's frame to the world, m."""
        turned: Array = np.einsum("...j,ij->...i", points, self.rotation)
        return turned + self.position

    def to_object(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Points from the world to the object's frame, m."""
        return self.direction_to_object(points - self.position)

    def direction_to_object(self, vectors: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Directions from the world to the object's frame."""
        # Not `@`: BLAS rounds one vector in another way than a batch of them, and a grasp's
        # numbers must not depend on its batch.
        turned: Array = np.einsum("...j,ji->...i", vectors, self.rotation)
        return turned
