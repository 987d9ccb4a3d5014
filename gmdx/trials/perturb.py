"""Seeded pose noise: what the arm and the camera get wrong."""

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.rng import generator
from gmdx.scenes.scene import Scene
from gmdx.trials.protocol import NoiseConfig


def perturb(
    scene: Scene, grasps: PlanarGrasp, *, trials: int, noise: NoiseConfig
) -> tuple[Float[Array, "n t 3"], Float[Array, "n t"]]:
    """Centres (m) and angles (rad, not wrapped) of every trial; trial 0 is the grasp itself.

    The noise is drawn in the grasp's own axes, so it turns with the world, and from the key
    (seed, object, scene, grasp, trial), so it does not depend on what else is in the batch. The
    closing axis has a direction here, from pad 0 to pad 1: half a turn mirrors the draws.
    """
    draws = np.zeros((len(grasps), trials, 4))
    for row, grasp_id in enumerate(grasps.grasp_id):
        for trial in range(1, trials):
            rng = generator(
                scene.seed,
                scene.object.object_id,
                "scene",
                scene.scene_id,
                "grasp",
                int(grasp_id),
                "trial",
                trial,
            )
            draws[row, trial] = np.clip(rng.standard_normal(4), -2.0, 2.0)
    draws *= [noise.position, noise.position, noise.height, noise.angle]
    cos, sin = np.cos(grasps.angle)[:, None], np.sin(grasps.angle)[:, None]
    along, across = draws[..., 0], draws[..., 1]
    shift = np.stack(
        [cos * along - sin * across, sin * along + cos * across, draws[..., 2]], axis=-1
    )
    return grasps.center[:, None, :] + shift, grasps.angle[:, None] + draws[..., 3]
