from dataclasses import replace
from importlib.resources import as_file, files
from typing import Any

import numpy as np
import pytest
import trimesh

from gmdx.errors import ConfigError
from gmdx.grasps.contact import LineConfig, closing_contacts
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.scenes.gripper import Gripper, load_gripper
from gmdx.scenes.scene import Scene
from tests.support import (
    box_object,
    mesh_object,
    resting_scene,
    scaled_object,
    sphere_object,
    turned_quaternion,
)

GRIPPER = replace(load_gripper(), pad_size=np.array([0.02, 0.02]))  # 5 mm between lines


def _grasps(center: list[list[float]], angle: list[float], width: float = 0.08) -> PlanarGrasp:
    n = len(center)
    return PlanarGrasp(np.arange(n), np.array(center), np.array(angle), np.full(n, width))


def _random_grasps(scene: Scene, n: int, width: float = 0.1) -> PlanarGrasp:
    rng = np.random.default_rng(3)
    top = float(scene.to_world(scene.object.vertices)[:, 2].max())
    center = np.column_stack([rng.uniform(-0.02, 0.02, (n, 2)), rng.uniform(0.2, 0.9, n) * top])
    return PlanarGrasp(np.arange(n), center, rng.uniform(0, np.pi, n), np.full(n, width))


def _bundled(name: str) -> trimesh.Trimesh:
    with as_file(files("gmdx_assets") / "objects" / f"{name}.obj") as path:
        return trimesh.load(path, force="mesh")


def test_box_is_touched_on_its_faces() -> None:
    scene = resting_scene(box_object((0.04, 0.06, 0.08)))
    contacts = closing_contacts(
        scene, _grasps([[0.005, 0.003, 0.03]], [0.0]), gripper=GRIPPER, config=LineConfig()
    )
    assert contacts.pads.valid.all()  # both faces are wider than the pads
    points, normals = contacts.pads.points[0], contacts.pads.normals[0]
    np.testing.assert_allclose(points[0, :, 0], -0.02, atol=1e-15)
    np.testing.assert_allclose(points[1, :, 0], 0.02, atol=1e-15)
    np.testing.assert_allclose(normals[0], np.tile([1.0, 0.0, 0.0], (25, 1)), atol=1e-15)
    np.testing.assert_allclose(normals[1], np.tile([-1.0, 0.0, 0.0], (25, 1)), atol=1e-15)
    np.testing.assert_allclose(
        contacts.pads.means[0], [[-0.02, 0.003, -0.01], [0.02, 0.003, -0.01]], atol=1e-15
    )
    np.testing.assert_allclose(
        contacts.center.points[0, :, 0], [[-0.02, 0.003, -0.01], [0.02, 0.003, -0.01]], atol=1e-15
    )
    size = np.ptp(points[0], axis=0)
    np.testing.assert_allclose(size, [0, *GRIPPER.pad_size], atol=1e-15)


def test_turned_box_is_touched_along_the_edges_that_come_first() -> None:
    # Closing at 30 degrees to the faces' normals, each pad meets one face near one side only.
    scene = resting_scene(box_object((0.03, 0.03, 0.06)))
    contacts = closing_contacts(scene, _grasps([[0.0, 0.0, 0.03]], [np.pi / 6]), gripper=GRIPPER)
    axis = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    along = contacts.pads.points[0] @ axis
    for pad, sign in ((0, 1.0), (1, -1.0)):
        travel = sign * along[pad][contacts.pads.valid[0, pad]]
        assert len(travel) == 5  # one column of the grid: the next is 5 mm tan 30 behind
        assert np.ptp(travel) <= 1e-3


def test_ball_is_touched_around_its_poles() -> None:
    scene = resting_scene(sphere_object(0.03))
    grasps = _grasps([[0.0, 0.0, 0.03], [0.002, -0.001, 0.036]], [0.4, 1.9])
    contacts = closing_contacts(scene, grasps, gripper=GRIPPER)
    radius = np.linalg.norm(contacts.pads.points, axis=3)
    # The polyhedron lies inside the ball by at most its facets' sagitta.
    assert np.nanmax(radius) <= 0.03 + 1e-12
    assert np.nanmin(radius) >= 0.03 * 0.998
    np.testing.assert_allclose(
        np.linalg.norm(contacts.center.points[0, :, 0], axis=1), 0.03, rtol=2e-3
    )
    depth = 0.03 - np.abs(contacts.pads.points[0] @ [np.cos(0.4), np.sin(0.4), 0.0])
    assert np.nanmax(depth) <= 1e-3 + 1e-4


def test_tolerance_decides_what_belongs_to_the_first_touch() -> None:
    scene = resting_scene(sphere_object(0.03))
    grasps = _grasps([[0.0, 0.0, 0.03]], [0.0])
    counts = [
        closing_contacts(
            scene, grasps, gripper=GRIPPER, config=LineConfig(touch_tolerance=t)
        ).pads.valid[0, 0].sum()
        for t in (0.0, 0.5e-3, 0.95e-3, 0.01)
    ]  # fmt: skip
    # Sagittas of lines 0, 5, 7.1 and 14 mm off the pole of a ball of 30 mm: 0, .42, .84, 3.5 mm
    assert counts == [1, 5, 9, 25]


def test_what_no_line_meets_is_nan_and_never_zero() -> None:
    scene = resting_scene(box_object((0.04, 0.06, 0.08)))
    grasps = PlanarGrasp(
        np.arange(3),
        np.array([[0.0, 0.2, 0.04], [0.0, 0.0, 0.04], [0.0, 0.0, 0.04]]),
        np.zeros(3),
        np.array([0.08, 0.03, 0.08]),  # far away; fingers inside the box; around it
    )
    contacts = closing_contacts(scene, grasps, gripper=GRIPPER)
    # The line through the centre comes from outside the object, whatever the opening.
    for found, expected in (
        (contacts.center, [False, True, True]),
        (contacts.pads, [False, False, True]),
    ):
        np.testing.assert_array_equal(found.both, expected)
        missed = ~np.array(expected)
        assert not found.valid[missed].any()
        assert np.isnan(found.points[missed]).all()
        assert np.isnan(found.normals[missed]).all()
        assert np.isnan(found.means[missed]).all()


@pytest.mark.parametrize("name", ["mug", "hammer", "spoon"])
def test_contacts_lie_on_the_surface_and_face_each_other(name: str) -> None:
    mesh = _bundled(name)
    mesh.apply_scale(0.05 / np.sort(mesh.extents)[1])
    scene = resting_scene(
        mesh_object(mesh), quaternion=turned_quaternion((1.0, 2.0, 0.5), 0.7), yaw=0.4
    )
    grasps = _random_grasps(scene, 25)
    contacts = closing_contacts(scene, grasps, gripper=GRIPPER)
    assert contacts.pads.both.any()
    # In millimetres: the reference's tolerances are absolute, and coarse for triangles of 1e-3.
    surface = trimesh.Trimesh(1e3 * scene.object.vertices, scene.object.faces, process=False)
    axis = grasps.axis @ scene.rotation
    for pad, sign in ((0, 1.0), (1, -1.0)):
        valid = contacts.pads.valid[:, pad]
        points = contacts.pads.points[:, pad][valid]
        _, distance, _ = trimesh.proximity.closest_point_naive(surface, 1e3 * points)
        assert 1e-3 * distance.max() < 1e-9
        facing = np.einsum("nki,ni->nk", contacts.pads.normals[:, pad], sign * axis)[valid]
        assert (facing > 0).all()
        lengths = np.linalg.norm(contacts.pads.normals[:, pad][valid], axis=1)
        np.testing.assert_allclose(lengths, 1.0, rtol=1e-12)


def test_turning_and_moving_the_world_changes_nothing() -> None:
    obj = mesh_object(_bundled("hammer"))
    quaternion = turned_quaternion((1.0, 0.2, 0.0), 1.1)
    scene = resting_scene(obj, quaternion=quaternion)
    grasps = _random_grasps(scene, 30)
    turn, shift = 0.9, np.array([0.3, -0.2, 0.0])
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    moved = resting_scene(obj, quaternion=quaternion, yaw=turn)
    moved = replace(moved, position=moved.position + shift)
    angle = grasps.angle + turn
    turned = replace(grasps, center=grasps.center @ rotation.T + shift, angle=np.mod(angle, np.pi))
    before = closing_contacts(scene, grasps, gripper=GRIPPER)
    after = closing_contacts(moved, turned, gripper=GRIPPER)
    # Past half a turn the axis is the same but points the other way: the pads swap.
    swap = angle >= np.pi
    expected = np.where(swap[:, None, None], before.pads.means[:, ::-1], before.pads.means)
    assert np.isfinite(expected).any()
    np.testing.assert_allclose(after.pads.means, expected, atol=1e-9)
    one, other = before.center.points[:, :, 0], after.center.points[:, :, 0]
    np.testing.assert_allclose(other, np.where(swap[:, None, None], one[:, ::-1], one), atol=1e-9)


def _doubled(gripper: Gripper) -> Gripper:
    return replace(gripper, pad_size=2 * gripper.pad_size, stroke=2 * gripper.stroke)


def test_twice_the_size_doubles_every_length() -> None:
    obj = mesh_object(_bundled("mug"))
    scene, large = resting_scene(obj), resting_scene(scaled_object(obj, 2.0))
    grasps = _random_grasps(scene, 20)
    twice = replace(grasps, center=2 * grasps.center, width=2 * grasps.width)
    before = closing_contacts(scene, grasps, gripper=GRIPPER, config=LineConfig())
    after = closing_contacts(
        large, twice, gripper=_doubled(GRIPPER), config=LineConfig(touch_tolerance=2e-3)
    )
    np.testing.assert_allclose(after.pads.points, 2 * before.pads.points, atol=1e-9)
    np.testing.assert_allclose(after.pads.normals, before.pads.normals, atol=1e-9)


def test_contacts_of_a_grasp_do_not_depend_on_its_batch() -> None:
    scene = resting_scene(mesh_object(_bundled("hammer")))
    grasps = _random_grasps(scene, 40)
    together = closing_contacts(scene, grasps, gripper=GRIPPER)
    for some in (slice(7, 8), slice(3, 40)):
        alone = closing_contacts(scene, grasps[some], gripper=GRIPPER)
        for one, other in ((alone.center, together.center), (alone.pads, together.pads)):
            assert one.points.tobytes() == other.points[some].tobytes()
            assert one.normals.tobytes() == other.normals[some].tobytes()


@pytest.mark.parametrize("setting", [{"grid": (0, 5)}, {"touch_tolerance": -1e-3}])
def test_lines_that_make_no_sense_are_refused(setting: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="a grid of 1 x 1 or more"):
        LineConfig(**setting)
