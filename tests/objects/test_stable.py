import numpy as np
import pytest
import trimesh

from gmdx.geometry import quaternion_matrix, random_quaternion
from gmdx.objects.stable import StableConfig, stable_poses

APART = StableConfig(merge=1e-6)


def face_share(a: float, b: float, h: float) -> float:
    """Share of the full solid angle of an a x b rectangle at distance h before its middle."""
    return 4 * np.arctan2(a * b, 2 * h * np.sqrt(4 * h * h + a * a + b * b)) / (4 * np.pi)


def test_a_cuboid_rests_by_solid_angle() -> None:
    a, b, c = 0.02, 0.03, 0.05
    box = trimesh.creation.box([a, b, c])
    poses = stable_poses(np.array(box.vertices), np.zeros(3))
    expected = sorted([face_share(b, c, a / 2), face_share(a, c, b / 2), face_share(a, b, c / 2)])
    assert poses.probabilities == pytest.approx(np.repeat(expected[::-1], 2), rel=1e-9)
    assert poses.heights == pytest.approx(np.repeat([a / 2, b / 2, c / 2], 2))


def test_a_regular_tetrahedron_rests_on_each_face_alike() -> None:
    corners = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    poses = stable_poses(corners, np.zeros(3))
    assert poses.probabilities == pytest.approx([0.25] * 4)
    assert poses.heights == pytest.approx([1 / np.sqrt(3)] * 4)


def test_a_leaning_column_never_stands() -> None:
    """Sheared so far that its middle is beyond its base: the base's share goes to a side."""
    corners = np.array(trimesh.creation.box([1.0, 1.0, 3.0]).vertices)
    corners[:, 0] += 0.5 * corners[:, 2]
    poses = stable_poses(corners, np.zeros(3), APART)
    down = np.array([quaternion_matrix(q).T @ [0, 0, -1.0] for q in poses.quaternions])
    assert (np.abs(down[:, 2]) < 0.9).all()
    straight = stable_poses(np.array(trimesh.creation.box([1.0, 1.0, 3.0]).vertices), np.zeros(3))
    assert len(straight.probabilities) == 6
    assert len(poses.probabilities) == 4
    assert poses.probabilities.sum() == pytest.approx(1)


def test_a_weighted_prism_rolls_to_its_heavy_side() -> None:
    """Mass 0.3 off the axis of a 16-gon of half-edge 0.195: a side holds below asin(0.65)."""
    angles = np.arange(16) * 2 * np.pi / 16
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    prism = np.concatenate([np.insert(ring, 1, y, axis=1) for y in (-5.0, 5.0)])
    poses = stable_poses(prism, np.array([0.3, 0.0, 0.0]), APART)
    down = np.array([quaternion_matrix(q).T @ [0, 0, -1.0] for q in poses.quaternions])
    lying = np.abs(down[:, 1]) < 0.5
    degrees = np.sort(np.degrees(np.arctan2(down[lying, 2], down[lying, 0])))
    assert degrees == pytest.approx(
        [-168.75, -146.25, -33.75, -11.25, 11.25, 33.75, 146.25, 168.75]
    )
    # what lands farther round rolls down to the first side that holds
    assert (np.abs(np.arctan2(down[:2, 2], down[:2, 0])) > np.radians(30)).all()


@pytest.mark.parametrize("seed", range(5))
def test_every_pose_is_statically_stable(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((30, 3)) * [1.0, 2.0, 3.0]
    center = points.mean(axis=0)
    poses = stable_poses(points, center)
    assert poses.probabilities.sum() == pytest.approx(1)
    assert (np.diff(poses.probabilities) <= 0).all()
    for q, height in zip(poses.quaternions, poses.heights, strict=True):
        turned = (points - center) @ quaternion_matrix(q).T
        assert turned[:, 2].min() == pytest.approx(-height)
        support = turned[turned[:, 2] < -height + 1e-9, :2]
        assert len(support) >= 3
        bearing = np.sort(np.arctan2(support[:, 1], support[:, 0]))
        gaps = np.diff(np.append(bearing, bearing[0] + 2 * np.pi))
        assert gaps.max() < np.pi  # the centre of mass is above the support


def test_poses_turn_with_the_body() -> None:
    rng = np.random.default_rng(3)
    points = rng.standard_normal((40, 3))
    R = quaternion_matrix(random_quaternion(rng))
    one, other = stable_poses(points, np.zeros(3)), stable_poses(points @ R.T, np.zeros(3))
    assert one.probabilities == pytest.approx(other.probabilities)
    assert one.heights == pytest.approx(other.heights)


def test_a_round_side_is_a_few_likely_poses() -> None:
    can = trimesh.creation.cylinder(1.0, 3.0, sections=180)
    points = np.array(can.vertices)
    apart, merged = stable_poses(points, np.zeros(3), APART), stable_poses(points, np.zeros(3))
    assert len(apart.probabilities) == 182
    assert 15 < len(merged.probabilities) < 40
    assert (merged.probabilities >= 0.01).all()
    standing = np.array(
        [abs((quaternion_matrix(q).T @ [0, 0, 1.0])[2]) for q in merged.quaternions]
    )
    cap = 1 - 1.5 / np.sqrt(1 + 1.5**2)  # two cones of the solid angle
    assert merged.probabilities[standing > 0.9].sum() == pytest.approx(cap, rel=1e-3)
