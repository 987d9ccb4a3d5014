"""Shaded surfaces: what faces the viewer is drawn, where geometry puts it, far parts first."""

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from gmdx.pictures.figure import DrawConfig, new_figure
from gmdx.pictures.shading import SIDE, TOP, View, draw_pads, draw_surface, draw_table, tool_frame
from tests.support import box_object, sphere_object


def empty() -> Axes:
    axes: Axes = new_figure(DrawConfig()).add_axes((0, 0, 1, 1))
    axes.set_xlim(-50, 50)
    axes.set_ylim(-50, 50)
    return axes


def outlines(axes: Axes) -> np.ndarray:
    (surface,) = (c for c in axes.collections if isinstance(c, PolyCollection))
    return np.array([path.vertices[:3] for path in surface.get_paths()])


def area(triangles: np.ndarray) -> float:
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return float(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum() / 2)


@pytest.mark.parametrize(("view", "seen"), [(TOP, 40.0 * 60.0), (SIDE, 40.0 * 30.0)])
def test_one_face_of_a_box_is_seen_along_its_axis(view: View, seen: float) -> None:
    box, axes = box_object((0.04, 0.06, 0.03)), empty()
    draw_surface(axes, view, box.vertices[box.faces])
    assert len(outlines(axes)) == 2
    assert area(outlines(axes)) == pytest.approx(seen)


def test_what_is_near_covers_what_is_far() -> None:
    ball, axes = sphere_object(0.02), empty()
    small = 0.5 * ball.vertices + np.array([0.0, 0.0, 0.1])
    draw_surface(axes, TOP, np.concatenate([small[ball.faces], ball.vertices[ball.faces]]))
    low, high = np.split(outlines(axes), 2)
    assert area(low) == pytest.approx(np.pi * 20.0**2, rel=2e-2)
    assert area(high) == pytest.approx(np.pi * 10.0**2, rel=2e-2)


def test_the_tools_frame_puts_the_closing_axis_right_and_the_tool_point_in_the_middle() -> None:
    turn = 0.7
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    position, tool = np.array([0.1, 0.2, 0.03]), np.array([0.11, 0.18, 0.05])
    frame = tool_frame(rotation, position, tool=tool, axis=np.array([cos, sin, 0.0]))
    world = tool + 0.02 * np.array([cos, sin, 0.0]) + 0.01 * np.array([0.0, 0.0, 1.0])
    own = rotation.T @ (world - position)
    assert frame.points(own) == pytest.approx(np.array([0.02, 0.0, 0.01]))
    assert frame.directions(rotation.T @ [-sin, cos, 0.0]) == pytest.approx(np.array([0, 1, 0]))


def test_pads_stand_beside_the_opening_on_the_table() -> None:
    axes = empty()
    draw_pads(axes, SIDE, 0.03, (0.02, 0.016))
    boxes = [patch.get_bbox() for patch in axes.patches]
    assert [(b.x0, b.x1) for b in boxes] == [pytest.approx((-21, -15)), pytest.approx((15, 21))]
    assert [(b.y0, b.y1) for b in boxes] == [pytest.approx((-8, 8))] * 2
    draw_table(axes, 0.012)
    assert axes.lines[0].get_ydata() == pytest.approx([-12, -12])
    draw_table(axes, 0.2)  # below the picture
    assert len(axes.lines) == 1
