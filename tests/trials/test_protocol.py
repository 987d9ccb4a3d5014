import mujoco
import numpy as np
import pytest

from gmdx.errors import ConfigError
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.protocol import Schedule, TrialConfig, compile_schedule
from tests.support import box_object

CONFIG = TrialConfig()
PHYSICS = PhysicsConfig()
DT = PHYSICS.timestep


@pytest.fixture(scope="module")
def schedule() -> Schedule:
    return compile_schedule(CONFIG, physics=PHYSICS, stroke=0.085, closing_force=20.0, descent=0.1)


def test_controls_lead_from_the_start_to_the_grasp(schedule: Schedule) -> None:
    grasp, start = np.array([0.02, 0.05]), np.array([0.1, 0.11])
    approach = schedule.approach.controls(grasp, start)
    assert approach.shape == (2, round(0.1 / CONFIG.approach_speed / DT), 3)
    np.testing.assert_allclose(approach[:, 0, 0], start, atol=1e-3)
    # The commanded speed integrates to the way down.
    np.testing.assert_allclose(approach[..., 1].sum(axis=1) * DT, grasp - start)
    assert np.all(approach[..., 1] <= 1e-12)


def test_gripper_follows_the_schedule_exactly(schedule: Schedule) -> None:
    built = grasp_model(box_object((0.03, 0.04, 0.05)), load_gripper(), PHYSICS)
    data = mujoco.MjData(built.model)
    data.qpos[:8] = [0.0, 0.2, 0.025, 1.0, 0.0, 0.0, 0.0, 0.11]
    start, grasp = np.array([0.11]), np.array([0.03])
    for phase in (schedule.approach, schedule.lift):
        first = start if phase is schedule.approach else grasp
        for control in phase.controls(grasp, first)[0]:
            data.ctrl[:] = control
            mujoco.mj_step(built.model, data)
        target = grasp[0] + (0.0 if phase is schedule.approach else CONFIG.lift_height)
        assert data.qpos[7] == pytest.approx(target, abs=2e-5)


def test_lift_rises_by_the_lift_height_and_hold_keeps_it(schedule: Schedule) -> None:
    at = np.array([0.03])
    lift = schedule.lift.controls(at, at)
    assert lift[0, :, 1].sum() * DT == pytest.approx(CONFIG.lift_height, rel=1e-9)
    hold = schedule.hold.controls(at, at)
    np.testing.assert_allclose(hold[0, :, 0], 0.03 + CONFIG.lift_height)
    np.testing.assert_allclose(hold[0, :, 1], 0.0)


def test_only_the_push_pushes_and_its_ramp_is_linear(schedule: Schedule) -> None:
    for phase in (schedule.approach, schedule.close, schedule.lift, schedule.hold):
        assert not phase.force.any()
    force = schedule.push.force
    np.testing.assert_allclose(force[:, :2], 0.0)
    np.testing.assert_allclose(np.diff(force[:, 2]), -20.0 * CONFIG.push_ramp * DT)
    assert force[-1, 2] == pytest.approx(-20.0 * CONFIG.push_limit)


def test_fingers_can_cross_the_whole_stroke(schedule: Schedule) -> None:
    assert not schedule.approach.closing.any()
    assert schedule.close.closing.sum() * DT > 0.085


@pytest.mark.parametrize(
    "wrong",
    [
        {"look_interval": 0.0},
        {"push_direction": (0.0, 0.0, -2.0)},
        {"lift_time": -1.0},
        {"push_ramp": 0.0},
        {"hold_time": float("nan")},
    ],
)
def test_wrong_configurations_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ConfigError):
        TrialConfig(**wrong)  # type: ignore[arg-type]


def test_controls_of_some_steps_are_those_of_all(schedule: Schedule) -> None:
    grasp, start = np.array([0.02, 0.05]), np.array([0.1, 0.11])
    for phase in (schedule.approach, schedule.lift, schedule.push):
        whole = phase.controls(grasp, start)
        for first in range(0, len(phase), 7):
            part = phase.controls(grasp, start, slice(first, first + 7))
            np.testing.assert_array_equal(part, whole[:, first : first + 7])


def test_looks_are_as_far_apart_at_every_time_step() -> None:
    for timestep in (0.001, 0.002, 0.003, 0.004, 0.005):
        span = CONFIG.chunk(timestep) * timestep
        assert span == pytest.approx(CONFIG.look_interval, abs=0.5 * timestep)
    assert CONFIG.chunk(1.0) == 2
