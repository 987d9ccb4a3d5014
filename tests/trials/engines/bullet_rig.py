"""A world of the second engine in which tests move things themselves."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from gmdx.objects.model import ObjectModel
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.engines.bullet.world import BulletConfig, BulletWorld

UP = 0.5  # m, of a gripper that is out of the way
NOTHING = np.zeros(3)


@contextmanager
def bullet_world(obj: ObjectModel, gripper: Gripper | None = None) -> Iterator[BulletWorld]:
    gripper = load_gripper() if gripper is None else gripper
    physics = PhysicsConfig()
    world = BulletWorld(grasp_model(obj, gripper, physics), obj, physics, BulletConfig())
    try:
        yield world
    finally:
        world.close()


def start(
    position: tuple[float, float, float],
    quaternion: np.ndarray | tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    *,
    height: float = UP,
    fingers: np.ndarray | tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Positions of everything: object, tool, fingers."""
    return np.array([*position, *quaternion, height, *fingers], float)


def wait(world: BulletWorld, steps: int, *, height: float = UP, closing: float = 0.0) -> np.ndarray:
    """Steps with the gripper held in place; the last step's sensors."""
    sensors = np.zeros(0)
    for _ in range(steps):
        sensors = world.step(np.array([height, 0.0, closing]), NOTHING)
    return sensors
