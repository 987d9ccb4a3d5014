"""Wrench cones against forces sampled from the friction law itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gmdx.errors import MetricError
from gmdx.metrics.epsilon.wrench import (
    check_contacts,
    contact_supports,
    pair_closure,
    support,
    tangents,
    wrench_cones,
)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def contacts(rng, k):
    return rng.normal(size=(k, 3)) * 0.03, unit(rng.normal(size=(k, 3)))


def sampled_wrenches(rng, point, normal, mu, gamma, scale, origin, count):
    """Wrenches of random forces on the surface of one contact's limit surface at f_n = 1."""
    s = unit(rng.normal(size=(count, 3)))
    t1 = unit(np.cross(normal, unit(rng.normal(size=3))))
    t2 = np.cross(normal, t1)
    force = normal + mu * (s[:, :1] * t1 + s[:, 1:2] * t2)
    torque = np.cross(point - origin, force) + gamma * s[:, 2:] * normal
    return np.concatenate([force, torque / scale], axis=1)


def test_support_is_the_largest_of_sampled_forces():
    rng = np.random.default_rng(0)
    origin = np.array([0.01, -0.02, 0.005])
    for _ in range(20):
        points, normals = contacts(rng, 3)
        mu, gamma, scale = rng.uniform(0.1, 1.2), rng.uniform(0.001, 0.02), rng.uniform(0.02, 0.2)
        cones = wrench_cones(
            points, normals, friction=mu, torsion=gamma, torque_scale=scale, origin=origin
        )
        w = [
            sampled_wrenches(rng, p, n, mu, gamma, scale, origin, 20000)
            for p, n in zip(points, normals, strict=True)
        ]
        u = unit(rng.normal(size=(10, 6)))
        reached = np.stack([(u @ a.T).max(axis=1) for a in w], axis=1)
        h = contact_supports(cones, u)
        assert (reached <= h + 1e-12).all()
        assert (reached > h - 1e-2).all()
        np.testing.assert_allclose(support(cones, u), h.max(axis=1))


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_tangents_complete_a_right_handed_frame(v):
    n = unit(np.array(v))
    t1, t2 = tangents(n)
    frame = np.stack([n, t1, t2])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) > 0


@pytest.mark.parametrize("z", [-1.0, 1.0])
def test_tangents_at_the_poles(z):
    t1, t2 = tangents(np.array([0.0, 0.0, z]))
    np.testing.assert_allclose(np.cross(t1, t2), [0.0, 0.0, z], atol=1e-15)


def test_pair_closure_is_the_angle_test():
    rng = np.random.default_rng(2)
    points = rng.normal(size=(500, 2, 3))
    line = unit(points[:, 1] - points[:, 0])
    normals = unit(np.stack([line, -line], axis=1) + 0.7 * rng.normal(size=(500, 2, 3)))
    for mu in (0.3, 0.8, 2.0):
        angles = [
            np.arccos((line * normals[:, 0]).sum(1)),
            np.arccos(-(line * normals[:, 1]).sum(1)),
        ]
        expected = np.maximum(*angles) < np.arctan(mu)
        assert 0 < expected.mean() < 1
        np.testing.assert_array_equal(pair_closure(points, normals, friction=mu), expected)


def test_pair_closure_of_coincident_points_is_false():
    points = np.zeros((2, 3))
    normals = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    assert not pair_closure(points, normals, friction=0.8)
    apart = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    assert pair_closure(apart, normals, friction=0.8)
    assert not pair_closure(apart, normals, friction=0.0)


GOOD = {
    "points": np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]),
    "normals": np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]),
    "friction": 0.8,
    "torsion": 0.003,
    "torque_scale": 0.05,
    "origin": np.zeros(3),
}
BAD = [
    ("normals", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])),
    ("normals", np.array([[1.0, 0.0, 0.0], [-2.0, 0.0, 0.0]])),
    ("normals", np.array([[1.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])),
    ("normals", np.array([[1.0, 0.0, 0.0]])),
    ("normals", np.array([[1.0, 0.0], [1.0, 0.0]])),
    ("points", np.array([[np.inf, 0.0, 0.0], [0.1, 0.0, 0.0]])),
    ("points", np.zeros((0, 3))),
    ("points", np.zeros(3)),
    ("friction", -0.1),
    ("friction", np.nan),
    ("torsion", -1e-9),
    ("torsion", np.inf),
    ("torque_scale", 0.0),
    ("torque_scale", -0.1),
    ("torque_scale", np.nan),
    ("origin", np.zeros(2)),
    ("origin", np.array([0.0, np.nan, 0.0])),
]


@pytest.mark.parametrize(("name", "value"), BAD)
def test_bad_contacts_are_refused_by_name(name, value):
    arguments = {**GOOD, name: value}
    if name == "points" and value.shape == (0, 3):
        arguments["normals"] = value
    points, normals = arguments.pop("points"), arguments.pop("normals")
    with pytest.raises(MetricError, match=name):
        check_contacts(points, normals, **arguments)


def test_good_contacts_pass():
    arguments = dict(GOOD)
    check_contacts(arguments.pop("points"), arguments.pop("normals"), **arguments)
