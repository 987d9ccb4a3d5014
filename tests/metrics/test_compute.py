from dataclasses import fields, replace
from importlib.resources import as_file, files

import numpy as np
import pytest
import trimesh

from gmdx.errors import ConfigError, MetricError
from gmdx.geometry import quaternion_multiply, yaw_quaternion
from gmdx.grasps.contact import LineConfig
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.metrics.compute import MetricConfig, MetricTable, compute_metrics
from gmdx.metrics.quality import QualityConfig
from gmdx.metrics.table import METRIC_NAMES, METRICS, STAGES
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import TrialResults
from tests.support import (
    box_object,
    mesh_object,
    resting_scene,
    scaled_object,
    turned_quaternion,
)

EXTENTS = (0.04, 0.06, 0.08)
RADIUS = 0.5 * np.linalg.norm(EXTENTS)
GRIPPER = load_gripper()
PRIORI = [metric.name for metric in METRICS if metric.kind == "priori"]
LENGTHS = [metric.name for metric in METRICS if metric.unit == "m"]


def _grasps(
    scene: Scene, local: np.ndarray, turn: np.ndarray, yaw: float, width: float = 0.07
) -> PlanarGrasp:
    """Grasps given in the frame of an upright object that is turned by `yaw`."""
    center = scene.to_world(np.asarray(local, float))
    n = len(center)
    angle = np.mod(np.asarray(turn, float) + yaw, np.pi)
    return PlanarGrasp(np.arange(n), center, angle, np.full(n, width))


def _contacts(points: np.ndarray, normals: np.ndarray) -> PadContacts:
    points, normals = np.asarray(points, float), np.asarray(normals, float)
    return PadContacts(points, normals, np.isfinite(points).all(axis=3))


def _still_trials(scene: Scene, grasps: PlanarGrasp, **changes: object) -> TrialResults:
    """Five successful trials each in which nothing moved and nothing was touched."""
    n = len(grasps)
    nothing = np.full((n, 2, 1, 3), np.nan)
    still = TrialResults(
        grasp_id=grasps.grasp_id,
        gripper=GRIPPER,
        outcome=np.full((n, 5), int(Outcome.SUCCESS)),
        collision=np.zeros((n, 5), bool),
        object_position=np.tile(scene.position, (n, 4, 1)),
        object_quaternion=np.tile(scene.quaternion, (n, 4, 1)),
        tool_position=np.repeat(grasps.center[:, None], 4, axis=1),
        contacts=_contacts(nothing, nothing),
        opening=np.full(n, 0.04),
        push_force=np.full(n, 30.0),
        push_force_is_lower_bound=np.zeros(n, bool),
        engine="by hand",
        steps=0,
        step_seconds=0.0,
        seconds=0.0,
    )
    return replace(still, **changes)  # type: ignore[arg-type]


def _priori(scene: Scene, grasps: PlanarGrasp, **options: object) -> MetricTable:
    gripper = options.pop("gripper", GRIPPER)
    trials = _still_trials(scene, grasps, gripper=gripper)
    return compute_metrics(scene, grasps, trials, **options)  # type: ignore[arg-type]


def _pair_epsilon(r: float, L: float, mu: float, gamma: float, d: float) -> float:
    """Epsilon of an opposed, aligned pair whose line passes the origin at distance d."""
    T = mu**-2 + (d**2 + L**2) / gamma**2
    D = L**2 / (mu * gamma) ** 2
    twist = (0.5 * (T + np.sqrt(T**2 - 4 * D))) ** -0.5
    apex = ((1 + d / (mu * r)) ** 2 + (1 + L**2 / r**2) / mu**2) ** -0.5
    return float(min(twist, apex))


def test_box_grasped_straight_has_closed_forms() -> None:
    yaw = 0.4
    scene = resting_scene(box_object(EXTENTS), yaw=yaw)
    local = np.array([[0.006, 0.009, 0.012], [0.0, 0.0, 0.0]])
    table = _priori(scene, _grasps(scene, local, np.zeros(2), yaw))
    expected = {
        "bound_x": [0.08, 0.08],
        "bound_y": [0.06, 0.06],
        "bound_l": [0.04, 0.04],
        "bound_r": [2.0, 2.0],
        "g_dis": np.linalg.norm(local, axis=1),
        "g_coll": [0.0, 0.0],
        "real_d_width": [0.04, 0.04],
        "real_d_dis": [np.hypot(0.009, 0.012), 0.0],
        "real_d_offset_l": [0.006, 0.0],
        "real_d_offset_a": [0.0, 0.0],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(table[name], values, atol=1e-12, err_msg=name)
    gamma = 2 / 3 * 0.8 * 0.005
    quality = [_pair_epsilon(0.02, RADIUS, 0.8, gamma, d) for d in (0.015, 0.0)]
    np.testing.assert_allclose(table["g_quality"], quality, rtol=2e-4)
    # The centre's two points lie within the patches, so the patches can do all that they can.
    assert (table.extra["real_d_quality_upper"] >= table.extra["g_quality_lower"]).all()


def test_box_grasped_askew_is_first_touched_at_an_edge() -> None:
    turn = 0.3
    scene = resting_scene(box_object((0.04, 0.04, 0.08)))
    table = _priori(scene, _grasps(scene, np.zeros((1, 3)), np.array([turn]), 0.0))
    # Each pad first meets the tilted face at its own edge, 10 mm off the middle; the next lines,
    # 5 mm further in, are 1.5 mm behind. By symmetry the two pads touch opposite places.
    across = 0.01
    travel = (0.02 + across * np.sin(turn)) / np.cos(turn)
    np.testing.assert_allclose(table["real_d_width"], 2 * np.hypot(across, travel), rtol=1e-9)
    np.testing.assert_allclose(table["real_d_offset_a"], np.arctan2(across, travel), rtol=1e-9)
    np.testing.assert_allclose(table["real_d_offset_l"], 0.0, atol=1e-12)


def test_known_motion_gives_the_posteriori_metrics() -> None:
    yaw, turn = 0.7, 0.25
    scene = resting_scene(box_object(EXTENTS), yaw=yaw)
    local = np.array([[0.004, -0.003, 0.02]])
    grasps = _grasps(scene, local, np.array([turn]), yaw)
    # In the closing the object shifts and turns about z until its faces meet the pads; in the
    # lift it rolls in the pads.
    shift = np.array([0.003, -0.001, 0.0005])
    position = np.tile(scene.position, (1, 4, 1))
    position[0, 1] += [0.0001, 0.0, 0.0]
    position[0, 2] = position[0, 1] + shift
    position[0, 3] = position[0, 2] + [0.0, 0.0, 0.1]
    quaternion = np.tile(scene.quaternion, (1, 4, 1))
    quaternion[0, 2] = quaternion_multiply(yaw_quaternion(np.array(0.21)), scene.quaternion)
    roll = turned_quaternion((1.0, 0.0, 0.0), 0.11)
    quaternion[0, 3] = quaternion_multiply(roll, quaternion[0, 2])
    points = np.array([[[[-0.02, 0.001, 0.018], [-0.02, -0.007, 0.02]],
                        [[0.02, 0.005, 0.022], [np.nan] * 3]]])  # fmt: skip
    normals = np.array([[[[1.0, 0, 0], [1.0, 0, 0]], [[-1.0, 0, 0], [np.nan] * 3]]])
    trials = _still_trials(
        scene,
        grasps,
        object_position=position,
        object_quaternion=quaternion,
        contacts=_contacts(points, normals),
        opening=np.array([0.0398]),
        push_force=np.array([31.5]),
    )
    table = compute_metrics(scene, grasps, trials)
    first, second = np.array([-0.02, -0.003, 0.019]), np.array([0.02, 0.005, 0.022])
    middle, axis = (first + second) / 2, second - first
    closing = np.array([np.cos(turn), np.sin(turn), 0.0])
    cosine = abs(axis @ closing) / np.linalg.norm(axis)
    expected = {
        "real_s_width": np.linalg.norm(axis),
        "real_s_dis": np.linalg.norm(middle),
        "real_s_offset_l": np.linalg.norm(middle - local[0]),
        "real_s_offset_a": np.arccos(cosine),
        "clo_ori_comfort": 0.21,
        "lif_ori_stability": 0.11,
        "moved": np.linalg.norm(shift),
        "sim_width": 0.0398,
        "sim_success": 1.0,
        "sim_coll": 0.0,
        "force": 31.5,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(table[name], [value], rtol=1e-9, err_msg=name)
    assert table["real_s_quality"][0] > 0


def test_comparative_metrics_vanish_where_the_fingers_touched_as_foreseen() -> None:
    yaw = 1.2
    scene = resting_scene(box_object(EXTENTS), yaw=yaw)
    grasps = _grasps(scene, [[0.0, 0.01, 0.01]] * 2, np.zeros(2), yaw)
    side = np.array([[0.0, 0.01, 0.01], [0.0, 0.013, 0.006]])
    half = np.array([0.02, 0.0, 0.0])
    points = np.stack([side - half, side + half], axis=1)[:, :, None]
    normals = np.tile([[[1.0, 0, 0]], [[-1.0, 0, 0]]], (2, 1, 1, 1))
    trials = _still_trials(scene, grasps, contacts=_contacts(points, normals))
    table = compute_metrics(scene, grasps, trials)
    np.testing.assert_allclose(table["g_offset_l"], [0.0, 0.005], atol=1e-12)
    np.testing.assert_allclose(table["g_offset_a"], [0.0, 0.0], atol=1e-9)


def test_what_does_not_exist_is_nan_and_never_zero() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = PlanarGrasp(
        np.arange(2), np.array([[0.0, 0.3, 0.04], [0.0, 0.0, 0.04]]), np.zeros(2), np.full(2, 0.07)
    )
    gone = np.full((2, 4, 3), np.nan)
    gone[:, 0] = scene.position
    turns = np.full((2, 4, 4), np.nan)
    turns[:, 0] = scene.quaternion
    trials = _still_trials(
        scene,
        grasps,
        outcome=np.full((2, 5), int(Outcome.COLLISION_IN_APPROACH)),
        collision=np.ones((2, 5), bool),
        object_position=gone,
        object_quaternion=turns,
        opening=np.full(2, np.nan),
        push_force=np.zeros(2),
    )
    table = compute_metrics(scene, grasps, trials)
    analytical = [name for name in PRIORI if name.startswith("real_d")] + ["g_quality"]
    for name in analytical:
        np.testing.assert_array_equal(np.isfinite(table[name]), [False, True], err_msg=name)
    simulated = [name for name in METRIC_NAMES if name.startswith(("real_s", "moved", "sim_w"))]
    for name in [*simulated, "clo_ori_comfort", "lif_ori_stability", "g_offset_l", "g_offset_a"]:
        assert np.isnan(table[name]).all(), name
    for name, value in (("sim_success", 0.0), ("sim_coll", 1.0), ("force", 0.0)):
        np.testing.assert_array_equal(table[name], value, err_msg=name)


def test_trials_that_diverged_are_left_out() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = _grasps(scene, np.zeros((4, 3)), np.zeros(4), 0.0)
    success, lost, diverged = Outcome.SUCCESS, Outcome.LOST_IN_LIFT, Outcome.DIVERGED
    outcome = np.array(
        [
            [success, success, lost, lost, lost],
            [success, success, lost, diverged, diverged],
            [diverged] * 5,
            [diverged, success, success, success, success],
        ],
        dtype=int,
    )
    collision = np.zeros((4, 5), bool)
    collision[1, 3] = collision[0, 4] = True
    trials = _still_trials(
        scene,
        grasps,
        outcome=outcome,
        collision=collision,
        push_force=np.array([30.0, 30.0, np.nan, np.nan]),
    )
    table = compute_metrics(scene, grasps, trials)
    np.testing.assert_allclose(table["sim_success"], [0.4, 2 / 3, np.nan, 1.0])
    np.testing.assert_array_equal(table["sim_coll"], [1.0, 0.0, np.nan, 0.0])
    np.testing.assert_array_equal(table["force"], [30.0, 30.0, np.nan, np.nan])
    np.testing.assert_array_equal(table.extra["valid_trials"], [5, 3, 0, 4])
    assert list(table.extra["outcome"]) == ["success", "success", "diverged", "diverged"]
    np.testing.assert_array_equal(table.outcomes, outcome)


def test_without_closure_the_quality_is_zero_and_certainly_so() -> None:
    # A wedge whose sides meet the pads at 50 degrees, more than atan 0.8.
    half = np.tan(np.radians(50.0)) * 0.04
    corners = [[x, y, 0.0] for x in (-half, half) for y in (-0.03, 0.03)]
    corners += [[0.0, y, 0.04] for y in (-0.03, 0.03)]
    wedge = trimesh.Trimesh(corners).convex_hull
    scene = resting_scene(mesh_object(wedge))
    center = np.array([[0.0, 0.0, 0.03]])
    grasps = PlanarGrasp(np.zeros(1, int), center, np.zeros(1), np.array([0.08]))
    table = _priori(scene, grasps)
    for name in ("g_quality", "real_d_quality"):
        assert table[name][0] == table.extra[f"{name}_lower"][0] == 0.0
    assert np.isnan(table["real_s_quality"][0])


@pytest.fixture(scope="module")
def hammer() -> trimesh.Trimesh:
    with as_file(files("gmdx_assets") / "objects" / "hammer.obj") as path:
        return trimesh.load(path, force="mesh")


def _some_grasps(scene: Scene, n: int, width: float) -> PlanarGrasp:
    rng = np.random.default_rng(2)
    world = scene.to_world(scene.object.vertices)
    center = world[rng.integers(len(world), size=n)] * [0.8, 0.8, 0.0]
    center[:, 2] = rng.uniform(0.3, 0.9, n) * world[:, 2].max()
    return PlanarGrasp(np.arange(n), center, rng.uniform(0, np.pi, n), np.full(n, width))


def test_turning_and_moving_the_world_keeps_the_priori_metrics(hammer: trimesh.Trimesh) -> None:
    obj = mesh_object(hammer)
    quaternion = turned_quaternion((1.0, 0.1, 0.0), 0.2)
    scene = resting_scene(obj, quaternion=quaternion)
    grasps = _some_grasps(scene, 12, 0.08)
    before = _priori(scene, grasps)
    turn, shift = 2.3, np.array([0.5, 0.1, 0.0])
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    moved = resting_scene(obj, quaternion=quaternion, yaw=turn)
    moved = replace(moved, position=moved.position + shift)
    turned = replace(
        grasps,
        center=grasps.center @ rotation.T + shift,
        angle=np.mod(grasps.angle + turn, np.pi),
    )
    after = _priori(moved, turned)
    assert np.isfinite(before["real_d_width"]).sum() > 3
    for name in PRIORI:
        rtol = 2e-2 if name == "real_d_quality" else 2e-4 if name == "g_quality" else 1e-7
        np.testing.assert_allclose(after[name], before[name], rtol=rtol, atol=1e-9, err_msg=name)


def test_twice_the_size_doubles_lengths_and_keeps_ratios(hammer: trimesh.Trimesh) -> None:
    obj = mesh_object(hammer)
    scene = resting_scene(obj)
    # Twice the patch as well: it makes torsion, which is a length.
    large = resting_scene(scaled_object(obj, 2.0), physics=PhysicsConfig(patch_radius=0.01))
    grasps = _some_grasps(scene, 12, 0.04)
    twice = replace(grasps, center=2 * grasps.center, width=2 * grasps.width)
    big_pads = replace(GRIPPER, pad_size=2 * GRIPPER.pad_size)
    wide = MetricConfig(lines=LineConfig(touch_tolerance=2e-3))
    before = _priori(scene, grasps, gripper=GRIPPER)
    after = _priori(large, twice, gripper=big_pads, config=wide)
    assert np.isfinite(before["real_d_width"]).sum() > 3
    for name in PRIORI:
        if name == "g_coll":  # the fingers did not grow
            continue
        factor = 2.0 if name in LENGTHS else 1.0
        rtol = 2e-2 if name == "real_d_quality" else 2e-4 if name == "g_quality" else 1e-7
        np.testing.assert_allclose(
            after[name], factor * before[name], rtol=rtol, atol=1e-9, err_msg=name
        )


def test_a_grasp_does_not_depend_on_its_batch(hammer: trimesh.Trimesh) -> None:
    scene = resting_scene(mesh_object(hammer), quaternion=turned_quaternion((1.0, 2.0, 3.0), 0.7))
    grasps = _some_grasps(scene, 9, 0.08)
    rng = np.random.default_rng(0)
    quaternion = rng.standard_normal((9, 4, 4))
    quaternion /= np.linalg.norm(quaternion, axis=2, keepdims=True)
    trials = _still_trials(
        scene,
        grasps,
        object_quaternion=quaternion,
        object_position=rng.standard_normal((9, 4, 3)),
        contacts=_contacts(rng.normal(0, 0.02, (9, 2, 2, 3)), rng.standard_normal((9, 2, 2, 3))),
    )
    quality = QualityConfig(rtol_pair=0.05, rtol_patch=0.2)
    config = MetricConfig(quality=quality)  # quick: only sameness matters
    unit = trials.contacts.normals / np.linalg.norm(trials.contacts.normals, axis=3, keepdims=True)
    trials = replace(trials, contacts=replace(trials.contacts, normals=unit))
    whole = compute_metrics(scene, grasps, trials, config=config)
    parts = [
        compute_metrics(scene, grasps[rows], _rows(trials, rows), config=config)
        for rows in (slice(0, 1), slice(1, 3), slice(3, 9))
    ]
    for name in METRIC_NAMES:
        together = np.concatenate([part[name] for part in parts])
        np.testing.assert_array_equal(together, whole[name], err_msg=name)


def _rows(trials: TrialResults, rows: slice) -> TrialResults:
    whole = ("gripper", "engine", "steps", "step_seconds", "seconds")
    parts = {f.name: getattr(trials, f.name)[rows] for f in fields(trials) if f.name not in whole}
    return replace(trials, **parts)


def test_normalised_columns_are_the_exact_ratio(hammer: trimesh.Trimesh) -> None:
    scene = resting_scene(mesh_object(hammer))
    table = _priori(scene, _some_grasps(scene, 8, 0.08))
    for name in METRIC_NAMES:
        if name.endswith("_norm"):
            ratio = table[name.removesuffix("_norm")] / table["bound_l"]
            np.testing.assert_array_equal(table[name], ratio)


def test_bounds_enclose_every_quality(hammer: trimesh.Trimesh) -> None:
    scene = resting_scene(mesh_object(hammer))
    table = _priori(scene, _some_grasps(scene, 12, 0.08))
    for name in ("g_quality", "real_d_quality"):
        exists = np.isfinite(table[name])
        lower, upper = table.extra[f"{name}_lower"], table.extra[f"{name}_upper"]
        assert (lower[exists] >= 0).all()
        assert (lower[exists] <= table[name][exists]).all()
        np.testing.assert_array_equal(table[name], upper)
        np.testing.assert_array_equal(np.isfinite(lower), exists)


def test_table_names_its_columns_and_refuses_others() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = _grasps(scene, np.zeros((2, 3)), np.zeros(2), 0.0)
    table = _priori(scene, grasps)
    assert tuple(table.values) == METRIC_NAMES
    assert len(table) == 2
    frame = table.to_pandas()
    assert list(frame.columns) == [*METRIC_NAMES, *table.extra]
    assert frame.shape[0] == 2
    assert set(table.cost) >= {
        "epsilon",
        "object",
        "grasp",
        "contact",
        "trial",
        "epsilon/g_quality",
    }
    with pytest.raises(MetricError, match="bound_x"):
        table["quality"]
    with pytest.raises(MetricError, match="2 grasps but the trials of 1"):
        compute_metrics(scene, grasps, _still_trials(scene, grasps[:1]))
    with pytest.raises(MetricError, match="in another order"):
        compute_metrics(scene, grasps, _still_trials(scene, grasps[::-1]))


def _stage_names(*stages: str) -> set[str]:
    return {metric.name for metric in METRICS if metric.stage in stages}


def test_stages_give_what_is_asked_and_what_it_rests_on() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = _grasps(scene, np.zeros((2, 3)), np.zeros(2), 0.0)
    whole = _priori(scene, grasps)
    cheap = compute_metrics(scene, grasps, stages=("grasp",))
    assert set(cheap.values) == _stage_names("object", "grasp")
    assert cheap.outcomes is None
    assert cheap.contacts is None
    priori = compute_metrics(scene, grasps)
    assert set(priori.values) == {metric.name for metric in METRICS if metric.kind == "priori"}
    assert set(priori.evidence.qualities) == {"g_quality", "real_d_quality"}
    without = compute_metrics(scene, grasps, _still_trials(scene, grasps), stages=("trial",))
    assert set(without.values) == _stage_names("object", "contact", "trial")
    for table in (cheap, priori, without):
        for name, value in table.values.items():
            np.testing.assert_array_equal(value, whole[name], err_msg=name)
    with pytest.raises(MetricError, match=r"'force' was not computed.*'trial'.*object, grasp"):
        cheap["force"]


def test_a_cascade_goes_on_with_the_grasps_that_are_left() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = _grasps(scene, np.array([[0, 0, 0], [0, 0, 0.004], [0.003, 0, 0]]), np.zeros(3), 0.1)
    whole = _priori(scene, grasps)
    left = np.array([2, 0])
    known = compute_metrics(scene, grasps, stages=("contact", "epsilon")).take(left)
    trials = _still_trials(scene, grasps[left])
    rest = compute_metrics(scene, grasps[left], trials, known=known)
    assert tuple(rest.values) == METRIC_NAMES
    assert rest.stages == STAGES
    for name, value in rest.values.items():
        np.testing.assert_array_equal(value, whole[name][left], err_msg=name)
    assert "contact" not in rest.cost  # was paid before
    assert set(rest.evidence.qualities) == {"real_s_quality"}
    with pytest.raises(MetricError, match="known metrics of 2, or in another order"):
        compute_metrics(scene, grasps[left[::-1]], known=known)


def test_stages_that_cannot_be_computed_are_refused() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = _grasps(scene, np.zeros((1, 3)), np.zeros(1), 0.0)
    with pytest.raises(MetricError, match="stage 'trial' needs trials"):
        compute_metrics(scene, grasps, stages=("trial_epsilon",))
    with pytest.raises(MetricError, match=r"no stage 'quality': there are object, grasp"):
        compute_metrics(scene, grasps, stages=("quality",))
    with pytest.raises(MetricError, match=r"a list of names, as \['epsilon'\]"):
        compute_metrics(scene, grasps, stages="epsilon")
    with pytest.raises(MetricError, match=r"no stage is asked for: name some of object, grasp"):
        compute_metrics(scene, grasps, stages=())
    known = compute_metrics(scene, grasps, stages=("object",))
    assert compute_metrics(scene, grasps, stages=(), known=known).stages == ("object",)


def test_what_is_known_keeps_its_outcomes_without_the_trials() -> None:
    scene = resting_scene(box_object(EXTENTS))
    grasps = _grasps(scene, np.zeros((1, 3)), np.zeros(1), 0.0)
    known = compute_metrics(scene, grasps, _still_trials(scene, grasps))
    again = compute_metrics(scene, grasps, known=known)
    assert again.stages == known.stages
    assert known.outcomes is not None
    assert again.outcomes is not None
    np.testing.assert_array_equal(again.outcomes, known.outcomes)


def test_configurations_that_make_no_sense_are_refused() -> None:
    for radius in (0.0, np.inf):
        with pytest.raises(ConfigError, match="patch_radius"):
            PhysicsConfig(patch_radius=radius)
    with pytest.raises(ConfigError, match="rtol_pair"):
        QualityConfig(rtol_pair=float("nan"))
    with pytest.raises(ConfigError, match="grid"):
        LineConfig(grid=(0, 5))
