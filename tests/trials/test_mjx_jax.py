"""Trials in JAX against C MuJoCo, closed forms, and the laws of batches."""

import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import rollout

pytest.importorskip("jax")

from gmdx.errors import DeviceMemoryError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.build import GraspModel, PhysicsConfig, grasp_model
from gmdx.scenes.gripper import load_gripper
from gmdx.studies.machine import compilations
from gmdx.trials import mjx_jax
from gmdx.trials.frames import Stretch, digest
from gmdx.trials.mjx_jax import JaxWorlds
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.run import Chosen, run_trials
from tests.support import box_object, resting_scene

JAX = Chosen("mjx", "jax")
STEPS = 20
MOST = 16  # trials of a call on a CPU
GRAVITY = 9.81


def _model(extents: tuple[float, float, float], **options: object) -> GraspModel:
    return grasp_model(box_object(extents, **options), load_gripper(), PhysicsConfig())


@pytest.fixture(scope="module")
def models() -> list[GraspModel]:
    return [
        _model((0.03, 0.04, 0.05)),
        _model((0.02, 0.05, 0.03), mass=0.3),
        _model((0.04, 0.04, 0.04), friction=0.4),
    ]


@pytest.fixture(scope="module")
def worlds(models: list[GraspModel]) -> JaxWorlds:
    return JaxWorlds(models, capacity=MOST)


def _start(models: list[GraspModel], index: np.ndarray, *, spread: float, seed: int) -> np.ndarray:
    """Objects on the table somewhere between the open fingers, turned about the vertical."""
    rng = np.random.default_rng(seed)
    gripper, count = models[0].gripper, len(index)
    state = np.zeros((count, 20))
    state[:, 1:3] = rng.uniform(-spread, spread, (count, 2))
    for row, k in enumerate(index):
        m, data = models[k].model, mujoco.MjData(models[k].model)
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        mujoco.mj_kinematics(m, data)
        geom = next(g for g in range(m.ngeom) if m.geom_bodyid[g] == models[k].object_body)
        corners = data.geom_xpos[geom] + m.mesh_vert @ data.geom_xmat[geom].reshape(3, 3).T
        state[row, 3] = -corners[:, 2].min() - 1e-6  # about as deep as it rests
    angle = rng.uniform(0, np.pi, count) * (spread > 0)
    state[:, 4], state[:, 7] = np.cos(angle / 2), np.sin(angle / 2)
    state[:, 8] = 0.02
    fingers = [1 + address for address in models[0].finger_qpos]
    state[:, fingers] = gripper.finger_positions(np.full(count, 0.07))
    return state


def _closing(count: int) -> np.ndarray:
    control = np.zeros((count, STEPS, 3))
    control[..., 0], control[..., 2] = 0.02, 0.3
    return control


def _chunks(worlds: JaxWorlds, index: np.ndarray, state: np.ndarray, count: int) -> list[Stretch]:
    found = []
    whole = np.full(len(index), STEPS)
    for _ in range(count):
        control, force = _closing(len(index)), np.zeros((STEPS, 3))
        found.append(worlds.launch(index, state, control, force, whole)())
        state = found[-1].state
    return found


def _same(one: Stretch, other: Stretch, rows: slice | np.ndarray) -> None:
    for name in ("state", "qpos_at_sensors", "sensors", "failed", "overflowed"):
        np.testing.assert_array_equal(getattr(one, name)[rows], getattr(other, name), name)
    for name, value in vars(one.steps).items():
        np.testing.assert_array_equal(value[rows], getattr(other.steps, name), name)


def test_states_sensors_and_digests_of_centred_closing_are_those_of_mujoco(
    worlds: JaxWorlds, models: list[GraspModel]
) -> None:
    index = np.array([0, 1, 2])
    state = _start(models, index, spread=0.0, seed=0)
    found = _chunks(worlds, index, state, 4)
    for row, k in enumerate(index):
        m, layout = models[k].model, models[k].sensors
        begin = state[row : row + 1]
        for chunk in found:
            states, sensors = rollout.rollout(
                m,
                mujoco.MjData(m),
                begin,
                _closing(1),
                control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
                initial_warmstart=np.zeros((1, m.nv)),
            )
            begin = states[:, -1]
            np.testing.assert_allclose(chunk.state[row], states[0, -1], atol=1e-6)
            np.testing.assert_allclose(chunk.qpos_at_sensors[row], states[0, -2, 1:11], atol=1e-6)
            expected = digest(states[..., 1:11], states[..., 11:], sensors, layout)
            for name, value in vars(expected).items():
                got = getattr(chunk.steps, name)[row]
                np.testing.assert_allclose(got, value[0], atol=1e-5, err_msg=name)
            counts = [layout.pads[0].start, layout.pads[1].start, layout.hand, layout.hand_table]
            np.testing.assert_array_equal(chunk.sensors[row, counts], sensors[0, -1, counts])
            for pad in layout.pads:
                slots = [
                    s[pad].reshape(layout.slots, -1) for s in (chunk.sensors[row], sensors[0, -1])
                ]
                by_place = [rows[np.lexsort(np.round(rows[:, 5:8], 4).T)] for rows in slots]
                np.testing.assert_allclose(by_place[0], by_place[1], atol=1e-3)
        assert found[-1].sensors[row, layout.pads[0].start] == 4


def test_most_scattered_closings_end_where_mujoco_s_do(
    worlds: JaxWorlds, models: list[GraspModel]
) -> None:
    index = np.arange(24) % 3
    state = _start(models, index, spread=0.01, seed=1)
    found = _chunks(worlds, index, state, 4)[-1]
    assert not np.any(found.failed | found.overflowed)
    away = []
    for row, k in enumerate(index):
        m = models[k].model
        states, _ = rollout.rollout(
            m,
            mujoco.MjData(m),
            state[row : row + 1],
            np.tile(_closing(1), (1, 4, 1)),
            control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
        )
        away.append(np.linalg.norm(states[0, -1, 1:4] - found.state[row, 1:4]))
    assert np.median(away) < 1e-4  # knocks at corners amplify what engines make of them


def test_trials_stop_after_their_own_last_step(worlds: JaxWorlds, models: list[GraspModel]) -> None:
    index = np.zeros(4, int)
    state = _start(models, index, spread=0.0, seed=2)
    control, force = _closing(4), np.zeros((STEPS, 3))
    count = np.array([STEPS, 7, 1, 0])
    found = worlds.launch(index, state, control, force, count)()
    for row, steps in enumerate(count[:3]):
        one = slice(row, row + 1)
        m = models[0].model
        states, sensors = rollout.rollout(
            m,
            mujoco.MjData(m),
            state[one],
            control[one, :steps],
            control_spec=int(mujoco.mjtState.mjSTATE_CTRL),
            initial_warmstart=np.zeros((1, m.nv)),
        )
        np.testing.assert_allclose(found.state[row], states[0, -1], atol=1e-6)
        np.testing.assert_array_equal(found.sensors[row, -3:], sensors[0, -1, -3:])
    np.testing.assert_array_equal(found.state[3], state[3])


def test_mixed_and_separate_launches_agree_to_the_last_bit(
    worlds: JaxWorlds, models: list[GraspModel]
) -> None:
    index = np.arange(12) % 3
    state = _start(models, index, spread=0.01, seed=3)
    mixed = _chunks(worlds, index, state, 3)[-1]
    for k in range(3):
        own = JaxWorlds([models[k]], capacity=MOST)
        rows = np.flatnonzero(index == k)
        alone = _chunks(own, np.zeros(len(rows), int), state[rows], 3)[-1]
        _same(mixed, alone, rows)


def test_more_trials_than_a_call_holds_change_no_bit(
    worlds: JaxWorlds, models: list[GraspModel]
) -> None:
    index = np.arange(MOST + 5) % 3
    state = _start(models, index, spread=0.01, seed=4)
    whole = _chunks(worlds, index, state, 1)[-1]
    rows = np.array([3, MOST + 2])
    _same(whole, _chunks(worlds, index[rows], state[rows], 1)[-1], rows)


def test_ten_objects_and_every_phase_share_one_compilation() -> None:
    sizes = np.random.default_rng(5).uniform(0.02, 0.045, (10, 3))
    config = TrialConfig(trials=1)
    grasp = PlanarGrasp(np.array([0]), np.array([[0.0, 0.0, 0.01]]), np.zeros(1), np.array([0.06]))
    before = compilations(JAX)
    assert before is not None
    for number, size in enumerate(sizes):
        box = box_object((float(size[0]), float(size[1]), float(size[2])))
        scene = resting_scene(box, scene_id=number)
        run_trials(scene, grasp, "mjx", impl="jax", config=config)
    after = compilations(JAX)
    assert after is not None
    found = after.since(before)
    assert found.compiled + found.cached <= 1


@pytest.mark.parametrize(("friction", "mass"), [(0.8, 0.1), (0.3, 0.5)])
def test_squeezed_box_is_pushed_out_at_twice_the_friction_limit(
    friction: float, mass: float
) -> None:
    scene = resting_scene(box_object((0.03, 0.04, 0.05), friction=friction, mass=mass))
    middle = PlanarGrasp(
        np.array([0]), np.array([[0.0, 0.0, 0.025]]), np.zeros(1), np.full(1, 0.05)
    )
    for direction in (-1.0, 1.0):
        config = TrialConfig(trials=1, push_direction=(0.0, 0.0, direction))
        trials = run_trials(scene, middle, "mjx", impl="jax", config=config)
        expected = 2 * friction * load_gripper().force + direction * mass * GRAVITY
        assert trials.outcome[0, 0] == Outcome.SUCCESS
        assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


@pytest.mark.slow
def test_single_precision_holds_the_closed_form_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def single(models: list[GraspModel], *, capacity: int, config: TrialConfig) -> JaxWorlds:
        del config
        return JaxWorlds(models, capacity=capacity, double=False)

    monkeypatch.setattr(mjx_jax, "open_worlds", single)
    scene = resting_scene(box_object((0.03, 0.04, 0.05)))
    center = np.array([[0.0, 0.0, 0.025]])
    middle = PlanarGrasp(np.array([0]), center, np.zeros(1), np.array([0.05]))
    trials = run_trials(scene, middle, "mjx", impl="jax", trials=1)
    expected = 2 * 0.8 * load_gripper().force - 0.1 * GRAVITY
    assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


def test_what_is_not_finite_is_a_named_failure(worlds: JaxWorlds, models: list[GraspModel]) -> None:
    state = _start(models, np.zeros(2, int), spread=0.0, seed=0)
    state[1, 11] = 1e308
    force = np.full((STEPS, 3), 0.0)
    found = worlds.launch(np.zeros(2, int), state, _closing(2), force, np.full(2, STEPS))()
    assert found.failed.tolist() == [False, True]
    assert np.isfinite(found.state[0]).all()


@pytest.mark.slow
def test_more_contacts_than_there_is_room_for_are_said(
    models: list[GraspModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mjx_jax, "_CONTACTS", 6)  # two pads on a box have eight
    small = JaxWorlds(models[:1], capacity=MOST)
    index = np.zeros(1, int)
    found = _chunks(small, index, _start(models, index, spread=0.0, seed=0), 3)
    assert not found[0].overflowed[0]
    assert found[-1].overflowed[0]


def test_an_exhausted_device_is_named(
    worlds: JaxWorlds, models: list[GraspModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    import jax

    def exhausted(*_: object) -> None:
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory")

    monkeypatch.setattr(mjx_jax, "compiled_chunk", lambda *_: exhausted)
    state = _start(models, np.zeros(1, int), spread=0.0, seed=0)
    with pytest.raises(DeviceMemoryError):
        worlds.launch(np.zeros(1, int), state, _closing(1), np.zeros((STEPS, 3)), np.ones(1, int))()


def test_objects_of_several_buckets_are_refused(models: list[GraspModel]) -> None:
    from tests.support import cylinder_object

    other = grasp_model(cylinder_object(0.02, 0.04), load_gripper(), PhysicsConfig())
    with pytest.raises(UsageError, match="must share one bucket"):
        JaxWorlds([models[0], other], capacity=4)


_ON_DEVICES = """
import sys
import numpy as np
import jax
from gmdx.trials.mjx_jax import JaxWorlds
from tests.trials.test_mjx_jax import JAX, MOST, _chunks, _model, _start, compilations

models = [_model((0.03, 0.04, 0.05)), _model((0.02, 0.05, 0.03))]
index = np.arange(8) % 2
before = compilations(JAX)
worlds = JaxWorlds(models, capacity=MOST)
found = _chunks(worlds, index, _start(models, index, spread=0.01, seed=6), 2)[-1]
made = compilations(JAX).since(before)
np.savez(sys.argv[1], state=found.state, sensors=found.sensors, devices=len(jax.devices()),
         compiled=made.compiled, cached=made.cached)
"""


def _in_a_process(folder: Path, name: str, *, devices: int) -> dict[str, np.ndarray]:
    file = folder / f"{name}.npz"
    flags = f"--xla_force_host_platform_device_count={devices}"
    environment = os.environ | {
        "XLA_FLAGS": flags,
        "JAX_PLATFORMS": "cpu",
        "GMDX_CACHE": str(folder / "cache"),
    }
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-c", _ON_DEVICES, str(file)]
    root = Path(__file__).parents[2]
    subprocess.run(command, env=environment, cwd=root, check=True, timeout=300)
    with np.load(file) as found:
        return dict(found)


@pytest.mark.slow
def test_two_devices_give_the_same_and_a_second_process_compiles_nothing(tmp_path: Path) -> None:
    one = _in_a_process(tmp_path, "one", devices=1)
    again = _in_a_process(tmp_path, "again", devices=1)
    two = _in_a_process(tmp_path, "two", devices=2)
    assert [int(found["devices"]) for found in (one, again, two)] == [1, 1, 2]
    assert one["compiled"] == two["compiled"] == 1
    assert again["compiled"] == 0
    assert again["cached"] >= 1
    for name in ("state", "sensors"):
        np.testing.assert_array_equal(one[name], again[name])
        np.testing.assert_allclose(one[name], two[name], atol=1e-9)
