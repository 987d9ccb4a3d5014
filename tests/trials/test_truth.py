"""Physics against closed forms of Coulomb friction, with the default parameters."""

import mujoco
import numpy as np
import pytest

from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.build import grasp_model, table_and_object
from gmdx.scenes.gripper import load_gripper, shipped_grippers
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import Snapshot
from gmdx.trials.run import run_trials
from tests.support import box_object, resting_scene

GRAVITY = 9.81


def _middle(height: float, width: float) -> PlanarGrasp:
    """One grasp through the world's z axis, closing along x."""
    return PlanarGrasp(
        np.array([0]), np.array([[0.0, 0.0, height]]), np.array([0.0]), np.array([width])
    )


def _slide(extents: tuple[float, float, float], friction: float, angle: float) -> float:
    """How far a box slides in the second second on a plane tilted by `angle`, m."""
    spec = table_and_object(box_object(extents, friction=friction), PhysicsConfig())
    spec.option.gravity = [GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[2] = 0.5 * extents[2]
    mujoco.mj_step(model, data, nstep=250)
    start = data.qpos[0]
    mujoco.mj_step(model, data, nstep=250)
    return float(data.qpos[0] - start)


@pytest.mark.parametrize("extents", [(0.05, 0.04, 0.03), (0.02, 0.03, 0.008), (0.1, 0.05, 0.02)])
@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_box_on_slope_sticks_below_the_friction_angle_and_slides_above(
    extents: tuple[float, float, float], friction: float
) -> None:
    steepest = np.arctan(friction)
    assert _slide(extents, friction, 0.97 * steepest) < 2e-4
    # Above, Newton's law from rest: the second second covers 3/2 of g (sin a - mu cos a) s^2.
    angle = 1.03 * steepest
    pull = GRAVITY * (np.sin(angle) - friction * np.cos(angle))
    assert _slide(extents, friction, angle) == pytest.approx(1.5 * pull, rel=0.05)


@pytest.mark.parametrize("gripper_name", shipped_grippers())
def test_pads_press_with_the_gripper_s_force(gripper_name: str) -> None:
    gripper = load_gripper(gripper_name)
    built = grasp_model(box_object((0.03, 0.04, 0.05)), gripper, PhysicsConfig())
    data = mujoco.MjData(built.model)
    data.qpos[:8] = [0.0, 0.0, 0.025, 1.0, 0.0, 0.0, 0.0, 0.025]
    data.qpos[list(built.finger_qpos)] = gripper.finger_positions(np.array(0.05))
    data.ctrl[:] = [0.025, 0.0, 0.3]
    mujoco.mj_step(built.model, data, nstep=150)
    for side in (0, 1):
        force = 0.0
        for index, contact in enumerate(data.contact):
            if built.model.geom("gripper/" + gripper.pads[side]).id in contact.geom:
                wrench = np.zeros(6)
                mujoco.mj_contactForce(built.model, data, index, wrench)
                force += wrench[0]
        assert force == pytest.approx(gripper.force, rel=0.01)


@pytest.mark.parametrize("mass", [0.05, 0.1, 0.5])
@pytest.mark.parametrize("friction", [0.3, 0.8])
@pytest.mark.parametrize("gripper_name", shipped_grippers())
def test_squeezed_box_is_pushed_out_at_twice_the_friction_limit(
    gripper_name: str, friction: float, mass: float
) -> None:
    gripper = load_gripper(gripper_name)
    scene = resting_scene(box_object((0.03, 0.04, 0.05), friction=friction, mass=mass))
    for direction in (-1.0, 1.0):
        config = TrialConfig(push_direction=(0.0, 0.0, direction))
        trials = run_trials(scene, _middle(0.025, 0.05), trials=1, gripper=gripper, config=config)
        expected = 2 * friction * gripper.force + direction * mass * GRAVITY
        assert trials.outcome[0, 0] == Outcome.SUCCESS
        assert not trials.push_force_is_lower_bound[0]
        assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("ramp", [0.25, 1.0, 5.0])
def test_push_tells_slip_from_creep_at_every_ramp(ramp: float) -> None:
    scene = resting_scene(box_object((0.03, 0.04, 0.05)))
    config = TrialConfig(push_ramp=ramp, push_limit=2.0)
    trials = run_trials(scene, _middle(0.025, 0.05), trials=1, config=config)
    expected = 2 * 0.8 * load_gripper().force - 0.1 * GRAVITY
    assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


def test_ramp_that_ends_too_early_gives_a_lower_bound() -> None:
    scene = resting_scene(box_object((0.03, 0.04, 0.05)))
    trials = run_trials(scene, _middle(0.025, 0.05), trials=1, config=TrialConfig(push_limit=1.0))
    assert trials.push_force_is_lower_bound[0]
    assert trials.push_force[0] == pytest.approx(load_gripper().force)


def test_held_box_creeps_less_than_a_millimetre_in_two_seconds() -> None:
    scene = resting_scene(box_object((0.03, 0.04, 0.05)))
    never_still = TrialConfig(hold_time=2.0, still_speed=0.0)
    trials = run_trials(scene, _middle(0.025, 0.05), trials=1, config=never_still)
    held = trials.object_position - trials.tool_position
    assert trials.outcome[0, 0] == Outcome.SUCCESS
    assert np.linalg.norm(held[0, Snapshot.HELD] - held[0, Snapshot.CLOSED]) < 1e-3


def test_centred_grasp_does_not_move_the_box_and_opens_to_its_width() -> None:
    scene = resting_scene(box_object((0.03, 0.04, 0.05)))
    trials = run_trials(scene, _middle(0.025, 0.05), trials=1)
    moved = trials.object_position[0, Snapshot.CLOSED] - trials.object_position[0, Snapshot.CLOSING]
    assert np.linalg.norm(moved) < 1e-4
    assert trials.opening[0] == pytest.approx(0.03, abs=3e-4)
    # The box's faces, met at the pads' corners, from outside.
    points, normals = trials.contacts.points[0], trials.contacts.normals[0]
    valid = trials.contacts.valid[0]
    assert np.all(valid.sum(axis=1) == 4)
    for side, x in ((0, -0.015), (1, 0.015)):
        np.testing.assert_allclose(points[side][valid[side], 0], x, atol=2e-4)
        np.testing.assert_allclose(
            normals[side][valid[side]], np.broadcast_to([-np.sign(x), 0, 0], (4, 3)), atol=1e-6
        )
        np.testing.assert_allclose(np.abs(points[side][valid[side], 1]), 0.01, atol=2e-4)


def test_off_centre_box_is_pulled_between_the_pads() -> None:
    scene = resting_scene(box_object((0.03, 0.04, 0.05)))
    grasp = PlanarGrasp(
        np.array([0]), np.array([[0.008, 0.0, 0.025]]), np.array([0.0]), np.array([0.06])
    )
    trials = run_trials(scene, grasp, trials=1)
    # Coupled fingers meet in the middle, so the box ends below the tool point.
    assert trials.object_position[0, Snapshot.CLOSED, 0] == pytest.approx(0.008, abs=5e-4)
