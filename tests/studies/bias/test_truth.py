"""MuJoCo meets every closed form of the truth table, and a wrong force shows in it."""

from dataclasses import replace

import pytest

from gmdx.scenes.gripper import load_gripper
from gmdx.studies.engines.truth import truth_table


def test_mujoco_meets_the_closed_forms() -> None:
    rows = truth_table(["mujoco"])
    assert len(rows) == 28
    for row in rows:
        if row.unit == "N":
            assert row.ratio == pytest.approx(1.0, abs=0.05), row
        elif row.unit == "":
            assert row.measured == row.expected, row
        else:
            assert abs(row.error) < 0.5, row  # mm, mrad


@pytest.mark.parametrize("gripper_name", ["franka_hand", "robotiq_2f85"])
def test_closed_forms_hold_for_other_grippers(gripper_name: str) -> None:
    rows = truth_table(["mujoco"], gripper=load_gripper(gripper_name))
    assert len(rows) == 28
    for row in rows:
        if row.unit == "":
            assert row.measured == row.expected, row
        elif row.unit == "N" and "sideways" not in row.quantity:
            assert row.ratio == pytest.approx(1.0, abs=0.05), row


def test_what_a_gripper_cannot_open_to_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="gmdx")
    rows = truth_table(["mujoco"], gripper=replace(load_gripper(), stroke=0.055))
    assert 0 < len(rows) < 28
    assert "too wide for the gripper" in caplog.text


def test_weaker_fingers_show_as_less_than_expected() -> None:
    """The closed form takes the description's force: a model that presses otherwise deviates."""
    gripper = load_gripper()
    strong = {(r.quantity, r.setting): r for r in truth_table(["mujoco"], gripper=gripper)}
    weak = truth_table(["mujoco"], gripper=replace(gripper, force=0.5 * gripper.force))
    down = [r for r in weak if r.quantity == "push up"]
    for row in down:
        before = strong[row.quantity, row.setting]
        assert row.measured < before.measured
        assert row.ratio == pytest.approx(1.0, abs=0.05)


def test_every_engine_answers_every_case() -> None:
    pytest.importorskip("pybullet", reason="the second engine")
    rows = truth_table(["mujoco", "bullet"])
    cases = {b: [(r.quantity, r.setting) for r in rows if r.engine == b] for b in
             ("mujoco", "bullet")}  # fmt: skip
    assert cases["mujoco"] == cases["bullet"]
    pushes = [r for r in rows if r.engine == "bullet" and r.quantity == "push down"]
    assert all(r.measured == pytest.approx(r.expected, rel=0.1) for r in pushes)
