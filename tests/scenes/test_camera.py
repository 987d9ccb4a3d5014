"""Rendering against closed forms and against an independent ray caster."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from gmdx.errors import ConfigError, UsageError
from gmdx.geometry import random_quaternion
from gmdx.rng import generator
from gmdx.scenes.camera import CameraConfig, DepthImage, camera_pose, render
from gmdx.scenes.scene import Scene
from tests.support import (
    box_object,
    mesh_object,
    resting_scene,
    sphere_object,
    turned_quaternion,
)

FOUR_VIEWS = CameraConfig(views=4)


def in_pixels(image: DepthImage, points: np.ndarray) -> np.ndarray:
    """World points projected into the image: u, v and depth."""
    camera = (points - image.pose[:3, 3]) @ image.pose[:3, :3]
    pixels = camera @ image.intrinsics.T
    return np.column_stack([pixels[:, :2] / pixels[:, 2:], camera[:, 2]])


def to_points(image: DepthImage) -> np.ndarray:
    """The image as a world point a pixel."""
    v, u = np.indices(image.depth.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(image.intrinsics).T
    return rays * image.depth[..., None] @ image.pose[:3, :3].T + image.pose[:3, 3]


def first_hit(eye: np.ndarray, rays: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Smallest t at which eye + t ray meets a triangle (f, 3, 3); by signed volumes, all pairs."""
    a, b, c = np.moveaxis(triangles - eye, 1, 0)
    sides = [rays @ np.cross(p, q).T for p, q in ((a, b), (b, c), (c, a))]
    met = np.all(np.greater_equal(sides, 0), axis=0) | np.all(np.less_equal(sides, 0), axis=0)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a * normal).sum(-1) / (rays @ normal.T)
    nearest: np.ndarray = np.where(met & (t > 0), t, np.inf).min(axis=1)
    return nearest


def cup(outer: float = 0.03, inner: float = 0.027, height: float = 0.08) -> trimesh.Trimesh:
    """A straight-walled cup, as its profile revolved about z."""
    floor = 0.004
    profile = [[0, 0], [outer, 0], [outer, height], [inner, height], [inner, floor], [0, floor]]
    mesh = trimesh.creation.revolve(np.array(profile), sections=64)
    assert mesh.is_watertight
    assert mesh.volume > 0
    return mesh


def test_box_from_above_by_closed_form() -> None:
    obj = box_object((0.06, 0.04, 0.03))
    image = render(resting_scene(obj))
    assert image.depth.shape == image.segmentation.shape == (480, 640)
    assert image.depth.dtype == np.float32
    assert image.segmentation.dtype == np.uint8

    # The top face is the whole silhouette: 0.47 m below the camera, f pixels a unit of slope.
    focal = 240 / np.tan(0.6109 / 2)
    columns = np.abs(np.arange(640) - 319.5) < focal * 0.03 / 0.47
    rows = np.abs(np.arange(480) - 239.5) < focal * 0.02 / 0.47
    expected = rows[:, None] & columns[None, :]
    np.testing.assert_array_equal(image.segmentation == 1, expected)
    np.testing.assert_allclose(image.depth, np.where(expected, 0.47, 0.5), atol=1e-6)


def test_image_axes_are_x_right_and_y_up() -> None:
    scene = resting_scene(box_object((0.02, 0.02, 0.02)))
    moved = replace(scene, position=np.array([0.05, 0.08, 0.01]))
    v, u = np.nonzero(render(moved).segmentation)
    assert u.mean() > 319.5 + 50
    assert v.mean() < 239.5 - 80


def test_turning_the_scene_turns_the_image() -> None:
    obj = box_object((0.06, 0.03, 0.02))
    flat = render(resting_scene(obj), config=CameraConfig(width=480))
    turned = render(resting_scene(obj, yaw=np.pi / 2), config=CameraConfig(width=480))
    np.testing.assert_allclose(np.rot90(flat.depth), turned.depth, atol=1e-6)


@pytest.mark.parametrize("view", range(4))
def test_sphere_by_closed_form(view: int) -> None:
    radius = 0.03
    image = render(
        resting_scene(sphere_object(radius, subdivisions=6)), view=view, config=FOUR_VIEWS
    )
    v, u = np.indices(image.depth.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(image.intrinsics).T
    center = (np.array([0, 0, radius]) - image.pose[:3, 3]) @ image.pose[:3, :3]
    a, b, c = (rays**2).sum(-1), rays @ center, center @ center - radius**2
    inside = b**2 - a * c
    table = -image.pose[2, 3] / (rays @ image.pose[2, :3])
    expected = np.where(inside > 0, (b - np.sqrt(np.abs(inside))) / a, table)
    # The polyhedron lies within 10 micrometres of the sphere; its outline is within a pixel.
    clear = np.abs(inside) > 0.02 * radius**2
    assert clear.mean() > 0.97
    np.testing.assert_array_equal(image.segmentation[clear] == 1, inside[clear] > 0)
    np.testing.assert_allclose(image.depth[clear], expected[clear], atol=1e-4)


def test_poses_are_rigid_and_aim_at_the_origin() -> None:
    config = CameraConfig(views=6, tilt=0.5, distance=0.7)
    poses = [camera_pose(view, config) for view in range(6)]
    for pose in poses:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
        np.testing.assert_allclose(pose[:3, 3] + 0.7 * pose[:3, 2], 0, atol=1e-12)
    np.testing.assert_allclose(poses[0][:3, 2], [0, 0, -1])
    for pose in poses[1:]:
        assert np.arccos(-pose[2, 2]) == pytest.approx(0.5)


@pytest.mark.parametrize("view", range(4))
def test_points_of_the_image_lie_on_the_table_and_on_the_box(view: int) -> None:
    extents = np.array([0.07, 0.04, 0.05])
    quaternion = turned_quaternion((0, 0, 1), 0.7)
    scene = resting_scene(box_object(tuple(extents)), quaternion=quaternion)
    image = render(scene, view=view, config=FOUR_VIEWS)
    points = to_points(image)
    np.testing.assert_allclose(points[image.segmentation == 0][:, 2], 0, atol=1e-6)
    on_box = scene.to_object(points[image.segmentation == 1])
    outside = np.max(np.abs(on_box) - extents / 2, axis=1)
    np.testing.assert_allclose(outside, 0, atol=1e-6)


@pytest.mark.parametrize("view", [0, 2])
def test_corners_of_the_box_are_where_they_project(view: int) -> None:
    scene = resting_scene(box_object((0.07, 0.04, 0.05)), yaw=0.3)
    image = render(scene, view=view, config=FOUR_VIEWS)
    corners = in_pixels(image, scene.to_world(scene.object.vertices))
    v, u = np.nonzero(image.segmentation)
    for seen, projected in ((u, corners[:, 0]), (v, corners[:, 1])):
        assert 0 <= seen.min() - projected.min() < 1.5
        assert 0 <= projected.max() - seen.max() < 1.5


@pytest.mark.parametrize("shape", ["cup", "torus", "blob", "shell"])
def test_agrees_with_an_independent_ray_caster(shape: str) -> None:
    rng = generator(0, "camera", shape)
    if shape == "cup":
        mesh = cup()
    elif shape == "torus":
        mesh = trimesh.creation.torus(0.04, 0.01)
    elif shape == "blob":
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
        mesh.vertices *= 1 + 0.2 * rng.standard_normal((len(mesh.vertices), 1))
    else:
        # A solid of two skins, half a millimetre apart.
        inside = trimesh.creation.icosphere(subdivisions=3, radius=0.0295)
        inside.invert()
        mesh = trimesh.util.concatenate(
            [trimesh.creation.icosphere(subdivisions=3, radius=0.03), inside]
        )
    obj = mesh_object(mesh)
    scene = resting_scene(obj, quaternion=random_quaternion(rng))
    view = int(rng.integers(4))
    image = render(scene, view=view, config=FOUR_VIEWS)

    corners = in_pixels(image, scene.to_world(obj.vertices))
    low, high = corners[:, :2].min(axis=0) - 5, corners[:, :2].max(axis=0) + 5
    pixels = np.round(rng.uniform(low, high, (800, 2))).astype(int)
    pixels = pixels[((pixels >= 0) & (pixels < [640, 480])).all(axis=1)]
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(image.intrinsics).T
    rays = rays @ image.pose[:3, :3].T
    table = -image.pose[2, 3] / rays[:, 2]
    corners = scene.to_world(obj.vertices)[obj.faces]
    expected = np.minimum(first_hit(image.pose[:3, 3], rays, corners), table)

    depth = image.depth[pixels[:, 1], pixels[:, 0]]
    wrong = np.abs(depth - expected) > 2e-6
    # A ray that grazes an edge within rounding may go either way.
    assert wrong.sum() <= 1
    seen = image.segmentation[pixels[:, 1], pixels[:, 0]] == 1
    np.testing.assert_array_equal(seen[~wrong], (expected < table)[~wrong])
    assert 0.1 < seen.mean() < 0.95


def test_agrees_with_mujoco_at_every_pixel() -> None:
    rng = generator(0, "camera", "mujoco")
    obj = mesh_object(cup())
    scene = resting_scene(obj, quaternion=random_quaternion(rng))
    image = render(scene)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="cup", uservert=obj.vertices.ravel(), userface=obj.faces.ravel())
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="cup", pos=scene.position, quat=scene.quaternion
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    v, u = np.indices(image.depth.shape)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(image.intrinsics).T
    rays = (rays @ image.pose[:3, :3].T).reshape(-1, 3)
    geom, depth = np.empty(len(rays), np.int32), np.empty(len(rays))
    eye = image.pose[:3, 3].copy()
    mujoco.mj_multiRay(
        model, data, eye, rays.ravel(), None, True, -1, geom, depth, None, len(rays), 10.0
    )
    same = np.abs(image.depth.ravel() - depth) < 2e-6
    # Rays that graze an edge of the outline may go either way.
    assert (~same).sum() < 5
    seen = image.segmentation.ravel()
    np.testing.assert_array_equal(seen[same] == 1, geom[same] == 0)
    assert 5000 < seen.sum() < 100_000


def test_inside_of_a_cup_is_deeper_than_its_rim() -> None:
    image = render(resting_scene(mesh_object(cup())))
    middle = image.depth[238:242, 318:322]
    np.testing.assert_allclose(middle, 0.5 - 0.004, atol=1e-6)
    assert (image.segmentation[238:242, 318:322] == 1).all()
    rim = image.depth[image.segmentation == 1].min()
    assert rim == pytest.approx(0.5 - 0.08, abs=1e-6)


def test_outline_has_no_cracks() -> None:
    # Edges of the two triangles of the top face run exactly through pixel centres.
    cube = render(resting_scene(box_object((0.06, 0.06, 0.03)))).segmentation
    ball = render(resting_scene(sphere_object(0.03, subdivisions=5))).segmentation
    for segmentation in (cube, ball):
        for line in [*segmentation, *segmentation.T]:
            inside = np.flatnonzero(line)
            assert len(inside) == 0 or len(inside) == inside[-1] - inside[0] + 1


def test_what_lies_under_the_table_is_not_seen() -> None:
    scene = resting_scene(box_object((0.04, 0.04, 0.04)))
    sunk = replace(scene, position=np.array([0.0, 0.0, -0.021]))
    image = render(sunk)
    assert not image.segmentation.any()
    np.testing.assert_allclose(image.depth, 0.5, atol=1e-6)


def test_object_partly_or_wholly_out_of_the_image() -> None:
    scene = resting_scene(box_object((0.1, 0.1, 0.05)))
    half = render(replace(scene, position=np.array([0.21, 0.0, 0.025])))
    assert half.segmentation[240, 639] == 1
    assert half.segmentation[240, 320] == 0
    for x, y in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        gone = render(replace(scene, position=np.array([x, y, 0.025])))
        assert not gone.segmentation.any()


def test_what_cannot_be_rendered_is_said() -> None:
    scene = resting_scene(box_object((0.04, 0.04, 0.04)))
    with pytest.raises(UsageError, match="view 1 does not exist"):
        render(scene, view=1)
    tall: Scene = resting_scene(box_object((0.04, 0.04, 0.52)))
    with pytest.raises(ConfigError, match="reaches up to the camera"):
        render(tall)
    with pytest.raises(ConfigError, match="horizon"):
        CameraConfig(views=2, tilt=1.3)
    with pytest.raises(ConfigError, match="at least 1"):
        CameraConfig(width=0)
    with pytest.raises(ConfigError, match="field_of_view"):
        CameraConfig(field_of_view=0.0)
