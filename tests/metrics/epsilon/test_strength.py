"""Directional strength against closed forms, a linear programme, and its relation to epsilon."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from gmdx.errors import MetricError
from gmdx.metrics.epsilon.certified import epsilon
from gmdx.metrics.epsilon.strength import directional_strength, gravity_wrench
from tests.metrics.epsilon_grasps import (
    X,
    Y,
    Z,
    brute_cones,
    brute_h,
    grasp,
    opposed,
    out_of_proportion,
    pads,
    pair,
    scaled,
    scattered,
    unit,
    variety,
)


def lengths(g):
    return np.repeat([1.0, g["torque_scale"]], 3)


def check(g, wrench):
    """The forces obey every limit, balance the wrench, and nothing holds more."""
    s = directional_strength(**g, wrench=wrench)
    p, n, mu, gamma = g["points"], g["normals"], g["friction"], g["torsion"]
    pressed = np.einsum("ki,ki->k", s.forces, n)
    slip = np.linalg.norm(s.forces - pressed[:, None] * n, axis=1)
    assert (pressed >= -1e-12).all()
    assert pressed.sum() <= 1 + 1e-12
    assert (slip <= mu * pressed + 1e-12).all()
    assert (np.abs(s.moments) <= gamma * (pressed + 1e-12)).all()
    if mu > 0 and gamma > 0:
        assert (np.hypot(slip / mu, s.moments / gamma) <= pressed + 1e-9).all()
    torque = np.cross(p - g["origin"], s.forces) + s.moments[:, None] * n
    exerted = np.concatenate([s.forces.sum(axis=0), torque.sum(axis=0)]) / lengths(g)
    load = np.asarray(wrench) / lengths(g)
    assert np.linalg.norm(exerted + s.value * load) <= 1e-9
    assert s.imbalance <= 1e-9
    c, b = brute_cones(**g)
    along = s.direction @ -load
    assert np.linalg.norm(s.direction) == pytest.approx(1.0)
    proved = max(brute_h(c, b, s.direction), 0.0) / along
    assert s.upper == pytest.approx(proved, rel=1e-9, abs=1e-12)
    assert 0 <= s.lower <= s.upper
    assert s.upper - s.lower <= max(1e-6 * s.upper, 1e-7 / np.linalg.norm(load))
    return s


# --- closed forms ---------------------------------------------------------------------


def test_a_pinch_holds_by_friction_what_hangs_below_it():
    # Two fingers, normal forces 1/2 each, friction mu / 2 each: mu for each newton of grip.
    s = check(opposed(0.03, friction=0.6), gravity_wrench(0.1, -Z))
    assert s.value == pytest.approx(0.6 / (0.1 * 9.81))
    np.testing.assert_allclose(s.forces, [[0.5, 0, 0.3], [-0.5, 0, 0.3]], atol=1e-9)
    np.testing.assert_allclose(s.moments, 0.0, atol=1e-9)


def test_the_load_is_what_the_contacts_oppose():
    # One contact pushes along +x: it stands up to a load along -x and to nothing else.
    one = grasp([-0.03 * X], [X])
    assert check(one, np.r_[-X, 0 * X]).value == pytest.approx(1.0)
    assert check(one, np.r_[X, 0 * X]).value == 0.0
    assert check(one, np.r_[Z, 0 * X]).value == 0.0


@pytest.mark.parametrize(
    ("wrench", "value"),
    [
        (np.r_[2 * X, 0 * X], 0.5),  # along a normal: one finger bears it all
        (np.r_[0 * X, 0.01 * X], 0.4),  # about the line between the fingers: torsion, gamma
        (np.r_[0 * X, 0.01 * Z], 2.4),  # across it: friction at arm r, mu r
        (np.r_[Y, 0 * X], 0.8),
    ],
)
def test_simple_loads_on_a_pinch(wrench, value):
    g = opposed(0.03, friction=0.8, torsion=0.004)
    assert check(g, wrench).value == pytest.approx(value, rel=1e-9)
    other = {**g, "torque_scale": 0.2}  # sets the length of wrenches, not the strength
    assert check(other, wrench).value == pytest.approx(value, rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.1, 1.5), st.floats(1e-4, 0.1), st.floats(-0.05, 0.05), st.floats(0, 2 * np.pi))
def test_a_weight_beside_the_fingers_slides_and_twists_at_once(mu, gamma, offset, angle):
    # The weight acts at `offset` beside the line of the fingers: force F and moment F x offset
    # share the elliptic limit surface, so (F / mu)^2 + (F offset / gamma)^2 = 1.
    down = np.array([0.0, np.cos(angle), np.sin(angle)])
    center = offset * np.cross(X, down)
    load = gravity_wrench(0.3, down, center_of_mass=center)
    s = check(opposed(0.02, friction=mu, torsion=gamma), load)
    weight = 0.3 * 9.81
    exact = 1 / np.hypot(weight / mu, weight * offset / gamma)
    assert s.value == pytest.approx(exact, rel=1e-7)


def test_without_friction_only_normals_resist():
    g = opposed(0.03, friction=0.0, torsion=0.0)
    assert check(g, np.r_[X, 0 * X]).value == pytest.approx(1.0)
    assert check(g, np.r_[Z, 0 * X]).value == 0.0
    assert check(g, np.r_[X + 1e-3 * Z, 0 * X]).value == 0.0
    assert check(g, np.r_[0 * X, X]).value == 0.0


# --- relations ------------------------------------------------------------------------


def load(rng, g):
    return rng.normal(size=6) * lengths(g) * 10.0 ** rng.uniform(-2, 2)


def test_all_kinds_of_grasps():
    resisted = 0
    for i in range(120):
        rng = np.random.default_rng([20, i])
        g = variety(rng, i)
        if i % 12 == 10:
            continue  # grazing: below
        resisted += check(g, load(rng, g)).value > 0
    assert resisted > 80


def test_a_line_that_grazes_a_friction_cone():
    # Forces a million times the load: they balance to 1e-9 of the grip, not of the load.
    for i in range(12):
        rng = np.random.default_rng([21, i])
        g = variety(rng, 10)
        s = directional_strength(**g, wrench=load(rng, g))
        assert 0 <= s.lower <= s.upper
        assert s.imbalance <= 1e-9
        assert s.gap <= 1e-6


def test_a_linear_programme_over_sampled_cones_agrees():
    rng = np.random.default_rng(22)
    sample = unit(rng.normal(size=(700, 3)))
    for i in range(12):
        g = scattered(rng, 4) if i % 2 else pair(rng, tilt=0.2)
        c, b = brute_cones(**g)
        w = (c[:, None] + np.einsum("kir,sr->ksi", b, sample)).reshape(-1, 6)
        e = load(rng, g)
        target = e / lengths(g)
        s = check(g, e)
        size = np.linalg.norm(target)
        found = linprog(
            np.r_[-1.0, np.zeros(len(w))],
            A_ub=np.r_[0.0, np.ones(len(w))][None],
            b_ub=[1.0],
            A_eq=np.column_stack([target / size, w.T]),
            b_eq=np.zeros(6),
        )
        inner = -found.fun / size  # sampled cones lie inside the true ones
        assert inner <= s.upper * (1 + 1e-7)
        assert inner >= 0.97 * s.lower


def test_it_is_the_least_ratio_of_support_and_alignment():
    for i in range(20):
        rng = np.random.default_rng([23, i])
        g = pads(rng, 3, curved=bool(i % 2))
        e = load(rng, g)
        d = -e / lengths(g)
        c, b = brute_cones(**g)
        u = rng.normal(size=(5000, 6))
        along = u @ d
        ratio = np.maximum(brute_h(c, b, u[along > 0]), 0) / along[along > 0]
        s = directional_strength(**g, wrench=e)
        assert s.lower <= ratio.min() * (1 + 1e-12)
        near = s.direction + 1e-4 * u
        along = near @ d
        ratio = np.maximum(brute_h(c, b, near[along > 0]), 0) / along[along > 0]
        assert s.lower <= ratio.min() * (1 + 1e-9)


def test_epsilon_is_the_least_strength():
    checked = 0
    for i in range(60):
        rng = np.random.default_rng([24, i])
        g = variety(rng, i)
        if len(g["points"]) > 8:
            continue
        e = epsilon(**g, rtol=1e-3)
        if not e.closure:
            continue
        for _ in range(3):
            any_wrench = unit(rng.normal(size=6)) * lengths(g)
            assert e.lower <= directional_strength(**g, wrench=any_wrench).upper * (1 + 1e-9)
        worst = directional_strength(**g, wrench=-e.direction * lengths(g))
        assert worst.upper == pytest.approx(e.upper, rel=2e-3 if e.upper > 1e-4 else 1e-2)
        assert worst.upper <= e.upper * (1 + 1e-9)
        checked += 1
    assert checked > 30


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.floats(-3, 3))
def test_laws(seed, decades):
    rng = np.random.default_rng([25, seed])
    g = pair(rng) if seed % 2 else pads(rng, 2, curved=True)
    e = rng.normal(size=6) * lengths(g)
    s = directional_strength(**g, wrench=e)
    factor = 10.0**decades
    # Twice the load, half the multiple; lengths in other units; and a rigid motion.
    assert directional_strength(**g, wrench=factor * e).value == pytest.approx(
        s.value / factor, rel=1e-6
    )
    units = directional_strength(**scaled(g, factor), wrench=e * np.repeat([1, factor], 3))
    assert units.value == pytest.approx(s.value, rel=1e-6)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = {
        **g,
        "points": g["points"] @ turn.T + 1.0,
        "normals": g["normals"] @ turn.T,
        "origin": turn @ g["origin"] + 1.0,
    }
    turned = directional_strength(**moved, wrench=np.r_[turn @ e[:3], turn @ e[3:]])
    assert turned.value == pytest.approx(s.value, rel=1e-6)
    # About another point the same load has another torque and the same strength.
    shift = rng.normal(size=3) * 0.02
    other = np.r_[e[:3], e[3:] - np.cross(shift, e[:3])]
    about = directional_strength(**{**g, "origin": g["origin"] + shift}, wrench=other)
    assert about.value == pytest.approx(s.value, rel=1e-6)
    for name in ("friction", "torsion"):
        more = directional_strength(**{**g, name: 1.5 * g[name]}, wrench=e)
        assert more.value >= s.value * (1 - 1e-7)


# --- interface ------------------------------------------------------------------------


def test_weight():
    np.testing.assert_allclose(gravity_wrench(2.0, [0, 0, -3.0]), [0, 0, -19.62, 0, 0, 0])
    moon = gravity_wrench(2.0, -Z, center_of_mass=0.1 * X, origin=0.3 * X, gravity=1.62)
    np.testing.assert_allclose(moon, [0, 0, -3.24, 0, -0.648, 0], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wrench", np.zeros(6)),
        ("wrench", np.full(6, np.nan)),
        ("wrench", np.full(6, np.inf)),
        ("wrench", np.ones(3)),
        ("wrench", np.ones((1, 6))),
        ("points", np.zeros((2, 2, 3))),
        ("points", [[np.nan, 0, 0], [0.03, 0, 0]]),
        ("normals", [[1.0, 0, 0], [0.0, 0, 0]]),
        ("normals", [[1.0, 0, 0]]),
        ("friction", -1.0),
        ("torsion", np.nan),
        ("torque_scale", 0.0),
        ("origin", [0.0, 0.0]),
    ],
)
def test_bad_arguments_are_named(name, value):
    with pytest.raises(MetricError, match=name):
        directional_strength(**{**opposed(0.03), "wrench": np.r_[X, X], name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", 0.0),
        ("mass", np.nan),
        ("down", np.zeros(3)),
        ("down", [0.0, 1.0]),
        ("center_of_mass", [np.nan, 0, 0]),
        ("origin", [np.inf, 0, 0]),
        ("gravity", -9.81),
    ],
)
def test_bad_weights_are_named(name, value):
    with pytest.raises(MetricError, match=name):
        gravity_wrench(**{"mass": 0.1, "down": -Z, name: value})


def test_numbers_out_of_all_proportion_are_refused_or_bounded():
    refused = set()
    for i in range(150):
        rng = np.random.default_rng([26, i])
        g = out_of_proportion(rng, i)
        e = rng.normal(size=6) * 10.0 ** float(rng.choice([-300, -90, 0, 90, 300]))
        try:
            s = directional_strength(**g, wrench=e)
        except MetricError as error:
            refused.add(str(error).split()[0])
            continue
        assert np.isfinite([s.lower, s.upper]).all()
        assert 0 <= s.lower <= s.upper
    assert refused == {"points", "friction", "torsion", "wrench"}


def test_values_of_the_wrong_type_are_named():
    # Without the test-time checks of annotations, as users run it.
    program = """
import numpy as np
from gmdx.errors import MetricError
from gmdx.metrics.epsilon.strength import directional_strength, gravity_wrench
good = {"points": [[-1.0, 0, 0], [1.0, 0, 0]], "normals": [[1.0, 0, 0], [-1.0, 0, 0]],
        "friction": 1, "torsion": 0.1, "torque_scale": 1, "origin": [0, 0, 0],
        "wrench": [1, 0, 0, 0, 0, 0]}
directional_strength(**good)
bad = [None, "1", True, 1j, [1.0, 2.0], np.inf, {}]
cases = [(directional_strength, good, name, value) for name in good for value in bad]
weight = {"mass": 1, "down": [0, 0, -1]}
cases += [(gravity_wrench, weight, name, value) for name in weight for value in bad]
for function, arguments, name, value in cases:
    try:
        function(**{**arguments, name: value})
    except MetricError as error:
        assert name in str(error), (name, value, error)
    else:
        raise AssertionError((name, value))
print(len(cases))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 63
