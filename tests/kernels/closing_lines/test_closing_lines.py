"""First touches against closed forms, and against brute force that shares no code with them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gmdx_kernels.closing_lines import FirstTouch, pad_grid

from tests.kernels.closing_lines import cases
from tests.kernels.closing_lines.cases import Array, Case

BUNDLED = ("bottle", "bowl", "bracket", "cross", "cup", "dumbbell", "egg", "gear", "hammer",
           "l_profile", "mug", "plate", "ring", "screw", "spanner", "spoon")  # fmt: skip
SCANS = Path(__file__).parents[4] / "shared" / "objects"
SHARED = ("ycb/YcbBanana.obj", "ycb/YcbScissors.obj", "adversarial/vase.obj",
          "adversarial/part3.obj", "adversarial/nozzle.obj")  # fmt: skip


# --- brute force ----------------------------------------------------------------------


def _crossings(corners: Array, origin: Array, direction: Array) -> tuple[Array, Array, Array]:
    """Signed distances, entering flags and triangles that a line crosses (Moller and Trumbore)."""
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, edge2)
    det = (edge1 * p).sum(axis=1)
    keep = np.flatnonzero(np.abs(det) > 1e-18)
    edge1, edge2, p, det, base = edge1[keep], edge2[keep], p[keep], det[keep], corners[keep, 0]
    s = origin - base
    u = (s * p).sum(axis=1) / det
    q = np.cross(s, edge1)
    v = (q @ direction) / det
    t = (edge2 * q).sum(axis=1) / det
    hit = (u >= 0) & (v >= 0) & (u + v <= 1)
    normal = np.cross(edge1, edge2)
    return t[hit], (normal[hit] @ direction) < 0, keep[hit]


def _sorted_touches(case: Case) -> FirstTouch:
    """First touches of each line by itself, by sorting all that it crosses."""
    n, lines = len(case.center), len(case.offsets)
    distance, triangle = np.full((n, 2, lines), np.nan), np.full((n, 2, lines), -1)
    corners = case.vertices[case.faces]
    for i, (center, axis, up) in enumerate(zip(case.center, case.axis, case.up, strict=True)):
        for j, (y, z) in enumerate(case.offsets):
            origin = center + y * np.cross(up, axis) + z * up
            for finger, sign in enumerate((1.0, -1.0)):
                t, enters, which = _crossings(corners, origin, sign * axis)
                t, enters, which = (a[np.abs(t) <= case.width[i] / 2] for a in (t, enters, which))
                if len(t) and enters[t.argmin()]:
                    distance[i, finger, j] = sign * t.min()
                    triangle[i, finger, j] = which[t.argmin()]
    return FirstTouch(distance, triangle)


def _assert_as_sorted(case: Case) -> None:
    expected, found = _sorted_touches(case), case.run()
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(found.triangle, expected.triangle)
    assert 0.05 < (expected.triangle >= 0).mean() < 0.95  # the case is worth testing


@pytest.mark.parametrize("name", cases.TWINNED)
def test_agrees_with_sorting_every_crossing(name: str) -> None:
    _assert_as_sorted(cases.TWINNED[name]())


@pytest.mark.parametrize("name", BUNDLED)
def test_agrees_on_bundled_objects(name: str) -> None:
    mesh = cases.bundled(name)
    _assert_as_sorted(cases.random_grasps(mesh, 16, seed=12, grid=(3, 3)))


@pytest.mark.parametrize("name", SHARED)
def test_agrees_on_scans(name: str) -> None:
    if not (SCANS / name).exists():
        pytest.skip("the shared scans are not here")
    mesh = cases.scan(SCANS / name)
    _assert_as_sorted(cases.random_grasps(mesh, 16, seed=13, level=False, grid=(2, 2)))


# --- edges and vertices ---------------------------------------------------------------


def test_no_line_leaks_through_vertices_and_edges() -> None:
    targets = cases.ball_targets()
    found = cases.ball_corners().run()
    assert np.isfinite(found.distance).all()
    side = (targets[:, 0] > 0).astype(int)
    mine = np.take_along_axis(found.distance[0], side[None], axis=0)[0]
    np.testing.assert_allclose(mine, targets[:, 0], atol=1e-9)


@pytest.mark.parametrize("case", [cases.box_faces(), cases.turned_box_faces()])
def test_box_is_met_at_its_faces_also_through_edges_of_triangles(case: Case) -> None:
    found = case.run()
    np.testing.assert_allclose(found.distance[0, 0, :3], -0.025, atol=1e-15)
    np.testing.assert_allclose(found.distance[0, 1, :3], 0.015, atol=1e-15)
    assert np.isnan(found.distance[:, :, 6]).all()


def test_a_ball_is_met_up_to_its_rim() -> None:
    """A micrometre within the rim, and not a micrometre beside it."""
    found = cases.ball_rim().run()
    within, beside = found.distance[:, :, 1], found.distance[:, :, 2]
    assert (within[:, 0] <= within[:, 1]).all()  # so none is NaN
    assert np.isnan(beside).all()


def test_a_line_through_the_tip_of_a_cone_meets_it() -> None:
    np.testing.assert_allclose(cases.tip().run().distance, 0, atol=1e-15)


def test_a_needle_is_met_at_and_below_its_tip() -> None:
    """The section at a depth d is an octagon within a circle of 2 mm x d / 60 mm."""
    at, above, below, deeper, beside = cases.needle().run().distance[0].T
    np.testing.assert_allclose(at, 0, atol=1e-15)
    assert np.isnan(above).all()
    for touched, depth in ((below, 1e-6), (deeper, 1e-4)):
        radius = 0.002 * depth / 0.06
        assert (touched * [-1, 1] <= radius + 1e-15).all()
        assert (touched * [-1, 1] >= radius * np.cos(np.pi / 8) - 1e-15).all()
    assert (np.abs(beside) < np.abs(deeper)).all()


# --- from where a finger comes --------------------------------------------------------


def test_finger_inside_the_solid_touches_nothing() -> None:
    found = cases.fingers_inside().run()
    # Both fingers inside; finger 0 inside and finger 1 outside; neither meets anything.
    np.testing.assert_allclose(
        found.distance[:, :, 0], [[np.nan, np.nan], [np.nan, 0.005], [np.nan, np.nan]], atol=1e-15
    )


def test_a_finger_at_a_face_touches_it() -> None:
    """By 1e-9 m it may stand behind the face, for rounding; at 1e-7 m it is inside."""
    case = cases.at_the_fingers()
    outside = case.width >= 0.04 - 2e-9
    expected = np.where(outside[:, None, None], [[-0.02], [0.02]], np.nan)
    np.testing.assert_allclose(case.run().distance, np.tile(expected, 2), atol=1e-15)
    assert sorted(outside) == [False] * 2 + [True] * 5


def test_leaving_one_solid_where_the_next_begins_is_a_touch() -> None:
    found = cases.stack().run().distance[:, :, :3]  # lines within the boxes' sides
    expected = np.array([[0, 0], [-0.005, 0.015], [np.nan, -0.01], [-0.02, 0.02]])
    np.testing.assert_allclose(found, np.repeat(expected[..., None], 3, axis=2), atol=1e-15)


def test_of_coinciding_triangles_the_first_is_touched() -> None:
    case = cases.double()
    half = len(case.faces) // 2
    found, ball = case.run(), replace(case, faces=case.faces[:half]).run()
    assert (found.triangle >= 0).any()
    np.testing.assert_array_equal(found.triangle, ball.triangle)
    np.testing.assert_array_equal(found.distance, ball.distance)


def test_a_single_triangle_is_entered_from_its_outer_side() -> None:
    corners = np.array([[0.0, -0.01, -0.01], [0.0, 0.02, -0.01], [0.0, -0.01, 0.02]])
    mesh = trimesh.Trimesh(corners, [[0, 1, 2]], process=False)  # counter-clockwise seen from +x
    case = cases.along_x(mesh, [[0, 0, 0]], [0.02], np.array([[0.0, 0.0], [0.01, 0.01]]))
    found = case.run()
    np.testing.assert_array_equal(found.triangle[0], [[-1, -1], [0, -1]])
    np.testing.assert_allclose(found.distance[0], [[np.nan, np.nan], [0.0, np.nan]], atol=1e-18)


# --- batches --------------------------------------------------------------------------


def test_a_grasp_does_not_depend_on_its_batch() -> None:
    mug = cases.random_grasps(cases.bundled("mug"), 70, seed=14)
    for case in (mug, cases.ball_rim(), cases.turned_box_faces()):
        n = len(case.center)
        together = case.run()
        for some in (slice(0, 1), slice(n - 1, n), slice(1, n), np.arange(n)[::-1]):
            alone = case.run(some)
            assert alone.distance.tobytes() == together.distance[some].tobytes()
            assert alone.triangle.tobytes() == together.triangle[some].tobytes()


def test_a_grasp_that_is_nowhere_leaves_the_others_alone() -> None:
    case = cases.torus()
    center = case.center.copy()
    center[3] = np.nan
    found, expected = replace(case, center=center).run(), case.run()
    others = np.arange(len(center)) != 3
    assert np.isnan(found.distance[3]).all()
    np.testing.assert_array_equal(found.triangle[others], expected.triangle[others])


def test_nothing_to_do_is_done() -> None:
    case = cases.fingers_inside()
    assert case.run(slice(0, 0)).distance.shape == (0, 2, 1)
    no_lines = replace(case, offsets=np.zeros((0, 2)))
    assert no_lines.run().distance.shape == (3, 2, 0)
    found = replace(case, faces=case.faces[:0]).run()
    assert np.isnan(found.distance).all()
    assert (found.triangle == -1).all()


def test_pad_grid_covers_the_face_evenly() -> None:
    offsets = pad_grid(np.array([0.02, 0.01]), (4, 5))
    assert offsets.shape == (20, 2)
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=1e-18)
    np.testing.assert_allclose(offsets.min(axis=0), [-0.01, -0.005])
    np.testing.assert_allclose(offsets.max(axis=0), [0.01, 0.005])
    np.testing.assert_allclose(np.diff(np.unique(offsets[:, 1])), 0.0025)
    np.testing.assert_array_equal(pad_grid(np.array([0.02, 0.01]), (1, 1)), [[0.0, 0.0]])
