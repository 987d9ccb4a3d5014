import numpy as np
import pytest
import trimesh

from gmdx.geometry import quaternion_matrix, random_quaternion
from gmdx.objects.box import smallest_box, smallest_rectangle


def test_a_turned_rectangle_is_found() -> None:
    corners = np.array([[0.0, 0], [3, 0], [3, 1], [0, 1], [1, 0.5]])
    c, s = np.cos(0.4), np.sin(0.4)
    axes, sides = smallest_rectangle(corners @ np.array([[c, s], [-s, c]]))
    assert sorted(sides) == pytest.approx([1, 3])
    assert axes @ axes.T == pytest.approx(np.eye(2), abs=1e-12)


def test_a_turned_cuboid_is_its_own_box() -> None:
    R = quaternion_matrix(random_quaternion(np.random.default_rng(0)))
    corners = np.array(trimesh.creation.box([0.02, 0.05, 0.03]).vertices)
    box = smallest_box(corners @ R.T + [1, 2, 3])
    assert box.extents == pytest.approx([0.05, 0.03, 0.02], rel=1e-6)
    assert box.center == pytest.approx([1, 2, 3])
    assert np.abs(box.axes.T @ R[:, [1, 2, 0]]) == pytest.approx(np.eye(3), abs=1e-5)
    assert np.linalg.det(box.axes) == pytest.approx(1)


def test_a_tetrahedron_fits_its_cube() -> None:
    """No side of the smallest box lies on a face: each contains an edge."""
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    R = quaternion_matrix(random_quaternion(np.random.default_rng(1)))
    assert smallest_box(corners @ R.T).extents == pytest.approx([2, 2, 2], rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_no_larger_than_others_find_and_everything_inside(seed: int) -> None:
    points = np.random.default_rng(seed).standard_normal((50, 3)) * [1, 2, 4]
    box = smallest_box(points)
    local = (points - box.center) @ box.axes
    assert (np.abs(local) <= box.extents / 2 + 1e-9).all()
    assert (np.diff(box.extents) <= 0).all()
    other = trimesh.bounds.oriented_bounds(points)[1].prod()
    assert box.extents.prod() <= other * (1 + 1e-6)
