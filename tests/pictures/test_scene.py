"""Pictures of scenes: what is drawn lies where an independent projection says it must."""

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

from gmdx.errors import DatasetError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.metrics.table import METRIC_NAMES
from gmdx.pictures.figure import DrawConfig, metric_named, save_figure
from gmdx.pictures.scene import draw_scene, grasp_rectangles, project
from gmdx.scenes.camera import CameraConfig, DepthImage, render
from tests.support import box_object, resting_scene

FOCAL, DISTANCE = 600.0, 0.5


def box_image() -> DepthImage:
    """A box 40 x 60 x 30 mm seen from 0.5 m straight above, drawn pixel by pixel."""
    v, u = np.mgrid[0:480, 0:640]
    x = (u - 319.5) / FOCAL * (DISTANCE - 0.03)
    y = (v - 239.5) / FOCAL * (DISTANCE - 0.03)
    box = (np.abs(x) < 0.02) & (np.abs(y) < 0.03)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = DISTANCE
    return DepthImage(
        depth=np.where(box, DISTANCE - 0.03, DISTANCE).astype(np.float32),
        segmentation=box.astype(np.uint8),
        intrinsics=np.array([[FOCAL, 0, 319.5], [0, FOCAL, 239.5], [0, 0, 1]]),
        pose=pose,
    )


def some_grasps(n: int, seed: int = 0) -> PlanarGrasp:
    rng = np.random.default_rng(seed)
    center = rng.uniform([-0.02, -0.03, 0.005], [0.02, 0.03, 0.03], (n, 3))
    return PlanarGrasp(np.arange(n), center, rng.uniform(0, np.pi, n), rng.uniform(0.04, 0.08, n))


def one_grasp(angle: float = 0.0, grasp_id: int = 4) -> PlanarGrasp:
    return PlanarGrasp(
        np.array([grasp_id]), np.array([[0.01, -0.02, 0.02]]), np.array([angle]), np.array([0.06])
    )


def texts(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.texts)


def grasp_lines(figure: Figure) -> list[np.ndarray]:
    lines = [c for c in figure.axes[0].collections if type(c) is LineCollection]
    return [np.asarray(segment) for segment in lines[-1].get_segments()]


def pixels_of(figure: Figure) -> np.ndarray:
    figure.canvas.draw()
    rgba: np.ndarray = np.asarray(figure.canvas.buffer_rgba())  # type: ignore[attr-defined]
    return rgba


def test_corners_fall_on_the_pixels_of_a_pinhole() -> None:
    per_metre = FOCAL / (DISTANCE - 0.02)
    corners = project(grasp_rectangles(one_grasp(), 0.02), box_image())[0]
    expected = [
        (319.5 + per_metre * x, 239.5 - per_metre * y)
        for x, y in [(-0.02, -0.01), (-0.02, -0.03), (0.04, -0.03), (0.04, -0.01)]
    ]
    assert corners == pytest.approx(np.array(expected), abs=1e-9)
    turned = project(grasp_rectangles(one_grasp(np.pi / 2), 0.02), box_image())[0]
    expected = [
        (319.5 + per_metre * x, 239.5 - per_metre * y)
        for x, y in [(0.0, -0.05), (0.02, -0.05), (0.02, 0.01), (0.0, 0.01)]
    ]
    assert turned == pytest.approx(np.array(expected), abs=1e-9)


@pytest.mark.parametrize("view", range(3))
def test_a_grasp_on_the_top_face_covers_it_in_every_view(view: int) -> None:
    config = CameraConfig(views=3)
    scene = resting_scene(box_object((0.05, 0.03, 0.02)), yaw=0.4)
    image = render(scene, view=view, config=config)
    top = PlanarGrasp(
        np.array([0]), np.array([[0.0, 0.0, 0.02]]), np.array([0.4]), np.array([0.05])
    )
    corners = project(grasp_rectangles(top, 0.03), image)[0]
    height = image.pose[2, 3] + _rays(image) @ image.pose[2, :3]
    face = (image.segmentation == 1) & (np.abs(height - 0.02) < 2e-4)
    inside = _inside(corners, image.depth.shape)
    # What differs is the rim, a pixel wide.
    assert np.logical_xor(face, inside).sum() < 0.03 * face.sum()
    assert face.sum() > 3000


def _rays(image: DepthImage) -> np.ndarray:
    """Points of the camera's frame that the pixels show."""
    v, u = np.mgrid[0 : image.depth.shape[0], 0 : image.depth.shape[1]]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(image.intrinsics).T
    points: np.ndarray = rays * image.depth[..., None].astype(float)
    return points


def _inside(corners: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    signs = [
        (b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    return np.logical_or(np.all(np.array(signs) > 0, axis=0), np.all(np.array(signs) < 0, axis=0))


def test_pads_are_painted_in_the_colour_of_the_value_where_they_stand() -> None:
    figure = draw_scene(box_image(), one_grasp(), np.array([0.2]), metric="sim_success")
    rgba = pixels_of(figure)
    per_metre = FOCAL / (DISTANCE - 0.02)
    for x in (-0.02, 0.04):
        middle = (319.5 + per_metre * x, 239.5 + per_metre * 0.02)
        column, row = figure.axes[0].transData.transform(middle)
        painted = rgba[rgba.shape[0] - 1 - int(row), int(column), :3] / 255
        assert painted == pytest.approx(colormaps["plasma"](0.2)[:3], abs=0.01)


def test_values_are_coloured_on_one_scale_whatever_is_drawn() -> None:
    grasps, values = some_grasps(50), np.linspace(0.0, 0.05, 50)
    figure = draw_scene(
        box_image(), grasps, values, metric="moved", highlight=[7], config=DrawConfig(most=10)
    )
    assert figure.axes[2].get_ylim() == pytest.approx((0.0, 0.05))
    assert figure.axes[2].get_ylabel() == "moved (m)"
    assert len(grasp_lines(figure)) == 10 * 8
    assert "50 grasps, 10 drawn" in texts(figure)
    corners = project(grasp_rectangles(grasps[np.array([7])], 0.02), box_image())[0]
    assert any(np.allclose(segment, corners[:2]) for segment in grasp_lines(figure))
    everything = draw_scene(
        box_image(), grasps, values, metric="moved", config=DrawConfig(most=None)
    )
    assert len(grasp_lines(everything)) == 50 * 8


def test_grasps_without_a_value_are_grey_and_counted() -> None:
    values = np.array([0.1, np.nan, 0.3, np.nan, 0.2])
    figure = draw_scene(box_image(), some_grasps(5), values, metric="g_quality", title="box")
    assert "box, 5 grasps, 2 without a value (grey)" in texts(figure)
    lines = next(c for c in figure.axes[0].collections if type(c) is LineCollection)
    colors = lines.get_colors()[4::8]
    grey = np.ptp(colors[:, :3], axis=1) < 1e-6
    assert grey.tolist() == [True, True, False, False, False]
    order = colors[2:, :3]
    assert order == pytest.approx(colormaps["plasma"](np.array([0.0, 0.5, 1.0]))[:, :3], abs=5e-3)


def test_the_ruler_is_true_on_the_table() -> None:
    figure = draw_scene(box_image(), some_grasps(5), np.arange(5.0), metric="force")
    label = next(t.get_text() for t in figure.axes[0].texts if "on the table" in t.get_text())
    ends = np.ptp(figure.axes[0].lines[0].get_xdata())
    assert ends == pytest.approx(float(label.split()[0]) * 1e-3 * FOCAL / DISTANCE)


def test_depth_is_shown_in_metres() -> None:
    figure = draw_scene(box_image(), some_grasps(3), np.arange(3.0), metric="force")
    scale = figure.axes[1]
    assert scale.get_xlim() == pytest.approx((0.47, 0.5), abs=1e-6)
    assert scale.texts[0].get_text() == "depth (m)"


@pytest.mark.parametrize(
    ("values", "limits"),
    [([2.0, 2.0, 2.0], (1.8, 2.2)), ([np.nan] * 3, (0, 1)), ([0.0, 0.0, 0.0], (-0.1, 0.1))],
)
def test_values_without_a_range_still_have_a_scale(
    values: list[float], limits: tuple[float, float]
) -> None:
    figure = draw_scene(box_image(), some_grasps(3), np.array(values), metric="force")
    assert figure.axes[2].get_ylim() == pytest.approx(limits)


@pytest.mark.parametrize("count", [0, 1, 40])
def test_the_saved_picture_is_not_blank_and_touches_no_global_state(
    count: int, tmp_path: Path
) -> None:
    grasps = some_grasps(count)
    figure = draw_scene(box_image(), grasps, grasps.width, metric="sim_width")
    save_figure(figure, tmp_path / "scene.png")
    with Image.open(tmp_path / "scene.png") as picture:
        assert picture.size == (1200, 900)
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    # The box and its depth are there, and with grasps many colours.
    assert (pixels.min(axis=1) < 200).mean() > 0.02
    assert len(np.unique(pixels, axis=0)) > (300 if count == 40 else 50)
    if "matplotlib.pyplot" in sys.modules:
        assert sys.modules["matplotlib.pyplot"].get_fignums() == []


def test_the_whole_image_without_cropping() -> None:
    config = DrawConfig(crop=False, width=800, height=600)
    figure = draw_scene(box_image(), some_grasps(3), np.arange(3.0), metric="force", config=config)
    assert figure.axes[0].get_xlim() == (-0.5, 639.5)
    assert figure.axes[0].get_ylim() == (479.5, -0.5)
    assert pixels_of(figure).shape == (600, 800, 4)


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    for name in METRIC_NAMES:
        assert metric_named(name).name == name
    with pytest.raises(UsageError, match="did you mean 'sim_success'") as refused:
        draw_scene(box_image(), some_grasps(2), np.zeros(2), metric="sim_succes")
    assert all(name in str(refused.value) for name in METRIC_NAMES)
    with pytest.raises(UsageError, match=r"no grasp 9 in this scene; it has the grasps 0 to 1"):
        draw_scene(box_image(), some_grasps(2), np.zeros(2), metric="force", highlight=[9])
    config = DrawConfig(colormap="rainbows")
    with pytest.raises(UsageError, match=r"no colour map 'rainbows': there are .*viridis"):
        draw_scene(box_image(), some_grasps(2), np.zeros(2), metric="force", config=config)


@pytest.mark.parametrize("most", [0, -3])
def test_no_picture_of_no_grasps(most: int) -> None:
    with pytest.raises(UsageError, match=f"at most {most} grasps"):
        DrawConfig(most=most)


def test_malformed_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="3 values of force for 2 grasps"):
        draw_scene(box_image(), some_grasps(2), np.zeros(3), metric="force")
    above = PlanarGrasp(np.array([0]), np.array([[0, 0, 0.6]]), np.array([0.0]), np.array([0.05]))
    with pytest.raises(DatasetError, match="behind the camera"):
        draw_scene(box_image(), above, np.zeros(1), metric="force")
    figure = draw_scene(box_image(), some_grasps(2), np.zeros(2), metric="force")
    with pytest.raises(UsageError, match="must end in"):
        save_figure(figure, tmp_path / "scene.docx")
    with pytest.raises(UsageError, match="cannot write"):
        save_figure(figure, tmp_path / "nowhere" / "scene.png")
