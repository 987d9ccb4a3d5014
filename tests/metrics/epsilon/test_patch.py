import numpy as np
import pytest
from scipy.spatial import ConvexHull

from gmdx.grasps.grasp import PadContacts
from gmdx.metrics.epsilon.many import epsilon_batch
from gmdx.metrics.epsilon.patch import essential_contacts, hull_corners


@pytest.mark.parametrize("seed", range(5))
def test_corners_are_those_of_the_convex_hull(seed: int) -> None:
    points = np.random.default_rng(seed).standard_normal((30, 2))
    assert set(hull_corners(points)) == set(ConvexHull(points).vertices)


def test_degenerate_patches_keep_their_ends() -> None:
    line = np.array([[0.0, 0.0], [0.5, 1.0], [1.0, 2.0], [0.25, 0.5]])
    assert set(hull_corners(line)) == {0, 2}
    assert hull_corners(np.ones((4, 2))) in ([0], [1], [2], [3])
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    assert {tuple(p) for p in grid[hull_corners(grid)]} == {(0, 0), (4, 0), (0, 3), (4, 3)}


def test_patches_on_different_planes_are_kept_apart() -> None:
    grid = np.stack(np.meshgrid(np.arange(3.0), np.arange(3.0)), axis=-1).reshape(-1, 2) * 0.004
    low = np.column_stack([np.full(9, -0.02), grid])
    points = np.full((1, 2, 18, 3), np.nan)
    points[0, 0, :9], points[0, 0, 9:] = low, low - [0.001, 0, 0]
    points[0, 1, 0] = [0.02, 0.0, 0.0]
    normals = np.where(np.isfinite(points), np.array([1.0, 0, 0]), np.nan)
    normals[:, 1] *= [-1.0, 1, 1]
    contacts = essential_contacts(PadContacts(points, normals, np.isfinite(points).all(axis=3)))
    np.testing.assert_array_equal(contacts.valid.sum(axis=2), [[8, 1]])


def test_leaving_out_the_inside_of_patches_keeps_the_quality() -> None:
    rng = np.random.default_rng(4)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    grid = np.stack(np.meshgrid(*[np.linspace(-0.008, 0.008, 3)] * 2), axis=-1).reshape(-1, 2)
    points = (
        np.stack(
            [
                np.column_stack([np.full(9, -0.02), grid + np.array([0.004, 0.01])]),
                np.column_stack([0.02 + 0.1 * grid[:, 0], grid]),
            ]
        )[None]
        @ turn.T
    )
    tilted = np.array([-1.0, 0.1, 0.0]) / np.hypot(1, 0.1)
    normals = np.stack([np.tile([1.0, 0, 0], (9, 1)), np.tile(tilted, (9, 1))])[None] @ turn.T
    contacts = PadContacts(points, normals, np.ones((1, 2, 9), bool))
    few = essential_contacts(contacts)
    np.testing.assert_array_equal(few.valid.sum(axis=2), [[4, 4]])

    def quality(contacts: PadContacts) -> tuple[float, float]:
        found = epsilon_batch(
            contacts.points.reshape(1, -1, 3),
            contacts.normals.reshape(1, -1, 3),
            contacts.valid.reshape(1, -1),
            friction=0.8,
            torsion=0.003,
            torque_scale=0.05,
            origin=np.zeros(3),
            rtol=1e-2,
        )
        return float(found.lower[0]), float(found.upper[0])

    (low, high), (all_low, all_high) = quality(few), quality(contacts)
    assert low > 0
    assert low <= all_high * (1 + 1e-6)
    assert all_low <= high * (1 + 1e-6)
    assert high == pytest.approx(all_high, rel=1e-2)
