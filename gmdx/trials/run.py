"""Running trials: one entry for every engine."""

import time
from collections.abc import Sequence
from typing import overload

import numpy as np

from gmdx.arrays import Array, Int
from gmdx.errors import GraspError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.scene import Scene
from gmdx.trials.engines import DEFAULT_ENGINE, Engine, open_engine
from gmdx.trials.placement import RawTrials, TrialBatch, check_alike, place, to_world
from gmdx.trials.protocol import TRIALS, TrialConfig
from gmdx.trials.results import TrialResults


@overload
def run_trials(
    scenes: Scene,
    grasps: PlanarGrasp,
    engine: str | Engine = ...,
    *,
    trials: int = ...,
    gripper: Gripper | None = ...,
    config: TrialConfig | None = ...,
    threads: int = ...,
    parallel_trials: int | None = ...,
) -> TrialResults: ...


@overload
def run_trials(
    scenes: Sequence[Scene],
    grasps: Sequence[PlanarGrasp],
    engine: str | Engine = ...,
    *,
    trials: int = ...,
    gripper: Gripper | None = ...,
    config: TrialConfig | None = ...,
    threads: int = ...,
    parallel_trials: int | None = ...,
) -> list[TrialResults]: ...


def run_trials(
    scenes: Scene | Sequence[Scene],
    grasps: PlanarGrasp | Sequence[PlanarGrasp],
    engine: str | Engine = DEFAULT_ENGINE,
    *,
    trials: int = TRIALS,
    gripper: Gripper | None = None,
    config: TrialConfig | None = None,
    threads: int = 1,
    parallel_trials: int | None = None,
) -> TrialResults | list[TrialResults]:
    """Approach, close, lift, hold, and push the nominal trial's object out of the gripper.

    Args:
        scenes: The object at rest, or several such, of any objects but under one physics; a scene's
            seed keys the pose noise.
        grasps: n grasps, or as many records of them as there are scenes. On a device the trials of
            all scenes run side by side, which changes no trial's result.
        engine: One of `ENGINES`, `auto`, or one that `open_engine` opened.
        trials: Trials a grasp: the nominal one, and the rest with pose noise.
        gripper: The default one if not given.
        config: The protocol.
        threads: Of MuJoCo on the CPU; the results do not depend on it.
        parallel_trials: Side by side on a device; its memory decides if not given.

    Returns:
        Results of the grasps; for several scenes a list of them, in their order.

    Raises:
        UsageError: The engine is not known or not installed, there is not one trial a grasp, or the
            scenes differ in their physics.
        GraspError: A grasp is not finite, or wider than the gripper opens.
    """
    if isinstance(engine, str):
        engine = open_engine(engine, threads=threads, parallel_trials=parallel_trials)
    gripper = load_gripper() if gripper is None else gripper
    config = TrialConfig() if config is None else config
    if trials < 1:
        raise UsageError(f"a grasp needs at least 1 trial, not {trials}")
    several = not isinstance(scenes, Scene)
    scene_list = list(scenes) if not isinstance(scenes, Scene) else [scenes]
    grasp_list = [grasps] if isinstance(grasps, PlanarGrasp) else list(grasps)
    if several == isinstance(grasps, PlanarGrasp) or len(scene_list) != len(grasp_list):
        raise UsageError("give one record of grasps for each scene")
    for item in grasp_list:
        _check(item, gripper)

    start = time.perf_counter()
    batches = [
        place(scene, item, trials=trials, gripper=gripper, config=config)
        for scene, item in zip(scene_list, grasp_list, strict=True)
    ]
    check_alike(batches)
    found = engine.run(batches, config=config)
    seconds = time.perf_counter() - start
    total = max(sum(raw.steps for raw in found), 1)
    results = [
        _results(item.grasp_id, batch, raw, trials, engine.version, seconds * raw.steps / total)
        for item, batch, raw in zip(grasp_list, batches, found, strict=True)
    ]
    return results if several else results[0]


def _check(grasps: PlanarGrasp, gripper: Gripper) -> None:
    finite = np.isfinite(grasps.center).all() and np.isfinite([grasps.angle, grasps.width]).all()
    if not finite:
        raise GraspError("grasps have centres, angles or widths that are not finite")
    if len(grasps) and not (grasps.width.min() > 0 and grasps.width.max() <= gripper.stroke + 1e-9):
        raise GraspError(
            f"grasps are {grasps.width.min():.4f} to {grasps.width.max():.4f} m wide; the gripper "
            f"{gripper.name} opens to {gripper.stroke:.4f} m: resample with this gripper"
        )


def _results(
    grasp_id: Int[Array, "n"],
    batch: TrialBatch,
    raw: RawTrials,
    trials: int,
    version: str,
    seconds: float,
) -> TrialResults:
    """Back to the world's frame, a row a grasp."""
    first = batch.nominal
    center, angle = batch.center[first], batch.angle[first]
    position, quaternion = to_world(raw.object_pose[first], center, angle)
    height = raw.tool_height[first]
    ground = np.repeat(center[:, None, :2], height.shape[1], axis=1)
    tool = np.concatenate([ground, height[..., None]], axis=2)
    return TrialResults(
        grasp_id=grasp_id,
        gripper=batch.gripper,
        outcome=raw.outcome.reshape(-1, trials),
        collision=raw.collision.reshape(-1, trials),
        object_position=position,
        object_quaternion=quaternion,
        tool_position=np.where(np.isnan(height)[..., None], np.nan, tool),
        contacts=raw.contacts[first],
        opening=raw.opening[first],
        push_force=raw.push_force[first],
        push_force_is_lower_bound=raw.push_force_is_lower_bound[first],
        engine=version,
        steps=raw.steps,
        step_seconds=raw.step_seconds,
        seconds=seconds,
    )
