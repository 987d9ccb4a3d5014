"""Every trial ends by name, and what failed for the simulator's sake never looks like a miss."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gmdx.errors import GraspError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import Snapshot
from gmdx.trials.run import run_trials
from tests.support import box_object, resting_scene

BOX = (0.03, 0.04, 0.05)


def _grasp(
    center: tuple[float, float, float], angle: float = 0.0, width: float = 0.05
) -> PlanarGrasp:
    return PlanarGrasp(np.array([0]), np.array([center]), np.array([angle]), np.array([width]))


def test_beside_the_object_is_no_contact() -> None:
    trials = run_trials(resting_scene(box_object(BOX)), _grasp((0.0, 0.1, 0.025)))
    assert np.all(trials.outcome == Outcome.NO_CONTACT)
    assert not trials.collision.any()
    assert trials.opening[0] == pytest.approx(0.0, abs=5e-4)
    assert trials.push_force[0] == 0.0
    assert not trials.contacts.valid.any()


def test_finger_above_the_object_is_a_collision() -> None:
    trials = run_trials(resting_scene(box_object(BOX)), _grasp((0.02, 0.0, 0.025)))
    assert np.all(trials.outcome == Outcome.COLLISION_IN_APPROACH)
    assert trials.collision.all()
    assert np.isnan(trials.object_position[0, Snapshot.CLOSING]).all()
    assert np.isnan(trials.opening[0])


def test_finger_below_the_table_is_a_collision() -> None:
    trials = run_trials(resting_scene(box_object(BOX)), _grasp((0.0, 0.1, 0.005)), trials=1)
    assert trials.outcome[0, 0] == Outcome.COLLISION_IN_APPROACH


def test_corner_squeezed_out_sideways_is_knocked_away() -> None:
    trials = run_trials(
        resting_scene(box_object(BOX)), _grasp((0.0, 0.024, 0.025), angle=0.6, width=0.06), trials=1
    )
    assert trials.outcome[0, 0] == Outcome.KNOCKED_AWAY


def test_too_heavy_to_lift_is_lost() -> None:
    # 2 mu N = 32 N holds at most 3.3 kg.
    trials = run_trials(resting_scene(box_object(BOX, mass=10.0)), _grasp((0.0, 0.0, 0.025)))
    assert trials.outcome[0, 0] == Outcome.LOST_IN_LIFT
    assert trials.push_force[0] == 0.0


def test_diverged_simulation_is_named_and_measures_nothing() -> None:
    slow = TrialConfig(mad_speed=0.05)  # m/s: what any gripper that comes down exceeds
    trials = run_trials(resting_scene(box_object(BOX)), _grasp((0.0, 0.0, 0.025)), config=slow)
    assert np.all(trials.outcome == Outcome.DIVERGED)
    assert np.isnan(trials.push_force[0])
    assert np.isnan(trials.opening[0])
    assert not trials.push_force_is_lower_bound[0]


def test_contacts_that_find_no_memory_end_a_trial_by_name() -> None:
    # MuJoCo drops contacts for which it has no memory, warns, and freezes the rollout.
    small = resting_scene(box_object(BOX), physics=PhysicsConfig(memory=4000))
    trials = run_trials(small, _grasp((0.0, 0.0, 0.025)))
    assert np.all(trials.outcome == Outcome.DIVERGED)


def test_what_flies_off_when_pushed_out_has_been_held() -> None:
    config = TrialConfig(push_direction=(0.0, 1.0, 0.0))
    scene = resting_scene(box_object(BOX, mass=0.02))
    trials = run_trials(scene, _grasp((0.0, 0.0, 0.025)), config=config)
    assert np.all(trials.outcome == Outcome.SUCCESS)
    # Friction bears the weight as well, across the push.
    expected = np.hypot(2 * 0.8 * 20.0, 0.02 * 9.81)
    assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


def test_nan_in_the_start_is_a_diverged_trial() -> None:
    scene = resting_scene(box_object(BOX))
    poisoned = replace(scene, position=scene.position * [1.0, np.nan, 1.0])
    trials = run_trials(poisoned, _grasp((0.0, 0.0, 0.025)))
    assert np.all(trials.outcome == Outcome.DIVERGED)


def test_engine_warnings_leave_no_file_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    small = resting_scene(box_object(BOX), physics=PhysicsConfig(memory=4000))
    run_trials(small, _grasp((0.0, 0.0, 0.025)))
    assert list(tmp_path.iterdir()) == []


def test_bad_requests_are_named() -> None:
    scene = resting_scene(box_object(BOX))
    with pytest.raises(UsageError, match="unknown engine 'mojoco'; give one of auto, mujoco"):
        run_trials(scene, _grasp((0.0, 0.0, 0.025)), "mojoco")
    with pytest.raises(GraspError, match=r"opens to 0\.0850 m"):
        run_trials(scene, _grasp((0.0, 0.0, 0.025), width=0.2))
    with pytest.raises(GraspError, match="not finite"):
        run_trials(scene, _grasp((0.0, np.nan, 0.025)))
    with pytest.raises(UsageError, match="at least 1 trial"):
        run_trials(scene, _grasp((0.0, 0.0, 0.025)), trials=0)


@pytest.mark.parametrize("engine", ["mujoco", "warp", "bullet"])
def test_scenes_under_several_physics_are_refused_by_what_differs(engine: str) -> None:
    module = {"warp": "warp", "bullet": "pybullet"}.get(engine)
    if module is not None:
        pytest.importorskip(module, reason="the engine is not installed")
    scene = resting_scene(box_object(BOX))
    other = replace(scene, physics=replace(scene.physics, timestep=0.002))
    grasp = _grasp((0.0, 0.0, 0.025))
    with pytest.raises(UsageError, match=r"'box' differs in timestep: 0\.004 -> 0\.002"):
        run_trials([scene, other], [grasp, grasp], engine, trials=1)


def test_an_empty_batch_is_an_empty_result() -> None:
    scene = resting_scene(box_object(BOX))
    trials = run_trials(scene, _grasp((0.0, 0.0, 0.025))[:0])
    assert len(trials) == 0
    assert trials.outcome.shape == (0, 5)
