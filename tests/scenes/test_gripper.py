from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from gmdx.errors import GripperError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import gripper_record, load_gripper, save_gripper, shipped_grippers
from gmdx.scenes.physics import PhysicsConfig
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


def _write_with_meshes(folder: Path, left: str, right: str, compiler: str = "") -> Path:
    """The gripper with a mesh in each finger, which nothing touches."""
    for size, file in ((0.004, left), (0.006, right)):
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        trimesh.creation.box((size, size, size)).export(path)
    xml = SIDEWAYS_XML.replace(
        "<worldbody>",
        f'{compiler}<asset><mesh name="ma" file="{left}"/><mesh name="mb" file="{right}"/></asset>'
        "<worldbody>",
    )
    for side in "ab":
        mesh = f'<geom type="mesh" mesh="m{side}" mass="0.001" pos="-0.03 0 0"/>'
        xml = xml.replace(f'<joint name="j{side}" ', f'{mesh}<joint name="j{side}" ')
    return _write(folder, xml)


@pytest.mark.parametrize("name", ["franka_hand", "parallel_jaw", "robotiq_2f85", "own"])
def test_saved_grippers_are_the_same_elsewhere(tmp_path: Path, name: str) -> None:
    here = tmp_path / "here"
    here.mkdir()
    own = name == "own"
    path = _write_with_meshes(here, "l/z.stl", "r/a.stl") if own else name
    gripper = load_gripper(path)
    assert list(gripper.files) == (["a.stl", "z.stl"] if own else [])
    save_gripper(gripper, tmp_path / "there" / "gripper.toml")
    if own:
        here.rename(tmp_path / "gone")
        mujoco.MjModel.from_xml_path(str(tmp_path / "there" / "hand.xml"))  # for anyone else
    again = load_gripper(tmp_path / "there" / "gripper.toml")
    assert gripper_record(again) == gripper_record(gripper)
    assert again.description == gripper.description
    save_gripper(again, tmp_path / "further" / "g.toml")
    assert gripper_record(load_gripper(tmp_path / "further" / "g.toml")) == gripper_record(gripper)


def test_a_gripper_with_meshes_gets_into_a_trial_s_model(tmp_path: Path) -> None:
    gripper = load_gripper(_write_with_meshes(tmp_path, "l/z.stl", "r/a.stl"))
    model = grasp_model(box_object((0.03, 0.04, 0.05)), gripper, PhysicsConfig()).model
    extents = sorted(np.ptp(model.mesh_vert[first : first + 8, 0]) for first in
                     model.mesh_vertadr[model.mesh_vertnum == 8])  # fmt: skip
    assert any(extent == pytest.approx(0.004) for extent in extents)
    assert any(extent == pytest.approx(0.006) for extent in extents)


def test_files_are_where_the_model_says_or_alone_of_their_name(tmp_path: Path) -> None:
    path = _write_with_meshes(tmp_path, "z.stl", "a.stl", '<compiler meshdir="meshes"/>')
    (tmp_path / "backup").mkdir()
    (tmp_path / "z.stl").rename(tmp_path / "backup" / "z.stl")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "a.stl").rename(tmp_path / "meshes" / "a.stl")
    (tmp_path / "backup" / "a.stl").write_bytes(b"an older one")
    (tmp_path / "backup" / "unused.stl").write_bytes(b"of no concern")
    gripper = load_gripper(path)
    assert gripper.files["a.stl"] == (tmp_path / "meshes" / "a.stl").read_bytes()
    assert set(gripper.files) == {"a.stl", "z.stl"}
    save_gripper(gripper, tmp_path / "saved" / "gripper.toml")
    saved = {str(p.relative_to(tmp_path / "saved")) for p in (tmp_path / "saved").rglob("*.*")}
    assert saved == {"gripper.toml", "hand.xml", "meshes/a.stl", "meshes/z.stl"}
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "z.stl").write_bytes(b"which of them?")
    with pytest.raises(GripperError, match=r"z\.stl may be any of backup/z\.stl, other/z\.stl"):
        load_gripper(path)


def test_files_that_mujoco_cannot_tell_apart_are_refused(tmp_path: Path) -> None:
    with pytest.raises(GripperError, match=r"l/f\.stl and to r/f\.stl.*rename one"):
        load_gripper(_write_with_meshes(tmp_path, "l/f.stl", "r/f.stl"))


def test_a_saved_gripper_stays_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    path = _write_with_meshes(tmp_path / "a", "../up.stl", "a.stl")
    save_gripper(load_gripper(path), tmp_path / "b" / "c" / "gripper.toml")
    saved = {p.name for p in (tmp_path / "b" / "c").iterdir()}
    assert saved == {"gripper.toml", "hand.xml", "up.stl", "a.stl"}
    assert [p.name for p in (tmp_path / "b").iterdir()] == ["c"]
    path.write_text(path.read_text().replace("hand.xml", "../a/hand.xml"))
    with pytest.raises(GripperError, match="must name an MJCF file beside it"):
        load_gripper(path)


def test_a_gripper_that_was_changed_is_not_saved_as_another(tmp_path: Path) -> None:
    with pytest.raises(GripperError, match="was changed after it was loaded"):
        save_gripper(replace(load_gripper(), stroke=0.05), tmp_path / "gripper.toml")


def test_unknown_names_list_the_known_ones() -> None:
    with pytest.raises(GripperError, match="franka_hand, parallel_jaw, robotiq_2f85"):
        load_gripper("nope")


def test_every_shipped_description_names_its_source() -> None:
    for path in (files("gmdx_assets") / "grippers").iterdir():
        if path.name.endswith(".toml"):
            assert "source = " in path.read_text()
