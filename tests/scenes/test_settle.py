"""Settling against closed forms: free fall, energy, resting faces, and rest itself."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.stats import chisquare

from gmdx.errors import ConfigError, SceneError
from gmdx.geometry import quaternion_matrix, random_quaternion, rotation_angle
from gmdx.objects.model import ObjectModel
from gmdx.objects.prepare import load_object
from gmdx.rng import generator
from gmdx.scenes.build import scene_model
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.scenes.settle import Fall, SettleConfig, lowest_points, settle
from tests.support import box_object, cylinder_object, mesh_object, sphere_object

CUBOIDS = ((0.02, 0.03, 0.045), (0.04, 0.05, 0.06), (0.02, 0.02, 0.05))


def ellipsoid() -> ObjectModel:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    return mesh_object(mesh.apply_scale([1.0, 0.8, 0.6]), object_id="ellipsoid")


def angle_profile() -> ObjectModel:
    """An L of two overlapping boxes: not convex, its centre of mass near the inner corner."""
    parts = [
        trimesh.creation.box(bounds=[[0, 0, 0], [0.08, 0.01, 0.03]]),
        trimesh.creation.box(bounds=[[0, 0, 0], [0.01, 0.05, 0.03]]),
    ]
    mesh = trimesh.boolean.union(parts, engine="manifold")
    return mesh_object(mesh, object_id="angle", hulls=[part.vertices for part in parts])


def polyhedron(seed: int) -> ObjectModel:
    """The convex hull of 14 random points of an ellipsoid."""
    points = generator(seed, "polyhedron").standard_normal((14, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    mesh = trimesh.convex.convex_hull(points * [0.02, 0.03, 0.04])
    return mesh_object(mesh, object_id=f"polyhedron {seed}")


SHAPES = {
    "box": box_object(CUBOIDS[0]),
    "sphere": sphere_object(0.025, subdivisions=3),
    "cylinder": cylinder_object(0.02, 0.1),
    "disc": cylinder_object(0.03, 0.01),
    "ellipsoid": ellipsoid(),
    "angle": angle_profile(),
    "polyhedron": polyhedron(0),
}


def energy(fall: Fall, obj: ObjectModel) -> float:
    """Kinetic energy and weight times height of the centre of mass over the table, J."""
    velocity, spin = fall.data.qvel[:3], fall.data.qvel[3:]  # spin in the object's axes
    kinetic = 0.5 * obj.mass * velocity @ velocity + 0.5 * spin @ obj.inertia @ spin
    return float(kinetic + obj.mass * 9.81 * fall.data.qpos[2])


def face_probabilities(extents: tuple[float, float, float]) -> np.ndarray:
    """Of resting on a face across x, y or z: its solid angle from the centre over 4 pi."""
    half = np.array(extents) / 2
    angles = []
    for axis in range(3):
        a, b = np.delete(half, axis)
        angles.append(4 * np.arctan(a * b / (half[axis] * np.linalg.norm(half))))
    return 2 * np.array(angles) / (4 * np.pi)


def falling(obj: ObjectModel, quaternion: np.ndarray, config: SettleConfig) -> Fall:
    physics = PhysicsConfig()
    return Fall(obj, quaternion, model=scene_model(obj, physics), physics=physics, config=config)


def start_quaternion(scene: Scene) -> np.ndarray:
    key = (scene.seed, scene.object.object_id, "scene", scene.scene_id, "orientation")
    return random_quaternion(generator(*key))


def test_falls_freely_until_it_touches() -> None:
    obj = polyhedron(1)
    config = SettleConfig(drop_height=0.2)
    fall = falling(obj, random_quaternion(generator(0, "fall")), config)
    start, turned = fall.data.qpos[2], fall.data.qpos[3:].copy()
    touches = np.sqrt(2 * 0.2 / 9.81)
    while fall.data.time < touches - 0.005:
        fall.step()
        t = fall.data.time
        # The integrator is of first order: a step late or early.
        assert start - fall.data.qpos[2] == pytest.approx(9.81 * t**2 / 2, abs=9.81 * t * 0.001)
        np.testing.assert_allclose(fall.data.qpos[3:], turned, atol=1e-12)
    lowest = (obj.vertices @ quaternion_matrix(turned)[2]).min() + fall.data.qpos[2]
    assert 0 < lowest < 0.02


@pytest.mark.parametrize("height", [0.0, 0.01, 0.2])
@pytest.mark.parametrize("damping", [0.0, 2.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_energy_never_grows(shape: str, height: float, damping: float) -> None:
    obj = SHAPES[shape]
    config = SettleConfig(drop_height=height, rotation_damping=damping)
    rng = generator(0, "energy", shape)
    fall = falling(obj, random_quaternion(rng), config)
    history = [energy(fall, obj)]
    while fall.data.time < 0.7:
        fall.step()
        history.append(energy(fall, obj))
    above_least_so_far = np.array(history) - np.minimum.accumulate(history)
    assert above_least_so_far.max() < 1e-3 * history[0]
    assert history[-1] < history[0]


@pytest.mark.slow
@pytest.mark.parametrize("extents", CUBOIDS)
def test_resting_faces_are_as_frequent_as_quasi_statics_says(
    extents: tuple[float, float, float],
) -> None:
    obj = box_object(extents)
    assert face_probabilities(extents).sum() == pytest.approx(1)
    count, as_predicted = np.zeros(3), 0
    drops = 300
    for k in range(drops):
        scene = settle(obj, seed=3, scene_id=k)
        down = np.abs(scene.rotation[2])
        assert down.max() > np.cos(np.radians(0.2))
        # The face that the vertical through the centre of mass leaves by, at the start.
        start = quaternion_matrix(start_quaternion(scene))[2]
        as_predicted += np.argmax(np.abs(start) / extents) == np.argmax(down)
        count[np.argmax(down)] += 1
    assert chisquare(count, drops * face_probabilities(extents)).pvalue > 0.01
    assert as_predicted >= 0.98 * drops


@pytest.mark.parametrize("extents", CUBOIDS)
def test_comes_to_rest_on_the_face_it_leans_to(extents: tuple[float, float, float]) -> None:
    for k in range(20):
        scene = settle(box_object(extents), seed=4, scene_id=k)
        start = np.abs(quaternion_matrix(start_quaternion(scene))[2]) / extents
        if np.sort(start)[-2] < 0.97 * start.max():
            assert np.argmax(start) == np.argmax(np.abs(scene.rotation[2]))


@pytest.mark.parametrize("shape", SHAPES)
def test_stays_at_rest_under_the_physics_of_trials(shape: str) -> None:
    obj = SHAPES[shape]
    model = scene_model(obj, PhysicsConfig())
    assert model.opt.timestep == 0.004
    for k in range(5):
        scene = settle(obj, scene_id=k)
        data = mujoco.MjData(model)
        data.qpos[:] = [*scene.position, *scene.quaternion]
        mujoco.mj_step(model, data, 250)
        after = replace(scene, position=data.qpos[:3].copy(), quaternion=data.qpos[3:].copy())
        moved = after.to_world(obj.vertices) - scene.to_world(obj.vertices)
        assert np.linalg.norm(moved, axis=1).max() < 5e-4


@pytest.mark.parametrize("shape", SHAPES)
def test_lies_on_the_table_above_the_origin(shape: str) -> None:
    obj = SHAPES[shape]
    for k in range(5):
        scene = settle(obj, seed=1, scene_id=k)
        np.testing.assert_array_equal(scene.position[:2], 0)
        lowest = min(scene.to_world(hull)[:, 2].min() for hull in obj.hulls)
        assert -3e-4 < lowest < 1e-5
        assert lowest_points(scene).hulls == pytest.approx(lowest, abs=1e-12)
        assert np.linalg.norm(scene.quaternion) == pytest.approx(1, abs=1e-12)
        assert 0 < scene.settle_time < 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["l_profile", "hammer"])
def test_bundled_objects_rest_on_their_hulls(name: str) -> None:
    path = files("gmdx_assets") / "objects" / f"{name}.obj"
    obj = load_object(Path(str(path)), cache=None)
    model = scene_model(obj, PhysicsConfig())
    for k in range(10):
        scene = settle(obj, scene_id=k)
        assert -3e-4 < lowest_points(scene).hulls < 1e-5
        data = mujoco.MjData(model)
        data.qpos[:] = [*scene.position, *scene.quaternion]
        mujoco.mj_step(model, data, 250)
        assert np.linalg.norm(data.qpos[:3] - scene.position) < 3e-4
        turned = rotation_angle(data.qpos[None, 3:], scene.quaternion[None])[0]
        assert turned * obj.radius < 3e-4


@pytest.mark.parametrize("seed", range(8))
def test_convex_objects_rest_on_a_facet_that_holds_them(seed: int) -> None:
    obj = polyhedron(seed)
    hull = ConvexHull(obj.vertices)
    # A facet holds the object if the centre of mass, the origin, projects into it.
    inside = []
    for normal, offset, corners in zip(
        hull.equations[:, :3], -hull.equations[:, 3], hull.points[hull.simplices], strict=True
    ):
        weights = np.linalg.solve(corners.T, normal * offset)
        inside.append(bool((weights > -0.02).all()))
    holding = hull.equations[inside, :3]
    for k in range(4):
        down = -settle(obj, scene_id=k).rotation[2]
        assert np.degrees(np.arccos(np.clip(holding @ down, -1, 1).max())) < 0.5


def test_a_ball_and_a_roller_come_to_rest() -> None:
    for obj in (sphere_object(0.025), cylinder_object(0.025, 0.06)):
        times = [settle(obj, scene_id=k).settle_time for k in range(5)]
        assert max(times) < 5


def test_heading_stays_as_it_fell() -> None:
    # Flat boxes that start nearly flat keep the heading they start with.
    obj = box_object((0.06, 0.04, 0.005))
    kept = 0
    for k in range(30):
        scene = settle(obj, scene_id=k)
        start = start_quaternion(scene)
        tilt = np.arccos(np.abs(quaternion_matrix(start)[2, 2]))
        if tilt < np.radians(30):
            kept += 1
            assert rotation_angle(start[None], scene.quaternion[None])[0] < tilt + np.radians(15)
    assert kept >= 3


def test_same_seed_gives_the_same_scene_whatever_came_before() -> None:
    obj = SHAPES["angle"]
    first = settle(obj, seed=5, scene_id=2)
    settle(obj, seed=5, scene_id=0)
    again = settle(obj, seed=5, scene_id=2)
    assert first.position.tobytes() == again.position.tobytes()
    assert first.quaternion.tobytes() == again.quaternion.tobytes()
    assert (again.seed, again.scene_id, again.settle_time) == (5, 2, first.settle_time)
    others = [settle(obj, seed=5, scene_id=3), settle(obj, seed=6, scene_id=2)]
    for other in (*others, settle(replace(obj, object_id="other"), seed=5, scene_id=2)):
        assert np.abs(other.quaternion - first.quaternion).max() > 1e-3


def test_physics_rests_on_hulls_and_not_on_the_surface() -> None:
    small, large = trimesh.creation.box((0.03,) * 3), trimesh.creation.box((0.032,) * 3)
    scene = settle(mesh_object(small, hulls=[large.vertices]))
    lowest = lowest_points(scene)
    assert lowest.hulls == pytest.approx(0, abs=5e-5)
    assert lowest.surface == pytest.approx(0.001, abs=5e-5)


def test_failures_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into the working directory
    box = SHAPES["box"]
    with pytest.raises(SceneError, match=r"object 'box', scene 7: the object never settled"):
        settle(box, scene_id=7, config=SettleConfig(max_time=0.1))
    with pytest.raises(SceneError, match="left the table"):
        settle(box, config=SettleConfig(table_radius=0.001))
    with pytest.raises(SceneError, match="diverged"):
        settle(box, config=SettleConfig(max_speed=0.2))
    with pytest.raises(SceneError, match=r"diverged.*mjWARN_BADQACC"):
        settle(replace(box, inertia=box.inertia * 1e-7))
    with pytest.raises(SceneError, match="cannot simulate"):
        settle(replace(box, inertia=-box.inertia))
    with pytest.raises(ConfigError, match="timestep must be positive"):
        SettleConfig(timestep=0.0)
    with pytest.raises(ConfigError, match="drop_height"):
        SettleConfig(drop_height=-1.0)
