"""The second engine gets what the first one gets, and calls its ends by the same names."""

import sys
from dataclasses import fields, replace
from importlib.metadata import version
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from gmdx.cli.main import main
from gmdx.dataset.read import read_dataset
from gmdx.errors import ConfigError, GripperError, UsageError
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.pipeline.generate import GenerateConfig, generate
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.scene import Scene
from gmdx.trials.engines import mujoco as first_engine
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import Snapshot, TrialResults
from gmdx.trials.run import run_trials
from tests.runs import small_config, write_meshes
from tests.support import box_object, mesh_object, resting_scene

pybullet = pytest.importorskip("pybullet", reason="the second engine is not installed")

from gmdx.trials.engines.bullet import engine as second_engine  # noqa: E402
from gmdx.trials.engines.bullet.world import BulletConfig  # noqa: E402
from gmdx.trials.observations import ChunkResult  # noqa: E402
from tests.trials.engines.bullet_rig import bullet_world, start, wait  # noqa: E402

BOX = (0.03, 0.04, 0.05)


def _grasp(
    center: tuple[float, float, float], angle: float = 0.0, width: float = 0.05
) -> PlanarGrasp:
    return PlanarGrasp(np.array([0]), np.array([center]), np.array([angle]), np.array([width]))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return resting_scene(box_object(BOX))


@pytest.fixture(scope="module")
def grasps() -> PlanarGrasp:
    rng = np.random.default_rng(3)
    center = np.column_stack([rng.uniform(-0.02, 0.02, (6, 2)), rng.uniform(0.012, 0.06, 6)])
    return PlanarGrasp(
        np.arange(6) * 7, center, rng.uniform(0, np.pi, 6), rng.uniform(0.055, 0.085, 6)
    )


class _Handed:
    """What an engine is handed, by phase, while it runs for real."""

    def __init__(self, module: object, monkeypatch: pytest.MonkeyPatch) -> None:
        self.starts: list[np.ndarray] = []
        self.controls: list[np.ndarray] = []
        self.forces: list[np.ndarray] = []
        step = module._Stepper.step  # type: ignore[attr-defined]

        def noted(
            engine: object,
            rows: np.ndarray,
            state: np.ndarray,
            control: np.ndarray,
            force: np.ndarray,
            count: np.ndarray,
        ) -> ChunkResult:
            self.starts += [row for row in state if row[0] == 0.0]
            self.controls += [control]
            self.forces += [force]
            found: ChunkResult = step(engine, rows, state, control, force, count)
            return found

        monkeypatch.setattr(module._Stepper, "step", noted)  # type: ignore[attr-defined]


def test_both_engines_are_handed_the_same_schedule(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    # No phase ends early, and no push before its ramp does.
    config = TrialConfig(still_speed=0.0, push_limit=1.0)
    handed = [_Handed(module, monkeypatch) for module in (first_engine, second_engine)]
    for engine in ("mujoco", "bullet"):
        trials = run_trials(
            scene, _grasp((0.001, 0.002, 0.025), 0.03), engine, trials=1, config=config
        )
        assert trials.push_force_is_lower_bound[0]
    for name in ("starts", "controls", "forces"):
        one, other = (np.concatenate(getattr(item, name), axis=-2 if name == "controls" else 0)
                      for item in handed)  # fmt: skip
        assert len(one) > 0
        np.testing.assert_array_equal(one, other)


def test_both_engines_start_from_the_same_perturbed_poses(
    scene: Scene, grasps: PlanarGrasp, monkeypatch: pytest.MonkeyPatch
) -> None:
    handed = [_Handed(module, monkeypatch) for module in (first_engine, second_engine)]
    trials = [run_trials(scene, grasps, engine) for engine in ("mujoco", "bullet")]
    starts = [np.stack(item.starts) for item in handed]
    assert starts[0].shape[0] == 30
    np.testing.assert_array_equal(starts[0], starts[1])
    for name in ("object_position", "object_quaternion", "tool_position"):
        one, other = (getattr(item, name)[:, Snapshot.START] for item in trials)
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("grasp", "outcome"),
    [
        (_grasp((0.0, 0.0, 0.025)), Outcome.SUCCESS),
        (_grasp((0.0, 0.1, 0.025)), Outcome.NO_CONTACT),
        (_grasp((0.02, 0.0, 0.025)), Outcome.COLLISION_IN_APPROACH),
        (_grasp((0.0, 0.1, 0.005)), Outcome.COLLISION_IN_APPROACH),
    ],
    ids=["held", "beside", "above", "table"],
)
def test_both_engines_agree_on_what_is_plain(
    scene: Scene, grasp: PlanarGrasp, outcome: Outcome
) -> None:
    trials = [run_trials(scene, grasp, engine) for engine in ("mujoco", "bullet")]
    for item in trials:
        assert np.all(item.outcome == outcome)
        assert np.all(item.collision == (outcome == Outcome.COLLISION_IN_APPROACH))
    np.testing.assert_allclose(trials[0].opening, trials[1].opening, atol=5e-4)
    for moment in (Snapshot.CLOSING, Snapshot.CLOSED, Snapshot.HELD):
        one, other = (item.object_position[:, moment] for item in trials)
        np.testing.assert_allclose(one, other, atol=1e-3)


def test_a_slippery_corner_is_knocked_away() -> None:
    scene = resting_scene(box_object(BOX, friction=0.3))
    grasp = _grasp((0.0, 0.024, 0.025), angle=0.6, width=0.06)
    assert run_trials(scene, grasp, "bullet", trials=1).outcome[0, 0] == Outcome.KNOCKED_AWAY


def test_too_heavy_to_lift_is_lost() -> None:
    heavy = resting_scene(box_object(BOX, mass=10.0))
    trials = run_trials(heavy, _grasp((0.0, 0.0, 0.025)), "bullet", trials=1)
    assert trials.outcome[0, 0] == Outcome.LOST_IN_LIFT
    assert trials.push_force[0] == 0.0


def test_diverged_simulation_is_named_and_measures_nothing(scene: Scene) -> None:
    slow = TrialConfig(mad_speed=0.05)
    trials = run_trials(scene, _grasp((0.0, 0.0, 0.025)), "bullet", config=slow)
    assert np.all(trials.outcome == Outcome.DIVERGED)
    assert np.isnan(trials.push_force[0])
    poisoned = replace(scene, position=scene.position * [1.0, np.nan, 1.0])
    trials = run_trials(poisoned, _grasp((0.0, 0.0, 0.025)), "bullet")
    assert np.all(trials.outcome == Outcome.DIVERGED)


def test_an_empty_batch_is_an_empty_result(scene: Scene) -> None:
    trials = run_trials(scene, _grasp((0.0, 0.0, 0.025))[:0], "bullet")
    assert trials.outcome.shape == (0, 5)
    assert trials.contacts.points.shape[0] == 0


def _arrays(trials: TrialResults) -> list[bytes]:
    found = []
    for field in fields(trials):
        value = getattr(trials, field.name)
        if isinstance(value, PadContacts):
            found += [value.points, value.normals, value.valid]
        elif isinstance(value, np.ndarray):
            found.append(value)
    return [array.tobytes() for array in found]


def test_a_trial_s_bytes_do_not_depend_on_what_ran_before(
    scene: Scene, grasps: PlanarGrasp
) -> None:
    trials = run_trials(scene, grasps, "bullet")
    assert len(np.unique(trials.outcome)) >= 2
    assert _arrays(trials) == _arrays(run_trials(scene, grasps, "bullet"))
    alone = [run_trials(scene, grasps[k : k + 1], "bullet") for k in (4, 0)]
    for k, item in zip((4, 0), alone, strict=True):
        assert item.outcome.tobytes() == trials.outcome[k : k + 1].tobytes()
        assert item.object_position.tobytes() == trials.object_position[k : k + 1].tobytes()
        assert item.push_force.tobytes() == trials.push_force[k : k + 1].tobytes()
        assert item.contacts.points.tobytes() == trials.contacts.points[k : k + 1].tobytes()


def test_all_hulls_are_there_and_where_they_belong() -> None:
    """A table of four legs: it rests on all of them, and on its top the other way up."""
    import trimesh

    legs = [
        trimesh.creation.box((0.01, 0.01, 0.03), trimesh.transformations.translation_matrix(at))
        for at in ((-0.03, -0.02, 0.0), (0.03, -0.02, 0.0), (-0.03, 0.02, 0.0), (0.03, 0.02, 0.0))
    ]
    top = trimesh.creation.box(
        (0.07, 0.05, 0.01), trimesh.transformations.translation_matrix((0.0, 0.0, 0.02))
    )
    parts = [*legs, top]
    obj = mesh_object(
        trimesh.boolean.union(parts), hulls=[np.asarray(part.vertices, float) for part in parts]
    )
    heights = -obj.vertices[:, 2].min(), obj.vertices[:, 2].max()
    for height, turn in zip(heights, ((1.0, 0, 0, 0), (0, 1.0, 0, 0)), strict=True):
        with bullet_world(obj) as world:
            world.reset(start((0.0, 0.0, height), turn))
            wait(world, 100)
            qpos, _ = world.state()
        np.testing.assert_allclose(qpos[:3], [0.0, 0.0, height], atol=2e-5)
        assert abs(abs(qpos[3:7] @ np.array(turn)) - 1.0) < 1e-6


_HAND = """
<mujoco>
  <asset><mesh name="wedge" vertex="{vertices}"/></asset>
  <worldbody>
    <body name="wrist" pos="0.3 0.2 0.1" euler="20 0 40">
      <geom type="cylinder" pos="-0.02 0 0" size="0.03 0.01" mass="0.3"/>
      {extra}
      <body name="a" pos="0.07 -0.03 0">
        <joint name="ja" type="slide" axis="0 -1 0" range="-0.03 0"/>
        <geom name="pa" type="box" pos="0 -0.004 0" size="0.012 0.004 0.009" mass="0.02"/>
        <geom type="capsule" fromto="-0.04 -0.004 0 0 -0.004 0" size="0.004" mass="0.01"/>
      </body>
      <body name="b" pos="0.07 0.03 0">
        <joint name="jb" type="slide" axis="0 1 0" range="-0.03 0"/>
        <geom name="pb" type="box" pos="0 0.004 0" size="0.012 0.004 0.009" mass="0.02"/>
        <body><geom type="mesh" mesh="wedge" pos="-0.02 0.012 0" mass="0.01"/></body>
        <geom type="sphere" pos="-0.04 0.004 0" size="0.006" mass="0.01"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def _hand(folder: Path, extra: str = "") -> Gripper:
    """Other axes, signs and shapes than the shipped grippers have."""
    corners = [(0, 0, 0), (0.02, 0, 0), (0, 0.01, 0), (0, 0, 0.01)]
    vertices = " ".join(str(value) for corner in corners for value in corner)
    (folder / "hand.xml").write_text(_HAND.format(vertices=vertices, extra=extra))
    (folder / "hand.toml").write_text(
        'name = "hand"\nmodel = "hand.xml"\njoints = ["ja", "jb"]\npads = ["pa", "pb"]\n'
        "stroke = 0.06\nforce = 15.0\ntool_point = [0.07, 0.0, 0.0]\n"
        "closing_axis = [0.0, 1.0, 0.0]\napproach_axis = [1.0, 0.0, 0.0]\n"
    )
    return load_gripper(folder / "hand.toml")


def test_a_user_s_gripper_of_every_shape_grasps(scene: Scene, tmp_path: Path) -> None:
    gripper = _hand(tmp_path)
    for engine in ("mujoco", "bullet"):
        trials = run_trials(scene, _grasp((0.0, 0.0, 0.025)), engine, trials=1, gripper=gripper)
        assert trials.outcome[0, 0] == Outcome.SUCCESS
        assert trials.opening[0] == pytest.approx(0.03, abs=3e-4)
        assert trials.push_force[0] == pytest.approx(2 * 0.8 * 15.0 - 0.981, rel=0.05)


def test_the_gripper_s_parts_are_where_mujoco_has_them(scene: Scene, tmp_path: Path) -> None:
    """The boxes around all of its parts, in both engines, with the fingers half closed."""
    import mujoco

    gripper = _hand(tmp_path)
    built = grasp_model(scene.object, gripper, scene.physics)
    qpos = start((0.0, 0.3, 0.025), height=0.2, fingers=gripper.finger_positions(np.array(0.03)))
    data = mujoco.MjData(built.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(built.model, data)
    mount = built.model.body("mount").id
    expected = []
    for geom in range(built.model.ngeom):
        if built.model.body_rootid[built.model.geom_bodyid[geom]] != mount:
            continue
        turn = data.geom_xmat[geom].reshape(3, 3)
        middle, half = np.split(built.model.geom_aabb[geom], 2)
        corners = middle + half * np.array(list(product((-1, 1), repeat=3)))
        corners = data.geom_xpos[geom] + corners @ turn.T
        expected.append([*corners.min(axis=0), *corners.max(axis=0)])
    with bullet_world(scene.object, gripper) as world:
        world.reset(qpos)
        found = [
            np.ravel(pybullet.getAABB(world.gripper, link, physicsClientId=world.client))
            for link, item in enumerate(world.links)
            if item.shape is not None
        ]
    # Bullet lists them in another order, and keeps 1 mm around hulls in its boxes, not in contacts.
    assert len(found) == len(expected) == 6
    for box in expected:
        gaps = [np.abs(other - box).max() for other in found]
        assert min(gaps) < 2e-3


def test_a_shape_that_bullet_does_not_know_is_named(scene: Scene, tmp_path: Path) -> None:
    gripper = _hand(tmp_path, '<geom name="egg" type="ellipsoid" size="0.01 0.02 0.01"/>')
    with pytest.raises(GripperError, match="gripper hand: geom 'gripper/egg' is a mjGEOM_ELLIPS"):
        run_trials(scene, _grasp((0.0, 0.0, 0.025)), "bullet", gripper=gripper)


def test_wrong_configurations_are_refused() -> None:
    with pytest.raises(ConfigError, match="substeps must be positive"):
        BulletConfig(substeps=0)


def test_a_dataset_records_the_engine(tmp_path: Path) -> None:
    config = replace(small_config(tmp_path / "cache"), engine="bullet")
    generate(write_meshes(tmp_path, 1), tmp_path / "out", config)
    dataset = read_dataset(tmp_path / "out")
    assert dataset.info["engine"] == "bullet"
    assert dataset.info["packages"]["pybullet"] == version("pybullet")
    assert np.any(dataset.grasps().column("sim_success").to_numpy() > 0)


def test_without_pybullet_one_line_says_what_to_install(
    scene: Scene,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)  # as if it were not installed
    for module in ("bullet.engine", "bullet.world", "bullet"):
        monkeypatch.delitem(sys.modules, f"gmdx.trials.engines.{module}")
    monkeypatch.delattr("gmdx.trials.engines.bullet")
    with pytest.raises(UsageError, match=r"pip install 'gmdx\[bullet\]'.* Python up to 3\.11"):
        run_trials(scene, _grasp((0.0, 0.0, 0.025)), "bullet")
    with pytest.raises(UsageError, match=r"gmdx\[bullet\]"):
        generate(["bundled:cup"], tmp_path / "out", GenerateConfig(engine="bullet"))
    assert main(["bench", "trials", "bundled:cup", "--engine", "bullet"]) != 0
    error = capsys.readouterr().err
    assert "gmdx[bullet]" in error
    assert "Traceback" not in error
