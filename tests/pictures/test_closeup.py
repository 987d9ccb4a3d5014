"""Close-ups: sections, contacts and cones are where geometry puts them."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.patches import Polygon
from PIL import Image

from gmdx.errors import DatasetError, UsageError
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.pictures.closeup import cone_points, draw_closeup, section_lines
from gmdx.pictures.figure import save_figure
from gmdx.scenes.scene import Scene
from tests.support import box_object, resting_scene, sphere_object


def grasp_at(angle: float, height: float, n: int = 1) -> PlanarGrasp:
    center = np.tile([0.0, 0.0, height], (n, 1))
    return PlanarGrasp(np.arange(n) + 5, center, np.full(n, angle), np.full(n, 0.06))


def contacts_on_x(half: float) -> PadContacts:
    """A contact on either x face of a box, and one invalid slot each."""
    points = np.full((1, 2, 2, 3), np.nan)
    normals = np.full((1, 2, 2, 3), np.nan)
    points[0, :, 0] = [[-half, 0.002, 0.001], [half, -0.002, 0.001]]
    normals[0, :, 0] = [[1, 0, 0], [-1, 0, 0]]
    return PadContacts(points, normals, np.array([[[True, False], [True, False]]]))


def box_scene(yaw: float = 0.0) -> Scene:
    return resting_scene(box_object((0.04, 0.06, 0.03)), yaw=yaw)


def dots(axes: Axes) -> np.ndarray:
    marks = [c for c in axes.collections if type(c) is PathCollection]
    return np.concatenate([np.asarray(mark.get_offsets()) for mark in marks])


def length(lines: np.ndarray) -> float:
    return float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum())


def test_a_section_has_the_length_of_its_outline() -> None:
    box = box_object((0.04, 0.06, 0.03))
    for axis, outline in [(0, 0.06 + 0.03), (1, 0.04 + 0.03), (2, 0.04 + 0.06)]:
        offset = np.zeros(3)
        offset[axis] = 0.003
        lines = section_lines((box.vertices + offset)[box.faces], axis)
        assert length(lines) == pytest.approx(2 * outline)
        assert lines[..., axis] == pytest.approx(0, abs=1e-12)
    ball = sphere_object(0.03)
    lines = section_lines((ball.vertices - [0, 0, 0.01])[ball.faces], 2)
    assert length(lines) == pytest.approx(2 * np.pi * np.sqrt(0.03**2 - 0.01**2), rel=2e-3)
    assert len(section_lines((ball.vertices + 1.0)[ball.faces], 2)) == 0


@pytest.mark.parametrize("friction", [0.3, 0.8, 1.5])
def test_a_cone_opens_by_its_friction_angle(friction: float) -> None:
    normal = np.array([0.6, 0.0, 0.8])
    points = cone_points(np.array([0.01, 0.02, 0.03]), normal, friction)
    rays = points[1:] - points[0]
    cosine = rays @ normal / np.linalg.norm(rays, axis=1)
    assert np.arccos(cosine) == pytest.approx(np.full(64, np.arctan(friction)))


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.9])
def test_both_views_show_the_contacts_in_the_tools_frame(turn: float) -> None:
    """Turning object and grasp together about the vertical changes nothing in the picture."""
    figure = draw_closeup(box_scene(turn), grasp_at(turn, 0.012), analytical=contacts_on_x(0.02))
    above, side = figure.axes[:2]
    assert dots(above) == pytest.approx(np.array([[-20, 2], [20, -2]]))
    # The centre of mass is 15 mm above the table, the tool point 12 mm.
    assert dots(side) == pytest.approx(np.array([[-20, 4], [20, 4]]))
    section = next(c for c in above.collections if type(c) is LineCollection)
    ends = np.concatenate([np.asarray(s) for s in section.get_segments()])
    assert np.abs(ends).max(axis=0) == pytest.approx([20, 30])
    assert np.abs(ends).min() >= 0
    table = side.lines[0].get_ydata()
    assert table == pytest.approx([-12, -12])


def test_a_cone_seen_from_above_has_the_friction_angle() -> None:
    figure = draw_closeup(box_scene(), grasp_at(0.0, 0.012), analytical=contacts_on_x(0.02))
    cones = [p for p in figure.axes[0].patches if type(p) is Polygon]
    assert len(cones) == 2
    for cone, apex in zip(cones, [(-20, 2), (20, -2)], strict=True):
        rays = cone.get_xy() - apex
        rays = rays[np.linalg.norm(rays, axis=1) > 1e-9]
        half_angle = np.arctan2(np.abs(rays[:, 1]), np.abs(rays[:, 0])).max()
        assert half_angle == pytest.approx(np.arctan(0.8), abs=1e-6)
        # Forces of a pad point into the object, towards the middle.
        assert (np.sign(rays[:, 0]) == -np.sign(apex[0])).all()


def test_numbers_contacts_of_the_trial_and_the_saved_picture(tmp_path: Path) -> None:
    metrics = {"g_dis": 0.0123456, "force": np.nan, "sim_success": 0.8}
    figure = draw_closeup(
        box_scene(),
        grasp_at(0.0, 0.012),
        analytical=contacts_on_x(0.02),
        simulated=contacts_on_x(0.0199),
        metrics=metrics,
        title="box, scene 2",
    )
    text = [t.get_text() for t in figure.texts]
    assert text[0] == "box, scene 2, grasp 5"
    rows = {line.split()[0]: line.split()[1:] for line in text[1].splitlines() if line.strip()}
    assert rows["g_dis"] == ["0.01235", "m"]
    assert rows["force"] == ["-", "N"]
    assert rows["sim_success"] == ["0.8"]
    assert len(dots(figure.axes[0])) == 4
    labels = [label.get_text() for label in figure.legends[0].get_texts()]
    assert "touched in the trial" in labels
    assert "friction cone (0.8)" in labels
    assert figure.axes[1].get_xlabel() == "along the closing axis (mm)"
    save_figure(figure, tmp_path / "grasp.png")
    with Image.open(tmp_path / "grasp.png") as picture:
        assert picture.size == (1200, 900)
        colors = np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)
    assert len(colors) > 200


def test_the_scales_of_both_axes_are_equal() -> None:
    figure = draw_closeup(box_scene(), grasp_at(0.0, 0.012), analytical=contacts_on_x(0.02))
    figure.canvas.draw()
    for axes in figure.axes[:2]:
        origin, right, up = axes.transData.transform([(0, 0), (10, 0), (0, 10)])
        assert right[0] - origin[0] == pytest.approx(up[1] - origin[1])
    lengths = [
        axes.transData.transform((10, 0))[0] - axes.transData.transform((0, 0))[0]
        for axes in figure.axes[:2]
    ]
    assert lengths[0] == pytest.approx(lengths[1])


def test_a_grasp_without_contact_is_still_shown() -> None:
    nothing = PadContacts(
        np.full((1, 2, 1, 3), np.nan), np.full((1, 2, 1, 3), np.nan), np.zeros((1, 2, 1), bool)
    )
    figure = draw_closeup(box_scene(), grasp_at(0.3, 0.012), analytical=nothing)
    figure.canvas.draw()
    assert not [c for c in figure.axes[0].collections if type(c) is PathCollection]


def test_malformed_input_is_refused() -> None:
    with pytest.raises(DatasetError, match="batches of 2, 1"):
        draw_closeup(box_scene(), grasp_at(0.0, 0.01, n=2), analytical=contacts_on_x(0.02))
    with pytest.raises(UsageError, match="no metric 'weight'"):
        draw_closeup(
            box_scene(),
            grasp_at(0.0, 0.01),
            analytical=contacts_on_x(0.02),
            metrics={"weight": 1.0},
        )
