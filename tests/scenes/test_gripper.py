from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from gmdx.errors import GripperError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.gripper import load_gripper, shipped_grippers
from gmdx.trials.outcome import Outcome
from gmdx.trials.run import run_trials
from tests.support import box_object, resting_scene

# A user's gripper with other axes, signs and rest opening than the shipped ones: it approaches
# along its +x, closes along its y, and its joints open for positive positions.
SIDEWAYS_XML = """
<mujoco>
  <worldbody>
    <body name="wrist" pos="0.3 0.2 0.1" euler="20 0 40">
      <geom type="box" pos="0 0 0" size="0.02 0.05 0.02" mass="0.3"/>
      <body name="a" pos="0.07 -0.03 0">
        <joint name="ja" type="slide" axis="0 -1 0" range="-0.03 0"/>
        <geom name="pa" type="box" pos="0 -0.004 0" size="0.012 0.004 0.009" mass="0.02"/>
      </body>
      <body name="b" pos="0.07 0.03 0">
        <joint name="jb" type="slide" axis="0 1 0" range="-0.03 0"/>
        <geom name="pb" type="box" pos="0 0.004 0" size="0.012 0.004 0.009" mass="0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="ja"/></actuator>
</mujoco>
"""
SIDEWAYS = {
    "name": '"sideways"',
    "model": '"hand.xml"',
    "joints": '["ja", "jb"]',
    "pads": '["pa", "pb"]',
    "stroke": "0.06",
    "force": "15.0",
    "tool_point": "[0.07, 0.0, 0.0]",
    "closing_axis": "[0.0, 1.0, 0.0]",
    "approach_axis": "[1.0, 0.0, 0.0]",
}


def _write(folder: Path, xml: str = SIDEWAYS_XML, **changes: str | None) -> Path:
    lines = {key: value for key, value in (SIDEWAYS | changes).items() if value is not None}
    (folder / "hand.xml").write_text(xml)
    path = folder / "hand.toml"
    path.write_text("".join(f"{key} = {value}\n" for key, value in lines.items()))
    return path


def test_shipped_grippers_have_their_published_stroke_and_pads() -> None:
    assert shipped_grippers() == ("franka_hand", "parallel_jaw", "robotiq_2f85")
    assert load_gripper().name == "parallel_jaw"
    assert load_gripper("parallel_jaw").stroke == 0.085
    np.testing.assert_allclose(load_gripper("robotiq_2f85").pad_size, [0.022, 0.0375])
    assert load_gripper("robotiq_2f85").stroke == 0.085
    np.testing.assert_allclose(load_gripper("franka_hand").pad_size, [0.0175, 0.0175])
    assert load_gripper("franka_hand").stroke == 0.08
    for name in shipped_grippers():
        gripper = load_gripper(name)
        widths = np.array([0.0, 0.02, gripper.stroke])
        np.testing.assert_allclose(
            gripper.opening(gripper.finger_positions(widths)), widths, atol=1e-12
        )


def test_a_user_s_gripper_lifts_a_box(tmp_path: Path) -> None:
    gripper = load_gripper(_write(tmp_path))
    np.testing.assert_allclose(gripper.pad_size, [0.018, 0.024])
    assert gripper.gap == pytest.approx(0.06)
    grasp = PlanarGrasp(
        np.array([0]), np.array([[0.0, 0.0, 0.025]]), np.array([0.5]), np.array([0.055])
    )
    scene = resting_scene(box_object((0.03, 0.04, 0.05)), yaw=0.5)
    trials = run_trials(scene, grasp, gripper=gripper)
    assert np.all(trials.outcome == Outcome.SUCCESS)
    assert trials.opening[0] == pytest.approx(0.03, abs=3e-4)
    assert trials.push_force[0] == pytest.approx(2 * 0.8 * 15.0 - 0.981, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"force": None}, "missing fields"),
        ({"colour": '"red"'}, "unknown fields"),
        ({"pads": '["pa", "nothing"]'}, "no joint 'jb' or no geom 'nothing'"),
        ({"stroke": "0.2"}, "at most the 0.0600 m"),
        ({"tool_point": "[0.05, 0.0, 0.0]"}, "from the middle of the pads"),
        ({"closing_axis": "[0.0, 0.0, 1.0]"}, "does not slide along the closing axis"),
        ({"closing_axis": "[1.0, 0.0, 0.0]"}, "perpendicular unit vectors"),
        ({"model": '"missing.xml"'}, "must name an MJCF file"),
        ({"joints": '["ja"]'}, "must name two each"),
    ],
)
def test_a_wrong_description_is_refused_by_name(
    tmp_path: Path, changes: dict[str, str | None], message: str
) -> None:
    with pytest.raises(GripperError, match=message):
        load_gripper(_write(tmp_path, **changes))


def test_wrong_models_are_refused_by_name(tmp_path: Path) -> None:
    for old, new, message in [
        ('<joint name="ja" type="slide" axis="0 -1 0"', '<joint name="ja" axis="0 0 1"', "slide"),
        ('name="pa" type="box"', 'name="pa" type="ellipsoid"', "not a box"),
        ("</worldbody>", "<body><joint/><geom size='.1'/></body></worldbody>", "one root body"),
        ("</body>", "", "cannot read"),
    ]:
        with pytest.raises(GripperError, match=message):
            load_gripper(_write(tmp_path, SIDEWAYS_XML.replace(old, new, 1)))


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(GripperError, match="franka_hand, parallel_jaw, robotiq_2f85"):
        load_gripper("nope")


def test_every_shipped_description_names_its_source() -> None:
    for path in (files("gmdx_assets") / "grippers").iterdir():
        if path.name.endswith(".toml"):
            assert "source = " in path.read_text()
