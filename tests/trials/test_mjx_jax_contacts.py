"""The JAX implementation's contacts against C MuJoCo's distances, and its hulls against laws."""

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
import trimesh

pytest.importorskip("jax")

import jax
import jax.numpy as jnp
from mujoco import rollout

from gmdx.errors import UsageError
from gmdx.geometry import quaternion_matrix
from gmdx.grasps.sample import sample_grasps
from gmdx.objects.catalog import resolve
from gmdx.objects.prepare import prepare
from gmdx.scenes.build import GraspModel, PhysicsConfig, grasp_model
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.settle import settle
from gmdx.trials import batch as batches
from gmdx.trials.execute import Execution
from gmdx.trials.frames import Stretch
from gmdx.trials.mjx_jax_alike import check_alike
from gmdx.trials.mjx_jax_collide import hull_table_contacts
from gmdx.trials.mjx_jax_hulls import Bucket, Hulls, bucket, object_hulls
from gmdx.trials.mjx_jax_manifold import Manifold
from gmdx.trials.mjx_jax_narrow import _parting, box_hull, hull_in_box
from gmdx.trials.mjx_jax_rig import read_rig
from gmdx.trials.mujoco import _Engine
from gmdx.trials.protocol import TrialConfig
from tests.support import box_object, cylinder_object, mesh_object, sphere_object

HALF = np.array([0.004, 0.01, 0.007])


@pytest.fixture(autouse=True)
def double() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


def _model(obj: object, **physics: float) -> GraspModel:
    return grasp_model(obj, load_gripper(), PhysicsConfig(**physics))


def _poses(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    turned = rng.normal(size=(count, 4))
    matrices = quaternion_matrix(turned / np.linalg.norm(turned, axis=1, keepdims=True))
    return list(zip(rng.uniform(-0.02, 0.02, (count, 3)), matrices, strict=True))


@jax.jit
def _touch(hulls: Hulls, place: jax.Array, axes: jax.Array) -> Manifold:
    hull = hull_in_box(hulls, (jnp.asarray(0),), place, axes, jnp.zeros(3), jnp.eye(3))
    return box_hull(jnp.asarray(HALF), hull)


@jax.jit
def _gap(hulls: Hulls, place: jax.Array, axes: jax.Array) -> jax.Array:
    hull = hull_in_box(hulls, (jnp.asarray(0),), place, axes, jnp.zeros(3), jnp.eye(3))
    return _parting(jnp.asarray(HALF), hull).gap


def _rocks(count: int) -> np.ndarray:
    """Corners of a hull without two parallel faces."""
    points = np.random.default_rng(count).normal(size=(count, 3))
    return 0.015 * points / np.linalg.norm(points, axis=1, keepdims=True)


def _rock(count: int) -> GraspModel:
    return _model(mesh_object(trimesh.convex.convex_hull(_rocks(count))))


def test_filling_up_changes_no_contact() -> None:
    model = _rock(14)
    tight = object_hulls(model, Bucket(1, 14))
    wide = object_hulls(model, Bucket(8, 64))
    assert wide.vertices.shape == (8, 64, 3)
    assert wide.used.tolist() == [True] + [False] * 7
    touching = 0
    for place, axes in _poses(60, 0):
        first, second = _touch(tight, place, axes), _touch(wide, place, axes)
        touching += int(np.any(first.distance < 0))
        for one, other in zip(first, second, strict=True):
            np.testing.assert_array_equal(one, other)
    assert touching > 15


@pytest.mark.parametrize(
    "obj",
    [
        box_object((0.03, 0.02, 0.025)),
        cylinder_object(0.012, 0.03),
        sphere_object(0.012, subdivisions=2),
    ],
    ids=["box", "cylinder", "ball"],
)
def test_depths_are_those_of_mujoco(obj: object) -> None:
    model = _model(obj)
    m, data = model.model, mujoco.MjData(model.model)
    hulls = object_hulls(model, bucket(model))
    hull = next(g for g in range(m.ngeom) if m.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH)
    box = m.geom("gripper/" + model.gripper.pads[0]).id
    m.geom_size[box], m.geom_rbound[box] = HALF, np.linalg.norm(HALF)
    seen = set()
    for place, axes in _poses(60, 1):
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        data.qpos[:7] = [*place, *quaternion]
        mujoco.mj_kinematics(m, data)
        to_box = data.geom_xmat[box].reshape(3, 3).T
        # The pad is somewhere else: bring the object to the same place relative to it.
        data.qpos[:3] = data.geom_xpos[box] + to_box.T @ place
        mujoco.mju_mat2Quat(quaternion, (to_box.T @ axes).ravel())
        data.qpos[3:7] = quaternion
        mujoco.mj_kinematics(m, data)
        expected = mujoco.mj_geomDistance(m, data, box, hull, 1.0, None)
        found = float(_gap(hulls, place, axes))
        assert (float(_touch(hulls, place, axes).distance.min()) < 0) == (found < 0)
        if expected < -1e-6:
            assert found == pytest.approx(expected, abs=2e-6)
        elif expected > 1e-6:
            assert found > 0
        seen.add(expected > 0)
    assert seen == {True, False}


def test_a_box_flat_on_a_box_is_met_at_the_corners_of_the_overlap() -> None:
    model = _model(box_object((0.02, 0.03, 0.01)))
    hulls = object_hulls(model, bucket(model))
    place = np.array([0.01399, 0.002, 0.004])  # 10 um deep, along x
    found = _touch(hulls, place, np.eye(3))
    np.testing.assert_allclose(found.distance, -1e-5, atol=1e-8)  # hulls are kept in single
    np.testing.assert_allclose(found.normal, np.tile([1.0, 0.0, 0.0], (4, 1)), atol=1e-7)
    corners = {(round(y, 6), round(z, 6)) for _, y, z in np.asarray(found.position)}
    assert corners == {(-0.01, -0.001), (-0.01, 0.007), (0.01, -0.001), (0.01, 0.007)}


@pytest.mark.parametrize("flat", [True, False])
@pytest.mark.parametrize("shape", ["box", "cylinder", "rock", "two hulls"])
def test_contacts_with_the_table_are_those_of_mujoco(shape: str, flat: bool) -> None:
    solids = {
        "box": box_object((0.03, 0.02, 0.025)),
        "cylinder": cylinder_object(0.012, 0.03),
        "rock": mesh_object(trimesh.convex.convex_hull(_rocks(30))),
        "two hulls": mesh_object(
            trimesh.creation.box((0.02, 0.02, 0.02)), hulls=[_rocks(12), _rocks(20) + 0.005]
        ),
    }
    model = _model(solids[shape])
    m, data = model.model, mujoco.MjData(model.model)
    hulls = jax.tree.map(lambda values: values[None], object_hulls(model, bucket(model)))
    table = m.geom("table").id
    find = jax.jit(hull_table_contacts)
    counts = set()
    for place, axes in _poses(30, 2):
        if flat:  # on a face, a little tilted
            tilt, _ = np.linalg.qr(np.eye(3) + 1e-3 * axes)
            axes = tilt * np.sign(np.diag(tilt))
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, axes.ravel())
        data.qpos[:7] = [*place, *quaternion]
        data.qpos[7] = 1.0  # the gripper far above
        mujoco.mj_kinematics(m, data)
        lowest = min(
            float((data.geom_xpos[g] + _vertices(m, g) @ data.geom_xmat[g].reshape(3, 3).T)[:, 2]
                  .min())
            for g in range(m.ngeom) if m.geom_bodyid[g] == model.object_body
        )  # fmt: skip
        data.qpos[2] -= lowest + 5e-4
        mujoco.mj_forward(m, data)
        expected = [
            (*contact.pos, contact.dist)
            for contact in data.contact
            if table in contact.geom and contact.dist < 0
        ]
        found = find(hulls, 0, data.qpos[:3], axes)
        there = np.asarray(found.distance) < 0
        ours = np.column_stack([found.position, found.distance])[there]
        counts.add(len(expected))
        np.testing.assert_allclose(_sorted(ours), _sorted(np.array(expected)), atol=1e-7)
    assert max(counts) >= (3 if flat and shape in ("box", "cylinder") else 1)


def _vertices(m: mujoco.MjModel, geom: int) -> np.ndarray:
    mesh = m.geom_dataid[geom]
    return m.mesh_vert[m.mesh_vertadr[mesh] :][: m.mesh_vertnum[mesh]]


def _sorted(contacts: np.ndarray) -> np.ndarray:
    return contacts[np.lexsort(np.round(contacts[:, :3].T, 6))]


def test_buckets_are_few_and_hold_what_they_promise() -> None:
    found = {bucket(_rock(count)) for count in range(5, 17)}
    assert found == {Bucket(2, 16)}
    for count in (5, 16):
        hulls = object_hulls(_rock(count), Bucket(2, 16))
        assert [hulls.normals.shape, hulls.edges.shape] == [(2, 28, 3), (2, 42, 2)]


def test_more_vertices_than_any_bucket_are_refused() -> None:
    with pytest.raises(UsageError, match="vertices in a convex hull is more"):
        bucket(_model(sphere_object(0.02, subdivisions=3)))


def test_models_that_differ_beyond_the_object_are_refused_by_the_field_s_name() -> None:
    first = _model(box_object((0.03, 0.04, 0.05)))
    check_alike([first, _model(box_object((0.02, 0.02, 0.02), mass=0.3, friction=0.4))])
    with pytest.raises(UsageError, match=r"opt\.timestep"):
        check_alike([first, _model(box_object((0.03, 0.04, 0.05)), timestep=0.002)])
    other = _model(box_object((0.03, 0.04, 0.05)))
    other.model.dof_armature[8] *= 2
    with pytest.raises(UsageError, match="dof_armature"):
        check_alike([first, other])


def test_grippers_that_the_step_does_not_compute_are_refused() -> None:
    model = _model(box_object((0.03, 0.04, 0.05)))
    model.model.dof_frictionloss[7] = 1.0
    with pytest.raises(UsageError, match="friction in joints"):
        read_rig(model)
    other = _model(box_object((0.03, 0.04, 0.05)))
    other.model.geom_type[3] = mujoco.mjtGeom.mjGEOM_CAPSULE
    with pytest.raises(UsageError, match="other shapes than boxes"):
        read_rig(other)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cross", "hammer"])
def test_most_contacts_of_real_grips_are_those_of_mujoco(name: str) -> None:
    """Number, places, depths and normals, of pads on hulls, on the way of real trials."""
    scene = settle(prepare(resolve([f"bundled:{name}"])[0]), 0)
    grasps = sample_grasps(scene, 12, 0)
    batch = batches.place(scene, grasps, gripper=load_gripper(), config=TrialConfig(trials=1))
    states: list[np.ndarray] = []

    class Noted(_Engine):
        def step(self, *arrays: np.ndarray) -> Stretch:
            found = super().step(*arrays)
            states.extend(found.state[found.steps.touches[:, -1]])
            return found

    model = grasp_model(scene.object, load_gripper(), PhysicsConfig())
    with rollout.Rollout(nthread=1) as pool:
        trials = Execution(Noted(model, pool, 1), [batch], TrialConfig(trials=1))
        trials.run([batch.schedule(TrialConfig(trials=1))])
    hulls = jax.tree.map(jnp.asarray, object_hulls(model, bucket(model)))
    m, data = model.model, mujoco.MjData(model.model)
    geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] == model.object_body]
    pads = [m.geom("gripper/" + pad).id for pad in model.gripper.pads]

    @jax.jit
    def touch(which: int, half: jax.Array, *where: jax.Array) -> Manifold:
        return box_hull(half, hull_in_box(hulls, (which,), *where))

    alike = []
    for state in states[::4]:
        data.qpos[:] = state[1 : 1 + m.nq]
        mujoco.mj_forward(m, data)
        expected: dict[tuple[int, int], list[np.ndarray]] = {}
        for contact in data.contact:
            if contact.geom1 in pads and contact.geom2 in geoms:
                numbers = [contact.dist, *contact.pos, *contact.frame[:3]]
                expected.setdefault((contact.geom1, contact.geom2), []).append(np.array(numbers))
        for (pad, hull), contacts in expected.items():
            R, origin = data.geom_xmat[pad].reshape(3, 3), data.geom_xpos[pad]
            axes = data.xmat[model.object_body].reshape(3, 3)
            arrays = m.geom_size[pad], data.qpos[:3], axes, origin, R
            found = touch(geoms.index(hull), *arrays)
            there = np.asarray(found.distance) < 0
            position = origin + np.asarray(found.position)[there] @ R.T
            normal = np.asarray(found.normal)[there] @ R.T
            ours = np.column_stack([np.asarray(found.distance)[there], position, normal])
            theirs = np.array(contacts)
            same = len(ours) == len(theirs) and np.allclose(
                _by_place(ours), _by_place(theirs), atol=1e-5, rtol=1e-3
            )
            alike.append(same)
    assert len(alike) > 40
    assert np.mean(alike) > 0.8


def _by_place(contacts: np.ndarray) -> np.ndarray:
    return contacts[np.lexsort(np.round(contacts[:, 1:4].T, 5))]
