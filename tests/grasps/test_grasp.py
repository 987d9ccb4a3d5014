import numpy as np

from gmdx.grasps.grasp import PadContacts, PlanarGrasp


def test_axis_follows_angle() -> None:
    angle = np.array([0.0, np.pi / 2, 0.3])
    grasps = PlanarGrasp(np.arange(3), np.zeros((3, 3)), angle, np.full(3, 0.05))
    expected = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    np.testing.assert_allclose(grasps.axis, expected)
    assert len(grasps[grasps.angle < 1.0]) == 2


def test_means_ignore_empty_slots_and_are_nan_without_contact() -> None:
    points = np.full((2, 2, 3, 3), np.nan)
    valid = np.zeros((2, 2, 3), bool)
    points[0, 0, :2] = [[1.0, 0.0, 0.0], [3.0, 2.0, 0.0]]
    valid[0, 0, :2] = True
    points[0, 1, 2] = [5.0, 5.0, 5.0]
    valid[0, 1, 2] = True
    contacts = PadContacts(points, np.full_like(points, np.nan), valid)
    np.testing.assert_allclose(contacts.means[0], [[2.0, 1.0, 0.0], [5.0, 5.0, 5.0]])
    assert np.isnan(contacts.means[1]).all()
    np.testing.assert_array_equal(contacts.both, [True, False])
