"""A scene: one object at rest on the table."""

from dataclasses import dataclass

from gmdx.arrays import Array, Float
from gmdx.geometry import quaternion_matrix
from gmdx.objects.model import ObjectModel


@dataclass(frozen=True)
class Scene:
    """One object at rest on the table z = 0, its centre of mass above the world's origin."""

    object: ObjectModel
    scene_id: int
    seed: int  # of the run: every key of this scene's grasps and trials starts with it
    position: Float[Array, "3"]  # m, of the centre of mass (the object frame's origin)
    quaternion: Float[Array, "4"]  # wxyz, object to world
    settle_time: float  # s, simulated until rest

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """Rotation matrix, object to world."""
        return quaternion_matrix(self.quaternion)

    def to_world(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Points from the object's frame to the world, m."""
        return points @ self.rotation.T + self.position

    def to_object(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Points from the world to the object's frame, m."""
        return (points - self.position) @ self.rotation
