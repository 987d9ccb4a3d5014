"""MuJoCo Warp against C MuJoCo, chunk by chunk, on states that real trials go through."""

import logging
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import mujoco
import numpy as np
import pytest
import trimesh

pytest.importorskip("warp", reason="Warp is not installed")

import mujoco.mjx.third_party.mujoco_warp as mjw
import warp as wp
from mujoco import rollout

from gmdx.errors import DeviceMemoryError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.machine.devices import cuda_devices
from gmdx.objects.model import ObjectModel
from gmdx.objects.prepare import prepare
from gmdx.objects.sources import resolve
from gmdx.scenes.build import grasp_model
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.layout import GraspModel
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.settle import settle
from gmdx.trials import observations
from gmdx.trials.engines import open_engine
from gmdx.trials.engines.mujoco import MujocoEngine, _Stepper
from gmdx.trials.engines.warp import kernels
from gmdx.trials.engines.warp.device import device_memory
from gmdx.trials.engines.warp.edges import EdgeContacts
from gmdx.trials.engines.warp.library import SLOTS, build_library, slots_for
from gmdx.trials.engines.warp.log import kernel_counts
from gmdx.trials.engines.warp.worlds import CONTACT_LIMIT, WarpWorlds, bytes_per_trial, version
from gmdx.trials.execute import Execution
from gmdx.trials.observations import ChunkResult
from gmdx.trials.placement import place
from gmdx.trials.protocol import TrialConfig
from tests.support import box_object, cylinder_object, mesh_object, resting_scene

ON_CPU = pytest.mark.skipif(
    cuda_devices() > 0, reason="on a GPU the order of contacts, and so the last bits, may differ"
)
PHYSICS = PhysicsConfig()
CONFIG = TrialConfig()
STEPS = CONFIG.chunk(PHYSICS.timestep)
NAMES = ("hammer", "bottle", "bracket")


@dataclass(frozen=True)
class Chunk:
    """What an engine was asked, and what C MuJoCo answered."""

    state: np.ndarray
    control: np.ndarray  # padded to a whole chunk
    force: np.ndarray
    count: np.ndarray
    found: ChunkResult
    qpos: np.ndarray  # (n, s, q) after each step
    qvel: np.ndarray
    sensors: np.ndarray


class Tap(_Stepper):
    """C MuJoCo, taking notes."""

    def __init__(self, scene: GraspModel, pool: rollout.Rollout) -> None:
        super().__init__(scene, pool, 1)
        self.notes: list[Chunk] = []

    def step(self, rows, state, control, force, count):  # type: ignore[no-untyped-def]
        found = super().step(rows, state, control, force, count)
        states, sensors = _rollout(self, state, control, force)
        missing = STEPS - control.shape[1]
        nq = self.size[0]
        self.notes.append(
            Chunk(
                state=state.copy(),
                control=np.pad(control, ((0, 0), (0, missing), (0, 0)), mode="edge"),
                force=np.pad(force, ((0, missing), (0, 0))),
                count=count.copy(),
                found=found,
                qpos=states[..., 1 : 1 + nq],
                qvel=states[..., 1 + nq :],
                sensors=sensors,
            )
        )
        return found


def _rollout(engine: _Stepper, state, control, force):  # type: ignore[no-untyped-def]
    model = engine.scene.model
    forces = np.zeros((*control.shape[:2], model.nbody, 6))
    forces[:, :, engine.scene.object_body, :3] = force
    given = np.concatenate([control, forces.reshape(*control.shape[:2], -1)], axis=2)
    spec = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED
    warm = np.zeros((len(state), model.nv))
    return engine.pool.rollout(
        model, engine.data, state, given, control_spec=int(spec), initial_warmstart=warm
    )


@pytest.fixture(scope="module")
def models() -> list[GraspModel]:
    gripper = load_gripper()
    objects = [prepare(resolve([f"bundled:{name}"])[0]) for name in NAMES]
    return [grasp_model(obj, gripper, PHYSICS) for obj in objects]


@pytest.fixture(scope="module")
def chunks() -> list[list[Chunk]]:
    """Of each object, the chunks of six grasps' trials on C MuJoCo."""
    gripper, found = load_gripper(), []
    for name in NAMES:
        scene = settle(prepare(resolve([f"bundled:{name}"])[0]), 0)
        grasps = sample_grasps(scene, 6)
        batch = place(scene, grasps, trials=1, gripper=gripper, config=CONFIG)
        with rollout.Rollout(nthread=1) as pool:
            tap = Tap(grasp_model(scene.object, gripper, PHYSICS), pool)
            Execution(tap, [batch], CONFIG).run([batch.schedule(CONFIG)])
        found.append(tap.notes)
    return found


@pytest.fixture(scope="module")
def worlds(models: list[GraspModel]) -> WarpWorlds:
    return WarpWorlds(models, capacity=128, physics=PHYSICS)


@dataclass(frozen=True)
class Mixed:
    """Trials of all objects in the middle of closing, some with fewer steps."""

    index: np.ndarray
    state: np.ndarray
    control: np.ndarray
    force: np.ndarray
    count: np.ndarray

    def launch(self, worlds: WarpWorlds, rows: np.ndarray | slice = slice(None)) -> ChunkResult:
        arrays = self.index[rows], self.state[rows], self.control[rows]
        return worlds.launch(*arrays, self.force, self.count[rows])()


@pytest.fixture(scope="module")
def mixed(chunks: list[list[Chunk]]) -> Mixed:
    closing = [notes[3] for notes in chunks]
    count = np.concatenate([chunk.count for chunk in closing])
    count[::3] = 13
    force = np.zeros((STEPS, 3))
    force[:, 2] = -0.3
    return Mixed(
        index=np.repeat(np.arange(len(closing)), [len(chunk.count) for chunk in closing]),
        state=np.concatenate([chunk.state for chunk in closing]),
        control=np.concatenate([chunk.control for chunk in closing]),
        force=force,
        count=count,
    )


def _bytes(found: ChunkResult, count: np.ndarray) -> list[bytes]:
    """Each trial's numbers, its steps up to its count."""
    whole = [getattr(found, item.name) for item in fields(found) if item.name != "steps"]
    steps = [getattr(found.steps, item.name) for item in fields(found.steps)]
    return [
        b"".join([a[i].tobytes() for a in whole] + [a[i, : count[i]].tobytes() for a in steps])
        for i in range(len(count))
    ]


def _launched(
    worlds: WarpWorlds, chunks: list[list[Chunk]]
) -> Iterator[tuple[int, Chunk, ChunkResult]]:
    """Every chunk's object and what Warp makes of it; those with the same force side by side."""
    groups: dict[bytes, list[tuple[int, Chunk]]] = defaultdict(list)
    for index, notes in enumerate(chunks):
        for chunk in notes:
            groups[chunk.force.tobytes()].append((index, chunk))
    for group in groups.values():
        sizes = [len(chunk.count) for _, chunk in group]
        index = np.repeat([index for index, _ in group], sizes)
        state, control, count = (
            np.concatenate([getattr(chunk, name) for _, chunk in group])
            for name in ("state", "control", "count")
        )
        found = [
            worlds.launch(index[part], state[part], control[part], group[0][1].force, count[part])()
            for part in np.split(np.arange(len(index)), range(128, len(index), 128))
        ]
        whole, stops = observations.joined(found), np.cumsum(sizes)
        for (number, chunk), stop, size in zip(group, stops, sizes, strict=True):
            yield number, chunk, _rows(whole, slice(stop - size, stop))


def _rows(found: ChunkResult, rows: slice) -> ChunkResult:
    whole = {f.name: getattr(found, f.name)[rows] for f in fields(found) if f.name != "steps"}
    steps = {f.name: getattr(found.steps, f.name)[rows] for f in fields(found.steps)}
    return ChunkResult(**whole, steps=type(found.steps)(**steps))


def test_chunks_of_real_trials_agree_with_c(
    worlds: WarpWorlds, models: list[GraspModel], chunks: list[list[Chunk]]
) -> None:
    nq = models[0].model.nq
    shift, turn, flags = [], [], []
    for index, chunk, found in _launched(worlds, chunks):
        expected, steps = chunk.found, chunk.count[0]
        assert found.state.shape == (len(chunk.count), 1 + nq + models[index].model.nv)
        assert not found.overflowed.any()
        assert not found.failed.any()
        assert found.state[:, 0] == pytest.approx(expected.state[:, 0])
        shift.append(np.abs(found.state[:, 1:4] - expected.state[:, 1:4]).max(axis=1))
        dot = np.abs(np.sum(found.state[:, 4:8] * expected.state[:, 4:8], axis=1))
        turn.append(2 * np.arccos(np.clip(dot, 0, 1)))
        near = np.abs(found.qpos_at_sensors - expected.qpos_at_sensors).max(axis=1) < 1e-4
        for name in ("collides", "touches", "presses"):
            a, b = getattr(found.steps, name), getattr(expected.steps, name)
            flags.append((a[:, :steps] == b[:, :steps])[near].ravel())
    moved, turned = np.concatenate(shift), np.concatenate(turn)
    assert len(moved) > 150
    # A contact that is there one step earlier or later sends a few trials another way.
    assert np.median(moved) < 1e-6
    assert np.mean(moved < 1e-5) > 0.9
    assert np.median(turned) < 1e-3
    assert np.mean(np.concatenate(flags)) > 0.995


def test_a_closing_grip_agrees_with_c_to_ten_micrometres(
    worlds: WarpWorlds, models: list[GraspModel], chunks: list[list[Chunk]]
) -> None:
    """Once an object is held, nothing is left to chance."""
    nq = models[0].model.nq
    for index, notes in enumerate(chunks):
        held = next(c for c in notes if c.found.steps.presses.all() and len(c.count) >= 2)
        rows = np.full(len(held.count), index)
        found = worlds.launch(rows, held.state, held.control, held.force, held.count)()
        difference = np.abs(found.state[:, 1 : 1 + nq] - held.found.state[:, 1 : 1 + nq])
        assert difference[:, :3].max() < 1e-5
        assert difference[:, 3:7].max() < 1e-3
        assert difference[:, 7:].max() < 1e-5
        force, expected = (
            [slots[..., 1].sum(axis=-1) for slots in observations.pad_slots(s, models[0].sensors)]
            for s in (found.sensors, held.found.sensors)
        )
        for side in (0, 1):
            assert force[side] == pytest.approx(expected[side], rel=0.02)


def test_the_kernel_observes_what_observe_does(
    models: list[GraspModel], chunks: list[list[Chunk]]
) -> None:
    layout = models[0].sensors
    chosen = [chunk for notes in chunks for chunk in notes if (chunk.count == STEPS).all()]
    qpos, qvel, sensors = (
        np.concatenate([getattr(chunk, name) for chunk in chosen]).astype(np.float32)
        for name in ("qpos", "qvel", "sensors")
    )
    qvel[0, 3, 4] = qvel[1, 2, 0] = np.inf
    qpos[2, 1, 5] = np.nan
    expected = observations.observe(
        *(values.astype(float) for values in (qpos, qvel, sensors)), layout
    )
    assert expected.collides.any()
    assert not expected.collides.all()
    n, nq, nv, nsensor = len(qpos), qpos.shape[2], qvel.shape[2], sensors.shape[2]
    with wp.ScopedDevice("cpu"):
        flags = wp.zeros((n, STEPS), dtype=int)
        motion = wp.zeros((n, STEPS, kernels.MOTION), dtype=float)
        none, last = wp.zeros(max(n, 2), dtype=int), wp.zeros((n, nq + nv), dtype=float)
        count = wp.full(n, STEPS, dtype=int)
        for step in range(STEPS):
            numbers = [step, count, nq, nv, nsensor, layout.pads[0].start, layout.pads[1].start]
            numbers += [layout.slots, 11, layout.hand, layout.hand_table, observations.FACE_COSINE]
            at = [wp.array(a[:, step].copy(), dtype=float) for a in (qpos, qvel, sensors)]
            wp.launch(
                kernels.observe,
                dim=n,
                inputs=[*numbers, *at, none, none, none],
                outputs=[flags, motion, last, wp.zeros((n, nsensor), dtype=float), none, none],
            )
        bits, numbers = flags.numpy(), motion.numpy()
    for bit, name in ((1, "collides"), (2, "touches"), (4, "presses")):
        assert np.array_equal((bits & bit) != 0, getattr(expected, name)), name
    assert np.array_equal(numbers[..., 0], expected.speed)
    assert np.isinf([numbers[0, 3, 0], numbers[1, 2, 0], numbers[2, 1, 0]]).all()
    assert np.allclose(numbers[..., 1:4], expected.offset, rtol=0, atol=1e-7, equal_nan=True)
    assert np.array_equal(numbers[..., 4:7], expected.velocity)
    assert np.array_equal(numbers[..., 7], expected.rise)


@ON_CPU
def test_a_trial_s_numbers_are_its_own(
    worlds: WarpWorlds, models: list[GraspModel], mixed: Mixed
) -> None:
    whole = _bytes(mixed.launch(worlds), mixed.count)
    order = np.random.default_rng(0).permutation(len(mixed.index))
    shuffled = _bytes(mixed.launch(worlds, order), mixed.count[order])
    assert [shuffled[i] for i in np.argsort(order)] == whole
    for index, model in enumerate(models):
        rows = np.flatnonzero(mixed.index == index)
        alone = WarpWorlds([model], capacity=8, physics=PHYSICS)
        part = replace(mixed, index=np.zeros_like(mixed.index))
        assert _bytes(part.launch(alone, rows), mixed.count[rows]) == [whole[i] for i in rows]


@ON_CPU
def test_a_diverged_neighbour_or_predecessor_changes_no_byte(
    worlds: WarpWorlds, mixed: Mixed
) -> None:
    whole = _bytes(mixed.launch(worlds), mixed.count)
    state = mixed.state.copy()
    wild = np.arange(len(state)) % 2 == 0
    state[wild, 1] = np.nan
    state[0, 1:] = 1e30
    state[2, 10:] = np.inf
    found = replace(mixed, state=state).launch(worlds)
    assert np.isinf(found.steps.speed[wild, 0]).all()
    assert not found.overflowed.any()
    beside = _bytes(found, mixed.count)
    assert [beside[i] for i in np.flatnonzero(~wild)] == [whole[i] for i in np.flatnonzero(~wild)]
    assert _bytes(mixed.launch(worlds), mixed.count) == whole


@ON_CPU
def test_a_trial_stops_at_its_count(worlds: WarpWorlds, mixed: Mixed) -> None:
    """13 steps of 20 are the same as 13 of 13."""
    short = mixed.count == 13
    found = mixed.launch(worlds)
    exact = replace(mixed, control=mixed.control[:, :13], force=mixed.force[:13])
    assert _bytes(exact.launch(worlds, short), mixed.count[short]) == [
        _bytes(found, mixed.count)[i] for i in np.flatnonzero(short)
    ]


@ON_CPU
def test_buffers_of_contacts_grow_without_a_trace(
    worlds: WarpWorlds,
    models: list[GraspModel],
    mixed: Mixed,
    caplog: pytest.LogCaptureFixture,
) -> None:
    small = WarpWorlds(models, capacity=32, physics=PHYSICS, contacts=1)
    small.parts[0].contact_limit = 1  # which the buffers would have room for at least
    with caplog.at_level(logging.INFO, "gmdx"):
        found = mixed.launch(small)
    assert any("contacts a trial" in record.message for record in caplog.records)
    assert _bytes(found, mixed.count) == _bytes(mixed.launch(worlds), mixed.count)


@ON_CPU
def test_launches_under_way_keep_their_own_numbers(
    worlds: WarpWorlds, models: list[GraspModel], mixed: Mixed
) -> None:
    """Also where some of them have to run again, with more room for contacts."""
    small = WarpWorlds(models, capacity=4, physics=PHYSICS, contacts=1)
    small.parts[0].contact_limit = 1
    waiting, found = [], []
    for start in range(0, len(mixed.index), 4):
        if len(waiting) == small.lanes:
            found.append(waiting.pop(0)())
        rows = slice(start, start + 4)
        arrays = mixed.index[rows], mixed.state[rows], mixed.control[rows]
        waiting.append(small.launch(*arrays, mixed.force, mixed.count[rows]))
    whole = observations.joined([*found, *(wait() for wait in waiting)])
    assert len(found) >= 3
    assert _bytes(whole, mixed.count) == _bytes(mixed.launch(worlds), mixed.count)


def test_a_trial_with_more_contacts_than_its_limit_overflows(
    models: list[GraspModel], mixed: Mixed, worlds: WarpWorlds
) -> None:
    limited = WarpWorlds(models, capacity=32, physics=PHYSICS, contact_limit=4)
    found, layout = mixed.launch(limited), models[0].sensors
    free = mixed.launch(worlds)
    contacts = free.sensors[:, layout.hand] + free.sensors[:, layout.object_table]
    assert found.overflowed[contacts > 4].all()
    assert not found.overflowed.all()
    assert not free.overflowed.any()
    kept = np.flatnonzero(~found.overflowed)
    assert found.state[kept] == pytest.approx(free.state[kept], abs=1e-6)


def _shapes() -> Iterator[ObjectModel]:
    rng = np.random.default_rng(1)
    for i in range(10):
        points = trimesh.PointCloud(rng.normal(size=(20 + 4 * i, 3)) * [0.012, 0.015, 0.02])
        yield mesh_object(points.convex_hull, object_id=f"stone-{i}", mass=0.05 + 0.01 * i)


def test_ten_objects_need_no_kernel_beyond_the_first_s(worlds: WarpWorlds, mixed: Mixed) -> None:
    mixed.launch(worlds)
    before, gripper = kernel_counts(), load_gripper()
    stones = [grasp_model(obj, gripper, PHYSICS) for obj in _shapes()]
    for capacity, library in ((16, stones[:1]), (16, stones), (40, stones[3:5])):
        other = WarpWorlds(library, capacity=capacity, physics=PHYSICS)
        index = np.arange(12) % len(library)
        state, control = mixed.state[:12].copy(), mixed.control[:12]
        state[:, 3] = 0.03
        other.launch(index, state, control, mixed.force, mixed.count[:12])()
    assert kernel_counts() == before


def test_contacts_of_edges_are_those_of_c(chunks: list[list[Chunk]], models) -> None:  # type: ignore[no-untyped-def]
    """The same states have the same contacts, and the same normals, in C and in Warp."""
    with_edges = without = pairs = 0
    for notes, grasp in zip(chunks, models, strict=True):
        model = _plain(grasp.model)
        states = np.concatenate([c.state[:, 1 : 1 + model.nq] for c in notes]).astype(np.float32)
        expected = [_contacts_of_c(model, qpos) for qpos in states]
        for edges in (False, True):
            found = _contacts_of_warp(model, states, edges=edges)
            differ = sum(
                len(a[key]) != len(b[key]) or _angle(a[key], b[key]) > 0.01
                for a, b in zip(expected, found, strict=True)
                for key in set(a) | set(b)
            )
            with_edges, without = (
                (with_edges + differ, without) if edges else (with_edges, without + differ)
            )
        pairs += sum(len(found) for found in expected)
    assert pairs > 300
    assert without > 10
    assert with_edges <= 0.005 * pairs


def _plain(model: mujoco.MjModel) -> mujoco.MjModel:
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    return model


def _contacts_of_c(model: mujoco.MjModel, qpos: np.ndarray) -> dict[tuple[int, int], list]:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    found = defaultdict(list)
    for contact in data.contact:
        found[tuple(int(g) for g in contact.geom)].append(contact.frame[:3].copy())
    return found


def _contacts_of_warp(model: mujoco.MjModel, states: np.ndarray, *, edges: bool) -> list[dict]:
    count = len(states)
    with wp.ScopedDevice("cpu"):
        batched = {"geom_size": count, "geom_dataid": count}
        warp_model = mjw.put_model(model, batch_sizes=batched)
        if edges:
            warp_model.callback.contactfilter = EdgeContacts(model.geom_type)
        data = mjw.make_data(model, nworld=count, naconmax=40 * count, njmax=200)
        data.qpos = wp.array(states, dtype=float)
        mjw.fwd_kinematics(warp_model, data)
        mjw.collision(warp_model, data)
        size, contact = int(data.nacon.numpy()[0]), data.contact
        found: list[dict] = [defaultdict(list) for _ in range(count)]
        for world, geom, frame in zip(
            contact.worldid.numpy()[:size],
            contact.geom.numpy()[:size],
            contact.frame.numpy()[:size],
            strict=True,
        ):
            found[world][tuple(int(g) for g in geom)].append(frame[0])
    return found


def _angle(a: list, b: list) -> float:
    return float(np.arccos(np.clip(np.dot(a[0], b[0]), -1, 1))) if a and b else np.inf


def test_models_that_differ_in_more_than_their_object_are_refused_by_name() -> None:
    gripper = load_gripper()
    box, other = (grasp_model(box_object((0.03, 0.04, 0.05)), gripper, p) for p in _physics())
    with pytest.raises(UsageError, match=r"geom_solimp.*opt\.impratio"):
        build_library([box, other], PHYSICS)
    wide = grasp_model(box_object((0.03, 0.04, 0.05)), gripper, PHYSICS)
    wide.model.jnt_stiffness[1] = 3.0
    with pytest.raises(UsageError, match="differs in jnt_stiffness"):
        build_library([box, wide], PHYSICS)
    with pytest.raises(UsageError, match=r"differs in .*geom_size|differs in "):
        build_library(
            [box, grasp_model(box_object((0.03, 0.04, 0.05)), _other(), PHYSICS)], PHYSICS
        )


def _physics() -> tuple[PhysicsConfig, PhysicsConfig]:
    return PHYSICS, replace(PHYSICS, impratio=20.0, solimp=(0.9, 0.95, 0.001))


def _other():  # type: ignore[no-untyped-def]
    return load_gripper("franka_hand")


def test_too_many_hulls_are_refused() -> None:
    box = box_object((0.03, 0.04, 0.05))
    crowd = replace(box, hulls=box.hulls * (SLOTS[-1] + 1))
    model = grasp_model(crowd, load_gripper(), PHYSICS).model
    with pytest.raises(UsageError, match=f"up to {SLOTS[-1]}"):
        slots_for(model)


def test_a_failed_allocation_is_named() -> None:
    wanted = pytest.raises(DeviceMemoryError, match="no device memory for 7 trials")
    with wanted, wp.ScopedDevice("cpu"), device_memory("7 trials"):
        wp.zeros((2**31 - 1, 2**30), dtype=wp.uint8)


def test_memory_grows_with_the_contact_limit_and_the_device_has_a_name(
    models: list[GraspModel],
) -> None:
    assert 5e4 < bytes_per_trial(models) < 2e6
    assert CONTACT_LIMIT >= 100
    assert f"warp {wp.__version__} on " in version()


@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_a_squeezed_box_gives_way_at_twice_the_friction_limit(friction: float) -> None:
    gripper = load_gripper()
    box = box_object((0.03, 0.04, 0.05), friction=friction)
    scene = resting_scene(box)
    middle = PlanarGrasp(
        np.array([0]), np.array([[0.0, 0.0, 0.025]]), np.array([0.0]), np.array([0.05])
    )
    batch = place(scene, middle, trials=1, gripper=gripper, config=CONFIG)
    limit = 2 * friction * gripper.force - 0.1 * 9.81
    found = open_engine("warp").run([batch], config=CONFIG)[0]
    assert found.push_force[0] == pytest.approx(limit, rel=0.05)
    reference = MujocoEngine().run([batch], config=CONFIG)[0]
    assert found.push_force[0] == pytest.approx(reference.push_force[0], rel=0.02)


def test_cylinders_and_boxes_share_worlds_with_their_own_masses() -> None:
    """Free fall and mass: a push accelerates each object by force / mass - gravity."""
    gripper = load_gripper()
    objects = [box_object((0.03, 0.04, 0.05), mass=0.1), cylinder_object(0.02, 0.05, mass=0.4)]
    models = [grasp_model(obj, gripper, PHYSICS) for obj in objects]
    worlds, nq = WarpWorlds(models, capacity=4, physics=PHYSICS), models[0].model.nq
    state = np.zeros((2, 1 + nq + models[0].model.nv))
    state[:, 3], state[:, 4], state[:, 8] = 0.5, 1.0, 1.0
    control = np.tile([1.0, 0.0, 0.0], (2, STEPS, 1))
    force = np.tile([0.6, 0.0, 0.0], (STEPS, 1))
    found = worlds.launch(np.array([0, 1]), state, control, force, np.full(2, STEPS))()
    elapsed = STEPS * PHYSICS.timestep
    expected = np.array([[0.6 / mass, 0.0, -9.81] for mass in (0.1, 0.4)]) * elapsed
    assert found.steps.velocity[:, -1] == pytest.approx(expected, rel=1e-4, abs=1e-5)
