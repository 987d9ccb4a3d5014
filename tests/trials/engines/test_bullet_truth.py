"""The second engine against closed forms; where it deviates, the bounds say by how much."""

import numpy as np
import pytest
import trimesh
from scipy.integrate import solve_ivp

from gmdx.geometry import (
    quaternion_conjugate,
    quaternion_matrix,
    quaternion_multiply,
    random_quaternion,
    rotation_angle,
)
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.objects.model import ObjectModel
from gmdx.objects.stable import stable_poses
from gmdx.scenes.gripper import load_gripper, shipped_grippers
from gmdx.scenes.physics import PhysicsConfig
from gmdx.trials.outcome import Outcome
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.results import Snapshot
from gmdx.trials.run import run_trials
from tests.support import box_object, mesh_object, resting_scene, sphere_object
from tests.trials.engines.bullet_rig import UP, bullet_world, start, wait

pybullet = pytest.importorskip("pybullet", reason="the second engine is not installed")

GRAVITY = 9.81
BOX = (0.03, 0.04, 0.05)


def _middle(
    height: float = 0.025, width: float = 0.05, *, x: float = 0.0, angle: float = 0.0
) -> PlanarGrasp:
    center = np.array([[x, 0.0, height]])
    return PlanarGrasp(np.array([0]), center, np.array([angle]), np.array([width]))


def _between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two orientations, rad."""
    return float(rotation_angle(a[None], b[None])[0])


def _slide(extents: tuple[float, float, float], friction: float, angle: float) -> float:
    """How far a box slides in the second second on a plane tilted by `angle`, m."""
    gravity = (GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle))
    with bullet_world(box_object(extents, friction=friction)) as world:
        world.reset(start((0.0, 0.0, 0.5 * extents[2])), gravity=gravity)
        wait(world, 250)
        before = world.state()[0][0]
        wait(world, 250)
        return float(world.state()[0][0] - before)


@pytest.mark.parametrize("extents", [(0.05, 0.04, 0.03), (0.02, 0.03, 0.008)])
@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_box_on_slope_sticks_below_the_friction_angle_and_slides_above(
    extents: tuple[float, float, float], friction: float
) -> None:
    steepest = np.arctan(friction)
    assert _slide(extents, friction, 0.97 * steepest) < 5e-5
    # Just above the friction angle what pulls is a small difference of what is measured.
    for steeper, within in ((1.03, 0.06), (1.5, 0.01)):
        angle = steeper * steepest
        pull = GRAVITY * (np.sin(angle) - friction * np.cos(angle))
        assert _slide(extents, friction, angle) == pytest.approx(1.5 * pull, rel=within)


def test_spinning_ball_slows_down_by_its_torsional_friction() -> None:
    ball = sphere_object(0.02)
    with bullet_world(ball) as world:
        world.reset(start((0.0, 0.0, 0.02)))
        wait(world, 25)
        turning = [0.0, 0.0, 50.0]
        pybullet.resetBaseVelocity(
            world.object, [0.0, 0.0, 0.0], turning, physicsClientId=world.client
        )
        wait(world, 25)
        slower = 50.0 - world.state()[1][5]
    torsion = 2 / 3 * ball.friction * 0.005
    assert slower / 0.1 == pytest.approx(
        torsion * ball.mass * GRAVITY / ball.inertia[2, 2], rel=0.02
    )


def test_a_free_body_turns_as_euler_says() -> None:
    """A body whose principal axes are not its own: inertia and poses keep to one frame."""
    tilted = trimesh.creation.box((0.02, 0.04, 0.07))
    tilted.apply_transform(trimesh.transformations.euler_matrix(0.4, -0.7, 1.1))
    obj = mesh_object(tilted)
    assert abs(obj.inertia[0, 1]) > 1e-6
    spin = np.array([4.0, -2.0, 3.0])

    def change(_: float, y: np.ndarray) -> np.ndarray:
        R = quaternion_matrix(y[:4] / np.linalg.norm(y[:4]))
        I = R @ obj.inertia @ R.T  # noqa: E741
        w = y[4:]
        turn = 0.5 * quaternion_multiply(np.array([0.0, *w]), y[:4])
        return np.concatenate([turn, np.linalg.solve(I, -np.cross(w, I @ w))])

    first = np.array([0.5, 0.5, -0.5, 0.5])
    expected = solve_ivp(change, (0.0, 0.2), [*first, *spin], rtol=1e-9).y[:, -1]
    with bullet_world(obj) as world:
        world.reset(start((0.0, 0.0, 0.3), first))
        assert _between(world.state()[0][3:7], first) < 1e-7
        pybullet.resetBaseVelocity(
            world.object, [0.0, 0.0, 0.0], spin.tolist(), physicsClientId=world.client
        )
        wait(world, 50)
        qpos, _ = world.state()
    last = expected[:4] / np.linalg.norm(expected[:4])
    assert _between(first, last) > 0.8
    assert _between(qpos[3:7], last) < 0.02 * _between(first, last)
    assert qpos[2] == pytest.approx(0.3 - 0.5 * GRAVITY * 0.2**2, abs=1e-3)


@pytest.mark.parametrize("gripper_name", shipped_grippers())
def test_pads_press_with_the_gripper_s_force(gripper_name: str) -> None:
    gripper = load_gripper(gripper_name)
    fingers = gripper.finger_positions(np.array(0.05))
    with bullet_world(box_object(BOX), gripper) as world:
        world.reset(start((0.0, 0.0, 0.025), height=0.025, fingers=fingers))
        sensors = wait(world, 150, height=0.025, closing=0.3)
        for slots in world.sensors.pads:
            # The impulses of single substeps scatter; their mean is the force.
            assert sensors[slots].reshape(-1, 11)[:, 1].sum() == pytest.approx(
                gripper.force, rel=0.03
            )
        opening = gripper.opening(world.state()[0][None, 8:])
    assert opening[0] == pytest.approx(0.03, abs=5e-5)


@pytest.mark.parametrize("mass", [0.05, 0.5])
@pytest.mark.parametrize("friction", [0.3, 0.8])
@pytest.mark.parametrize("gripper_name", shipped_grippers())
def test_squeezed_box_is_pushed_out_at_twice_the_friction_limit(
    gripper_name: str, friction: float, mass: float
) -> None:
    gripper = load_gripper(gripper_name)
    scene = resting_scene(box_object(BOX, friction=friction, mass=mass))
    for direction in (-1.0, 1.0):
        config = TrialConfig(push_direction=(0.0, 0.0, direction))
        trials = run_trials(scene, _middle(), "bullet", trials=1, gripper=gripper, config=config)
        expected = 2 * friction * gripper.force + direction * mass * GRAVITY
        assert trials.outcome[0, 0] == Outcome.SUCCESS
        assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("ramp", [0.25, 5.0])
def test_push_is_the_same_at_every_ramp(ramp: float) -> None:
    scene = resting_scene(box_object(BOX))
    config = TrialConfig(push_ramp=ramp, push_limit=2.0)
    trials = run_trials(scene, _middle(), "bullet", trials=1, config=config)
    expected = 2 * 0.8 * load_gripper().force - 0.1 * GRAVITY
    assert trials.push_force[0] == pytest.approx(expected, rel=0.05)


def test_held_box_creeps_less_than_a_millimetre_in_two_seconds() -> None:
    never_still = TrialConfig(hold_time=2.0, still_speed=0.0)
    trials = run_trials(
        resting_scene(box_object(BOX)), _middle(), "bullet", trials=1, config=never_still
    )
    held = trials.object_position - trials.tool_position
    assert trials.outcome[0, 0] == Outcome.SUCCESS
    assert np.linalg.norm(held[0, Snapshot.HELD] - held[0, Snapshot.CLOSED]) < 1e-3


def test_centred_grasp_does_not_move_the_box_and_touches_its_faces() -> None:
    trials = run_trials(resting_scene(box_object(BOX)), _middle(), "bullet", trials=1)
    moved = trials.object_position[0, Snapshot.CLOSED] - trials.object_position[0, Snapshot.CLOSING]
    assert np.linalg.norm(moved) < 1e-4
    assert trials.opening[0] == pytest.approx(0.03, abs=5e-5)
    points, normals = trials.contacts.points[0], trials.contacts.normals[0]
    valid = trials.contacts.valid[0]
    assert valid.any(axis=1).all()
    for side, x in ((0, -0.015), (1, 0.015)):
        np.testing.assert_allclose(points[side][valid[side], 0], x, atol=5e-5)
        inward = np.broadcast_to([-np.sign(x), 0, 0], (valid[side].sum(), 3))
        np.testing.assert_allclose(normals[side][valid[side]], inward, atol=1e-3)


def test_off_centre_box_is_pulled_between_the_pads() -> None:
    grasp = _middle(x=0.008, width=0.06)
    trials = run_trials(resting_scene(box_object(BOX)), grasp, "bullet", trials=1)
    assert trials.object_position[0, Snapshot.CLOSED, 0] == pytest.approx(0.008, abs=5e-4)


@pytest.mark.parametrize(
    ("acceleration", "unique"), [(300.0, True), (30.0, False)], ids=["light drive", "heavy drive"]
)
def test_tilted_faces_slip_where_coulomb_says_if_it_says_one_thing(
    acceleration: float, unique: bool
) -> None:
    """Faces that lean inward by t give way at 2 F tan(phi - t) - W, phi = arctan mu.

    While they slide with acceleration a, the fingers follow and their inertia M takes from their
    force: m a = P + W - 2 tan(phi - t) (F - M a tan t). If m < 2 M tan t tan(phi - t), this has a
    solution a > 0 for pushes P below the limit as well: rigid Coulomb friction then allows both
    to hold and to slide, and Bullet's contacts, which are rigid, let go early.
    """
    tilt, phi, force, mass = np.radians(10.0), np.arctan(0.8), 20.0, 0.1
    inertia = 0.05 + force / acceleration
    assert (mass > 2 * inertia * np.tan(tilt) * np.tan(phi - tilt)) == unique
    lean = 0.025 * np.tan(tilt)
    corners = [
        (x * (0.025 - z * lean), y, z * 0.025)
        for x in (-1, 1)
        for y in (-0.02, 0.02)
        for z in (-1, 1)
    ]
    wedge = mesh_object(trimesh.convex.convex_hull(np.array(corners)), mass=mass)
    physics = PhysicsConfig(closing_acceleration=acceleration)
    width = 2 * (0.025 + 0.01 * float(np.tan(tilt)))
    scene = resting_scene(wedge, physics=physics)
    trials = run_trials(scene, _middle(width=width), "bullet", trials=1)
    ratio = trials.push_force[0] / (2 * force * np.tan(phi - tilt) - mass * GRAVITY)
    assert trials.outcome[0, 0] == Outcome.SUCCESS
    assert ratio == pytest.approx(1.0, abs=0.05) if unique else 0.4 < ratio < 1.05


@pytest.mark.parametrize("engine", ["mujoco", "bullet"])
@pytest.mark.parametrize(("friction", "jams"), [(0.4, False), (1.0, True)])
def test_a_crooked_box_jams_where_both_friction_cones_hold_the_line_between_its_contacts(
    engine: str, friction: float, jams: bool
) -> None:
    # Pads of 20 mm meet a box 30 mm thick at opposite corners: a line at arctan(20 / 30).
    angle = 0.1
    edge = np.arctan2(0.02, 0.03) + angle
    assert (np.arctan(friction) > edge) == jams
    scene = resting_scene(box_object(BOX, friction=friction))
    trials = run_trials(scene, _middle(width=0.06, angle=angle), engine, trials=1)
    turn = trials.object_quaternion[0, [Snapshot.CLOSING, Snapshot.CLOSED]]
    left = angle - _between(turn[0], turn[1])
    assert left > 0.8 * angle if jams else abs(left) < 0.1 * angle


def _face_down(obj: ObjectModel, seed: int) -> int:
    """Axis (0, 1, 2) of the box that is vertical after it fell on the table; its tilt < 1 deg."""
    rng = np.random.default_rng(seed)
    with bullet_world(obj) as world:
        turn = random_quaternion(rng)
        lowest = float((obj.vertices @ quaternion_matrix(turn).T)[:, 2].min())
        world.reset(start((0.0, 0.0, 0.01 - lowest), turn))
        wait(world, 500)
        up = quaternion_matrix(quaternion_conjugate(world.state()[0][3:7]))[:, 2]
    assert np.abs(up).max() > np.cos(np.radians(1.0))
    return int(np.abs(up).argmax())


def test_a_dropped_box_rests_on_its_faces_as_often_as_quasi_static_analysis_says() -> None:
    extents = (0.03, 0.04, 0.06)
    obj = box_object(extents)
    poses = stable_poses(obj.vertices, np.zeros(3))
    expected = np.zeros(3)
    for quaternion, probability in zip(poses.quaternions, poses.probabilities, strict=True):
        up = quaternion_matrix(quaternion_conjugate(quaternion))[:, 2]
        expected[np.abs(up).argmax()] += probability
    drops = 40
    counts = np.bincount([_face_down(obj, seed) for seed in range(drops)], minlength=3)
    # Within three standard deviations of so many draws; a fall from 10 mm has little speed.
    chance = 3.0 * np.sqrt(drops * expected * (1.0 - expected))
    assert np.all(np.abs(counts - drops * expected) < chance)
    assert counts[0] > counts[2]


def test_the_idle_gripper_stays_where_it_is() -> None:
    with bullet_world(box_object(BOX)) as world:
        world.reset(start((0.0, 0.0, 0.025)))
        wait(world, 100)
        assert world.state()[0][7] == pytest.approx(UP, abs=1e-6)
