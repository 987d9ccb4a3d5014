"""Cuts of wrench spaces against their closed forms, and what the pictures show."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from epsilon_figures.load_figures import (
    draw_weight,
    draw_worst_wrench,
    tilt_strength,
    weight_strength,
)
from epsilon_figures.stage import towards_viewer
from epsilon_figures.wrench_figures import draw_hull_errors, draw_wrench_slice
from epsilon_figures.wrench_space import hull_errors, slice_axes, wrench_section, wrench_slice
from matplotlib.patches import Circle

from gmdx.errors import ConfigError, MetricError
from gmdx.metrics.epsilon.certified import epsilon
from gmdx.studies.epsilon.contacts import Contacts, random_pairs, random_patches
from tests.support import box_object, resting_scene

R, MU, GAMMA, SCALE = 0.02, 0.8, 0.004, 0.05


@pytest.fixture(scope="module")
def opposed() -> Contacts:
    """Two contacts on the x axis, the origin between them."""
    points = np.array([[-R, 0, 0], [R, 0, 0]])
    return Contacts(points, np.array([[1.0, 0, 0], [-1.0, 0, 0]]), MU, GAMMA, SCALE)


def test_the_first_axis_is_the_worst_direction_and_all_are_orthonormal() -> None:
    for i in range(4):
        contacts = random_pairs(4, seed=7)[i]
        found = epsilon(contacts.points, contacts.normals, **contacts.parameters)
        axes = slice_axes(contacts, found.direction)
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)
        assert axes[0] == pytest.approx(found.direction)


def test_cut_of_an_aligned_pair_is_its_closed_form(opposed: Contacts) -> None:
    """Along (twist x, torque y, torque z) both contacts share the load evenly.

    Each bears half: tangential forces at the levers -R and R for the torque across the line, and
    torsion for the twist, which share the ellipse of the limit surface.
    """
    cut = wrench_slice(opposed, rings=9, spokes=8)
    lever = MU * R / SCALE  # most torque across the line, divided by L, for unit grip
    twist = GAMMA / SCALE
    in_twist = cut.axes[0, 3] * cut.directions[..., 0]
    across = np.linalg.norm(cut.directions[..., 1:], axis=-1)
    assert abs(cut.axes[0, 3]) == pytest.approx(1, abs=1e-6)
    exact = 1 / np.hypot(in_twist / twist, across / lever)
    assert cut.reach == pytest.approx(exact, rel=1e-6)
    assert cut.epsilon.upper == pytest.approx(twist, rel=1e-6)  # closed form A
    assert cut.surface[0, 0] == pytest.approx([twist, 0, 0], abs=1e-6)


def test_the_ball_touches_where_the_worst_direction_leaves() -> None:
    cut = wrench_slice(random_pairs(3, seed=11)[2], rings=9, spokes=8)
    assert cut.reach[0] == pytest.approx(cut.epsilon.upper, rel=1e-6)
    assert cut.reach.min() >= cut.epsilon.lower * (1 - 1e-6)
    assert cut.reach[:, -1] == pytest.approx(cut.reach[:, 0])


def test_hulls_lie_inside_the_space_in_every_direction() -> None:
    section = wrench_section(random_pairs(5, seed=11)[4], edges=8, samples=24, points=40)
    assert np.all(section.linearised <= section.reach * (1 + 1e-6))
    assert np.all(section.sampled <= section.reach * (1 + 1e-6))
    assert section.reach[0] == pytest.approx(section.reach[-1])


def test_errors_of_hulls_fall_and_stay_positive() -> None:
    pairs = random_pairs(3, seed=1)
    errors = hull_errors([pairs[i] for i in range(3)], edges=(4, 8, 16), samples=(16, 48))
    assert errors.linearised.shape == (3, 3)
    assert errors.sampled.shape == (2, 3)
    assert np.all(np.diff(errors.linearised, axis=0) <= 1e-6)  # each polygon holds the last
    assert np.all(np.diff(errors.sampled.mean(axis=1)) < 0)
    assert errors.linearised.min() > 0.01  # the bipyramid's slopes stay
    assert errors.gap.max() <= 1e-4
    drawn = draw_hull_errors(errors)
    left, right = drawn.axes
    assert left.get_xlabel() == "edges or points a contact"
    assert right.get_xlabel() == "processor time a grasp (ms)"
    assert all("relative error" in axes.get_ylabel() for axes in drawn.axes)
    names = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert any("gmdx.epsilon proves: median, bar to the worst" in name for name in names)
    bar = right.containers[0].lines[2][0].get_segments()[0]  # type: ignore[attr-defined]
    assert bar[:, 1] == pytest.approx([100 * np.median(errors.gap), 100 * errors.gap.max()])
    assert left.get_xscale() == left.get_yscale() == "log"


def test_the_cut_is_drawn_inside_the_picture(opposed: Contacts) -> None:
    drawn = draw_wrench_slice(
        wrench_slice(opposed, rings=9, spokes=12), wrench_section(opposed, points=40)
    )
    drawn.canvas.draw()  # type: ignore[attr-defined]
    stage, flat = drawn.axes
    low, high = flat.get_ylim()
    assert -low == high > GAMMA / SCALE
    extent = stage.collections[0].get_window_extent()
    assert extent.x0 >= 0
    assert extent.x1 <= drawn.bbox.width
    used = np.flatnonzero((ink(drawn) < 250).any(axis=1))
    blank = np.diff(used).max(initial=0)
    assert max(used[0], len(ink(drawn)) - used[-1], blank) < 0.1 * len(ink(drawn))


def ink(drawn: Any) -> np.ndarray:
    """The darkest colour of each pixel, 255 where the paper is white."""
    return np.asarray(drawn.canvas.buffer_rgba())[..., :3].min(axis=-1)


def test_the_legend_shows_the_ball_as_it_is_drawn(opposed: Contacts) -> None:
    drawn = draw_wrench_slice(
        wrench_slice(opposed, rings=5, spokes=6), wrench_section(opposed, points=16)
    )
    flat = drawn.axes[1]
    (shown,) = (patch for patch in flat.patches if isinstance(patch, Circle))
    assert shown.get_radius() == pytest.approx(GAMMA / SCALE)
    legend = drawn.legends[0]
    names = [text.get_text().split(",")[0] for text in legend.get_texts()]
    key = legend.legend_handles[names.index("ball")]
    assert key.get_facecolor() == shown.get_facecolor()  # type: ignore[union-attr]
    assert key.get_edgecolor() == shown.get_edgecolor()  # type: ignore[union-attr]
    assert shown.get_facecolor()[3] > 0.3  # filled


def test_what_a_pair_holds_against_weight_is_its_friction(opposed: Contacts) -> None:
    across = weight_strength(opposed, np.array([0.0, 0.0, -1.0]))
    assert across.value == pytest.approx(MU / 9.81, rel=1e-6)
    assert across.forces.sum(axis=0) == pytest.approx([0, 0, MU], abs=1e-6)
    assert weight_strength(opposed, np.array([1.0, 0, 0])).value == pytest.approx(1 / 9.81)


def test_turning_gravity_follows_the_friction_cone(opposed: Contacts) -> None:
    scene = resting_scene(box_object((2 * R, 0.03, 0.05)))
    tilts = tilt_strength(scene, opposed, grip=40.0, angles=9)
    # About the closing line weight stays across it; about the level line it turns into it.
    assert tilts.about_closing == pytest.approx(40 * MU / 9.81, rel=1e-6)
    assert tilts.about_level[0] == pytest.approx(40 * MU / 9.81, rel=1e-6)
    assert tilts.about_level[2] == pytest.approx(40 / 9.81, rel=1e-6)
    assert tilts.about_level[1] == pytest.approx(held_at(np.pi / 4), rel=1e-6)


def held_at(angle: float) -> float:
    """Mass, kg, that two aligned contacts with 40 N between them hold at a tilt.

    Without torque both bear half of w cos, for which the looser one needs w cos / (2 mu); the
    other presses with w sin more, and both together with 40 N.
    """
    return 40 / (np.cos(angle) / MU + np.sin(angle)) / 9.81


def test_the_pictures_of_loads_say_what_they_show(opposed: Contacts) -> None:
    scene = resting_scene(box_object((2 * R, 0.03, 0.05)))
    found = epsilon(opposed.points, opposed.normals, **opposed.parameters)
    drawn = draw_worst_wrench(scene, opposed, found, grip=40.0)
    words = "\n".join(text.get_text() for text in drawn.texts)
    assert f"torque {1e3 * 40 * GAMMA:.1f} N mm" in words
    assert "0 degrees apart" in words
    drawn.canvas.draw()  # type: ignore[attr-defined]
    drawn = draw_weight(scene, opposed, tilt_strength(scene, opposed, grip=40.0, angles=9))
    words = "\n".join(text.get_text() for text in drawn.texts)
    assert f"holds {40 * MU / 9.81:.2f} kg" in words
    drawn.canvas.draw()  # type: ignore[attr-defined]


def test_a_load_is_drawn_whatever_it_has_none_of(opposed: Contacts) -> None:
    scene = resting_scene(box_object((2 * R, 0.03, 0.05)))
    found = epsilon(opposed.points, opposed.normals, **opposed.parameters)
    force = np.array([0.0, 1, 0, 0, 0, 0])
    drawn = draw_worst_wrench(scene, opposed, replace(found, direction=force))
    words = "\n".join(text.get_text() for text in drawn.texts)
    assert "torque 0.0 N mm" in words
    assert "apart" not in words
    at_viewer = np.concatenate([np.zeros(3), towards_viewer(drawn.axes[0])])
    draw_worst_wrench(scene, opposed, replace(found, direction=at_viewer)).canvas.draw()  # type: ignore[attr-defined]


def test_only_pairs_with_closure_are_cut(opposed: Contacts) -> None:
    many = random_patches(1, contacts=4)[0]
    with pytest.raises(MetricError, match="one of a pair, not of 4 contacts"):
        wrench_slice(many)
    with pytest.raises(MetricError, match="a pair, not 4 contacts"):
        tilt_strength(resting_scene(box_object((0.04, 0.03, 0.05))), many)
    away = replace(opposed, normals=np.array([[0.0, 0, 1], [0, 0, 1]]))
    with pytest.raises(MetricError, match="no force closure"):
        wrench_section(away)
    lost = epsilon(away.points, away.normals, **away.parameters)
    with pytest.raises(MetricError, match="no load is the first"):
        draw_worst_wrench(resting_scene(box_object((0.04, 0.03, 0.05))), away, lost)
    turned = replace(opposed, points=opposed.points[:, ::-1], normals=opposed.normals[:, ::-1])
    with pytest.raises(MetricError, match="closing line is upright"):
        tilt_strength(resting_scene(box_object((0.04, 0.03, 0.05))), turned)
    with pytest.raises(MetricError, match="at the same point"):
        slice_axes(replace(opposed, points=np.zeros((2, 3))), np.eye(6)[3])
    with pytest.raises(ConfigError, match="3 rings and 3 spokes"):
        wrench_slice(opposed, rings=2)
