"""Epsilon against closed forms, laws, and brute force that shares no code with it."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize, nnls
from scipy.spatial import ConvexHull

from gmdx.errors import MetricError
from gmdx.metrics._incremental import _across
from gmdx.metrics._relaxation import relaxation_bound
from gmdx.metrics.epsilon import epsilon, epsilon_batch
from gmdx.metrics.wrench import pair_closure, wrench_cones

CASES = Path(__file__).parents[2].parent / "shared" / "epsilon_cases.json"
X, Y, Z = np.eye(3)


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


# --- brute force, from the definition -------------------------------------------------


def frame(n):
    t1 = unit(np.cross(n, [0.3, 0.5, 0.8] if abs(n @ unit(np.array([0.3, 0.5, 0.8]))) < 0.9 else X))
    return t1, np.cross(n, t1)


def brute_cones(points, normals, friction, torsion, torque_scale, origin):
    """(c, B): lists of 6-vectors and 6x3 matrices."""
    out = []
    for p, n in zip(points, normals, strict=True):
        arm = (p - origin) / torque_scale
        columns = [np.r_[friction * t, friction * np.cross(arm, t)] for t in frame(n)]
        columns.append(np.r_[np.zeros(3), torsion / torque_scale * n])
        out.append((np.r_[n, np.cross(arm, n)], np.stack(columns, axis=1)))
    return np.stack([c for c, _ in out]), np.stack([b for _, b in out])


def brute_h(c, b, u):
    slip = np.einsum("kir,...i->...kr", b, u)
    return (u @ c.T + np.linalg.norm(slip, axis=-1)).max(axis=-1)


def brute_minimum(grasp, seed=0, starts=10, samples=20000):
    """Least support over unit directions: random search, then SLSQP from the best directions."""
    c, b = brute_cones(**grasp)
    rng = np.random.default_rng(seed)
    columns = np.concatenate([c, *np.moveaxis(b, 2, 0)])
    w, v = np.linalg.eigh(columns.T @ columns)
    stretch = v / np.sqrt(np.maximum(w, 1e-12 * w[-1]))
    spread = rng.normal(size=(samples, 6))
    u = unit(np.concatenate([spread @ stretch.T, spread[: samples // 4], v.T, -v.T]))
    h = brute_h(c, b, u)
    best = h.min()
    chosen = []
    for i in np.argsort(h):
        if all(u[i] @ u[j] < 0.95 for j in chosen):
            chosen.append(i)
        if len(chosen) == starts:
            break
    for i in chosen:
        x = np.r_[u[i] @ np.linalg.pinv(stretch).T, h[i]]
        scale = np.linalg.norm(x[:6])
        x[:6] /= scale

        def limits(x, scale=1 / scale):
            d = stretch @ x[:6]
            slip = np.einsum("kir,i->kr", b, d)
            return x[6] * np.linalg.norm(d) - c @ d - np.sqrt((slip**2).sum(1) + 1e-24)

        found = minimize(
            lambda x: x[6],
            x,
            jac=lambda x: np.eye(7)[6],
            method="SLSQP",
            constraints=[
                {"type": "ineq", "fun": limits},
                {"type": "eq", "fun": lambda x: x[:6] @ x[:6] - 1.0},
            ],
            options={"maxiter": 80, "ftol": 1e-13},
        )
        d = stretch @ found.x[:6]
        if np.isfinite(d).all() and np.linalg.norm(d) > 0:
            best = min(best, brute_h(c, b, unit(d)))
    return best


def sampled_distance(grasp, count=1500, seed=0):
    """Distance from 0 to the convex hull of sampled wrenches: at least the true distance."""
    c, b = brute_cones(**grasp)
    s = unit(np.random.default_rng(seed).normal(size=(count, 3)))
    w = (c[:, None] + np.einsum("kir,sr->ksi", b, s)).reshape(-1, 6)
    # min |sum a w|^2 with sum a = 1, as non-negative least squares with a stiff last row.
    stiff = 1e3
    a, _ = nnls(np.vstack([w.T, np.full(len(w), stiff)]), np.r_[np.zeros(6), stiff])
    return np.linalg.norm(w.T @ a) / a.sum()


# --- grasps ---------------------------------------------------------------------------


def pair(rng, tilt=0.5, gamma=0.003, scale=0.05):
    e = unit(rng.normal(size=3))
    r = rng.uniform(0.005, 0.04)
    n = unit(np.stack([e, -e]) + tilt * rng.uniform(-1, 1, size=(2, 3)))
    points = np.stack([-r * e, r * e]) + rng.normal(size=3) * 0.02
    return grasp(points, n, torsion=gamma, torque_scale=scale)


def grasp(points, normals, friction=0.8, torsion=0.003, torque_scale=0.05, origin=None):
    return {
        "points": np.asarray(points, float),
        "normals": np.asarray(normals, float),
        "friction": friction,
        "torsion": torsion,
        "torque_scale": torque_scale,
        "origin": np.zeros(3) if origin is None else origin,
    }


def pads(rng, k, curved):
    """Two opposed patches of k contacts each, flat or on a sphere."""
    r, radius = rng.uniform(0.01, 0.03), rng.uniform(0.03, 0.2)
    points, normals = [], []
    for side in (-1.0, 1.0):
        g = rng.uniform(-0.008, 0.008, size=(k, 2))
        if curved:
            x = side * (r - (g**2).sum(1) / (2 * radius))
            n = unit(np.column_stack([np.full(k, -side), -g / radius]))
        else:
            slope = rng.uniform(-0.2, 0.2, size=2)
            x = side * r + g @ slope
            n = np.tile(unit(np.r_[-side, side * slope]), (k, 1))
        points.append(np.column_stack([x, g]))
        normals.append(n)
    offset = rng.normal(size=3) * [0.004, 0.01, 0.01]
    return grasp(np.concatenate(points) + offset, np.concatenate(normals))


def scattered(rng, k):
    """k contacts about the origin, roughly facing it."""
    p = unit(rng.normal(size=(k, 3)))
    n = unit(-p + 0.3 * rng.normal(size=(k, 3)))
    return grasp(p * rng.uniform(0.02, 0.04, size=(k, 1)), n, friction=rng.uniform(0.3, 1.0))


def scaled(g, factor):
    lengths = ("points", "torsion", "torque_scale", "origin")
    return {**g, **{name: factor * g[name] for name in lengths}}


def variety(rng, i):
    """Grasp i of a mixture with 2 to 20 contacts and every degeneracy worth the name."""
    kind = i % 12
    if kind == 0:
        return pair(rng)
    if kind == 1:
        return pair(rng, tilt=0.0)  # aligned
    if kind == 2:
        return pair(rng, tilt=1e-5, gamma=10.0 ** rng.uniform(-7, -4))  # tiny gamma
    if kind == 3:
        return pair(rng, gamma=10.0 ** rng.uniform(-1, 1))  # huge gamma
    if kind == 4:
        return scaled(pair(rng), 1000.0)  # in millimetres
    if kind == 5:
        return scattered(rng, int(rng.integers(3, 6)))
    if kind == 6:
        return scattered(rng, int(rng.integers(6, 21)))
    if kind == 7:
        return pads(rng, int(rng.integers(2, 11)), curved=False)
    if kind == 8:
        return pads(rng, int(rng.integers(2, 11)), curved=True)
    if kind == 9:  # coincident contacts
        g = pads(rng, 2, curved=False)
        again = [0, 0, 1, 2, 2, 3]
        return {**g, "points": g["points"][again], "normals": g["normals"][again]}
    if kind == 10:  # the line between the contacts grazes a friction cone
        g = pair(rng, tilt=0.0)
        line, side = g["normals"][0], frame(g["normals"][0])[0]
        angle = np.arctan(0.8) - 10.0 ** rng.uniform(-4, -1)
        return {**g, "normals": np.stack([np.cos(angle) * line + np.sin(angle) * side, -line])}
    return scaled(scattered(rng, int(rng.integers(3, 9))), 1e-3)  # micrometres


def assert_bracketed(g, seed, rtol=1e-4, **effort):
    e = epsilon(**g, rtol=rtol, **effort)
    brute = brute_minimum(g, seed)
    size = max(abs(brute), 1e-9)
    assert e.lower <= e.upper
    assert e.lower <= brute + 1e-9 * size
    # brute force is a local search: it must not beat the certified upper bound by more than
    # the gap, and finds it itself nearly always (checked by the callers).
    assert e.upper <= brute + max(rtol * abs(e.upper), e.upper - e.lower) + 1e-9
    c, b = brute_cones(**g)
    assert np.linalg.norm(e.direction) == pytest.approx(1.0, abs=1e-12)
    assert brute_h(c, b, e.direction) == pytest.approx(e.upper, rel=1e-9, abs=1e-12)
    assert e.closure == (e.lower > 0)
    return e, brute


# --- known values ---------------------------------------------------------------------


def shared_cases():
    return json.loads(CASES.read_text())["cases"] if CASES.exists() else []


@pytest.mark.skipif(not CASES.exists(), reason="the file of reference cases is not here")
@pytest.mark.parametrize("case", shared_cases(), ids=lambda c: c["name"])
def test_reference_cases(case):
    e = epsilon(
        case["positions"],
        case["normals"],
        friction=case["mu"],
        torsion=case["gamma"],
        torque_scale=case["torque_scale"],
        origin=case["origin"],
    )
    low, high = case["eps_signed_lower"], case["eps_signed_upper"]
    assert e.certified(1e-4)
    assert e.upper == pytest.approx(0.5 * (low + high), rel=1e-5, abs=1e-9)
    assert e.lower <= high + 1e-9
    assert e.closure == case["force_closure"]


def opposed(r, **parameters):
    return grasp([-r * X, r * X], [X, -X], **parameters)


def test_form_a_aligned_pair_origin_on_its_line():
    rng = np.random.default_rng(0)
    for _ in range(10):
        r, scale = rng.uniform(0.01, 0.05), rng.uniform(0.02, 0.2)
        mu, gamma, shift = rng.uniform(0.2, 1.2), 10 ** rng.uniform(-3, 0), rng.uniform(-1, 1) * r
        e = epsilon(**opposed(r, friction=mu, torsion=gamma, torque_scale=scale, origin=shift * X))
        far = r + abs(shift)
        exact = min(gamma / scale, (1 + (far**2 + scale**2) / (mu * r) ** 2) ** -0.5)
        assert e.upper == pytest.approx(exact, rel=1e-5)
        assert e.certified(1e-4)


def test_form_a_examples():
    values = [
        epsilon(**opposed(0.04, torsion=0.4, torque_scale=0.04)).upper,
        epsilon(**opposed(0.04, torsion=0.004, torque_scale=0.1)).upper,
    ]
    np.testing.assert_allclose(values, [0.492365964, 0.04], rtol=1e-8)


def test_form_b_aligned_pair_origin_off_its_line():
    rng = np.random.default_rng(1)
    grasps = [(0.04, 0.06, 0.8, 0.004, 0.03)] + [
        (
            rng.uniform(0.01, 0.05),
            rng.uniform(0.03, 0.15),
            rng.uniform(0.3, 1.2),
            10 ** rng.uniform(-3, -0.5),
            rng.uniform(0, 0.05),
        )
        for _ in range(10)
    ]
    for r, scale, mu, gamma, d in grasps:
        e = epsilon(**opposed(r, friction=mu, torsion=gamma, torque_scale=scale, origin=d * Y))
        t = mu**-2 + (d**2 + scale**2) / gamma**2
        lam = (t + np.sqrt(t**2 - 4 * scale**2 / (mu * gamma) ** 2)) / 2
        exact = min(lam**-0.5, ((1 + d / (mu * r)) ** 2 + (1 + scale**2 / r**2) / mu**2) ** -0.5)
        assert e.upper == pytest.approx(exact, rel=1e-5)
        assert e.certified(1e-4)


@pytest.mark.parametrize(("b", "scale"), [(0.03, 0.05), (0.02, 0.1), (0.03, 0.02)])
def test_form_c_frictionless_cube(b, scale):
    points, normals = [], []
    half = 0.05
    for axis in range(3):
        for side in (-1.0, 1.0):
            for shift in (-b, b):
                n, across = np.zeros(3), np.zeros(3)
                n[axis], across[(axis + 1) % 3] = -side, shift
                points.append(-half * n + across)
                normals.append(n)
    e = epsilon(**grasp(points, normals, friction=0.0, torsion=0.0, torque_scale=scale))
    assert e.upper == pytest.approx(min(1.0, b / scale) / np.sqrt(3), rel=1e-5)
    assert e.certified(1e-4)


def test_form_e_two_hard_fingers_are_flat():
    e = epsilon(**opposed(0.03, torsion=0.0))
    assert e.upper == pytest.approx(0.0, abs=1e-9)
    assert e.lower == pytest.approx(0.0, abs=1e-8)
    assert not e.closure
    assert e.method == "flat"


@pytest.mark.parametrize("mu", [0.55, 0.8, 1.0])
def test_form_f_three_hard_fingers(mu):
    r, scale = 0.04, 0.1
    angles = np.arange(3) * 2 * np.pi / 3
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    e = epsilon(**grasp(r * ring, -ring, friction=mu, torsion=0.0, torque_scale=scale))
    assert e.upper == pytest.approx((1 + (scale / r) ** 2 * (3 / mu**2 - 1)) ** -0.5, rel=1e-5)
    assert e.certified(1e-4)


@pytest.mark.parametrize(("mu", "alpha"), [(0.8, 0.9), (0.8, 1.3), (0.3, 0.5)])
def test_form_h_both_normals_tilted_out_of_the_cone(mu, alpha):
    n = np.array([[np.cos(alpha), np.sin(alpha), 0.0], [-np.cos(alpha), np.sin(alpha), 0.0]])
    e = epsilon(**grasp([-0.03 * X, 0.03 * X], n, friction=mu))
    assert e.upper == pytest.approx(-(np.sin(alpha) - mu * np.cos(alpha)), rel=1e-7)
    assert e.certified(1e-4)
    assert not e.closure


def test_one_contact_is_at_its_distance():
    # One contact's wrenches all press with unit force: the nearest to 0 is the smallest.
    e = epsilon([[0.0, 0.0, 0.0]], [X], friction=0.5, torsion=0.01, torque_scale=1.0, origin=Z * 0)
    assert e.upper == pytest.approx(-1.0)
    assert not e.closure


def test_pairs_obey_the_torsion_bound():
    rng = np.random.default_rng(3)
    for _ in range(30):
        g = pair(rng, tilt=0.3)
        line = unit(g["points"][1] - g["points"][0])
        d = np.linalg.norm(np.cross(g["points"][0], line))
        most = g["torsion"] * np.abs(g["normals"] @ line).max() / np.hypot(g["torque_scale"], d)
        assert epsilon(**g).lower <= most * (1 + 1e-9)


# --- brute force ----------------------------------------------------------------------


def test_a_variety_of_grasps_against_brute_force():
    found = []
    for i in range(36):
        e, brute = assert_bracketed(variety(np.random.default_rng([7, i]), i), i)
        assert e.certified(1e-4)
        found.append(brute <= e.upper + 1e-4 * abs(e.upper) + 1e-8)
    assert np.mean(found) > 0.85


@pytest.mark.slow
def test_many_grasps_against_brute_force():
    found, certified = [], []
    for i in range(300):
        g = variety(np.random.default_rng([8, i]), i)
        rtol = 1e-4 if len(g["points"]) <= 8 else 1e-3
        e, brute = assert_bracketed(g, i, rtol)
        certified.append(e.certified(rtol))
        found.append(brute <= e.upper + rtol * abs(e.upper) + 1e-8)
    assert np.mean(certified) > 0.99
    assert np.mean(found) > 0.85


def test_negative_values_against_sampled_cones():
    checked = 0
    for i in range(60):
        rng = np.random.default_rng([9, i])
        k = int(rng.integers(1, 6))
        g = grasp(rng.normal(size=(k, 3)) * 0.03, unit(rng.normal(size=(k, 3))), friction=0.5)
        e = epsilon(**g)
        if e.closure:
            continue
        assert e.certified(1e-4)
        distance = sampled_distance(g)
        assert -e.upper <= distance + 1e-6  # sampled cones lie inside the true ones
        assert distance <= -e.lower + 0.01
        checked += distance > 0.05
    assert checked > 20


def test_large_torsion_can_hold_what_the_line_test_refuses():
    held = 0
    for i in range(60):
        g = pair(np.random.default_rng([16, i]), tilt=1.2, gamma=1.0)
        if pair_closure(g["points"], g["normals"], friction=g["friction"]):
            continue
        e = epsilon(**g)
        assert e.certified(1e-4)
        if e.closure and held < 4:
            assert brute_minimum(g, starts=5) >= e.lower * (1 - 1e-9)
            assert sampled_distance(g) < 1e-9
            held += 1
    assert held == 4


def test_relaxation_of_any_contacts_and_pairs_stays_below():
    for i in range(25):
        rng = np.random.default_rng([10, i])
        g = pads(rng, 3, curved=bool(i % 2))
        upper = epsilon(**g, rtol=1e-3).upper
        cones = wrench_cones(**g)
        some = np.sort(rng.permutation(6)[: rng.integers(4, 7)])
        pairs = tuple((a, b) for a in range(len(some)) for b in range(a) if rng.random() < 0.5)
        for transposed in (False, True):
            bound = relaxation_bound(
                cones[some],
                pairs if pairs else ((0, 1),),
                transposed=transposed,
                tol=10.0 ** rng.uniform(-8, -1),
            )
            assert 0 <= bound.value <= upper * (1 + 1e-9)


def test_facets_that_do_not_close_are_noticed():
    points = unit(np.random.default_rng(15).normal(size=(30, 6)))
    hull = ConvexHull(points)
    opposite = _across(hull.simplices, hull.neighbors)
    for f in (0, 7, len(hull.simplices) - 1):
        for i in range(6):
            g = hull.neighbors[f, i]
            assert set(hull.simplices[g]) - set(hull.simplices[f]) == {opposite[f, i]}
    torn = hull.neighbors.copy()
    torn[3, 2] = -1
    assert _across(hull.simplices, torn) is None
    swapped = hull.simplices.copy()
    swapped[5, 0] = next(v for v in range(30) if v not in swapped[5])
    assert _across(swapped, hull.neighbors) is None


# --- laws -----------------------------------------------------------------------------

SEEDS = st.integers(0, 2**31)


def law_grasp(seed):
    rng = np.random.default_rng([11, seed])
    if seed % 3 == 0:
        return pair(rng)
    return pads(rng, int(rng.integers(1, 4)), curved=bool(seed % 2))


def same(one, other, rtol=1e-3):
    """Two brackets of one value meet, and both are narrow."""
    assert one.lower <= other.upper + 1e-9
    assert other.lower <= one.upper + 1e-9
    assert one.certified(rtol)
    assert other.certified(rtol)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_rigid_motion_changes_nothing(seed):
    g = law_grasp(seed)
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    shift = rng.normal(size=3)
    moved = {
        **g,
        "points": g["points"] @ turn.T + shift,
        "normals": g["normals"] @ turn.T,
        "origin": turn @ g["origin"] + shift,
    }
    same(epsilon(**g, rtol=1e-3), epsilon(**moved, rtol=1e-3))


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_the_order_of_contacts_changes_nothing(seed):
    g = law_grasp(seed)
    order = np.random.default_rng(seed).permutation(len(g["points"]))
    other = {**g, "points": g["points"][order], "normals": g["normals"][order]}
    same(epsilon(**g, rtol=1e-3), epsilon(**other, rtol=1e-3))


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.floats(-3, 3))
def test_a_common_scale_of_all_lengths_changes_nothing(seed, decades):
    g = law_grasp(seed)
    same(epsilon(**g, rtol=1e-3), epsilon(**scaled(g, 10.0**decades), rtol=1e-3))


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.sampled_from(["friction", "torsion", "torque_scale"]), st.floats(1.0, 3.0))
def test_more_friction_and_shorter_scales_never_hurt(seed, name, factor):
    g = law_grasp(seed)
    less, more = epsilon(**g, rtol=1e-3), epsilon(**{**g, name: factor * g[name]}, rtol=1e-3)
    if name == "torque_scale":
        # A longer scale shrinks torques: where K holds 0 the ball shrinks, elsewhere the
        # distance does.
        if less.closure or more.closure:
            assert more.lower <= less.upper + 1e-9
    else:
        assert less.lower <= more.upper + 1e-9


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_another_contact_never_hurts(seed):
    g = law_grasp(seed)
    rng = np.random.default_rng(seed)
    more = {
        **g,
        "points": np.vstack([g["points"], rng.normal(size=3) * 0.03]),
        "normals": np.vstack([g["normals"], unit(rng.normal(size=3))]),
    }
    assert epsilon(**g, rtol=1e-2).lower <= epsilon(**more, rtol=1e-2).upper + 1e-9


# --- interface ------------------------------------------------------------------------


def test_an_unfinished_proof_is_reported_as_such():
    g = scattered(np.random.default_rng([12, 1]), 12)
    quick = epsilon(**g, rtol=1e-6, most_points=0)
    good = epsilon(**g, rtol=1e-3)
    assert not quick.certified(1e-6)
    assert quick.gap > 1e-6
    assert good.closure
    assert quick.lower <= good.upper
    assert quick.upper >= good.lower


def test_the_same_call_gives_the_same_bits():
    g = pads(np.random.default_rng(13), 6, curved=False)
    one, other = epsilon(**g, rtol=1e-2), epsilon(**g, rtol=1e-2)
    assert (one.lower, one.upper, one.method) == (other.lower, other.upper, other.method)
    np.testing.assert_array_equal(one.direction, other.direction)


def batch_of(grasps, slots):
    points = np.full((len(grasps), slots, 3), np.nan)
    normals, valid = points.copy(), np.zeros((len(grasps), slots), bool)
    for i, g in enumerate(grasps):
        where = np.random.default_rng(i).permutation(slots)[: len(g["points"])]
        points[i, where], normals[i, where] = g["points"], g["normals"]
        valid[i, where] = True
    return points, normals, valid


def test_a_batch_agrees_with_single_grasps():
    rng = np.random.default_rng(14)
    grasps = [pads(rng, 4, curved=True), pair(rng, tilt=0.2), pair(rng, tilt=3.0)]
    grasps += [grasp(np.zeros((0, 3)), np.zeros((0, 3)))]
    parameters = {"friction": 0.8, "torsion": 0.003, "torque_scale": 0.05, "origin": np.zeros(3)}
    points, normals, valid = batch_of(grasps, 9)
    unsigned = epsilon_batch(points, normals, valid, **parameters, rtol=1e-3)
    signed = epsilon_batch(points, normals, valid, **parameters, rtol=1e-3, signed=True)
    single = [epsilon(**g, rtol=1e-3) for g in grasps[:3]]
    assert not single[2].closure
    for i, e in enumerate(single):
        assert signed.lower[i] <= e.upper
        assert e.lower <= signed.upper[i]
        assert signed.closure[i] == unsigned.closure[i] == e.closure
        assert signed.method[i] == e.method
    assert (unsigned.lower[valid.any(axis=1)] >= 0).all()
    assert (unsigned.lower[2], unsigned.upper[2], unsigned.method[2]) == (0.0, 0.0, "no closure")
    assert np.isnan(unsigned.direction[2]).all()
    assert np.isnan([signed.lower[3], signed.upper[3]]).all()
    assert signed.method[3] == "no contact"
    assert not signed.closure[3]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("normals", [[1.0, 0, 0], [0.0, 0, 0]]),
        ("normals", [[1.0, 0, 0], [-1.1, 0, 0]]),
        ("normals", [[1.0, 0, 0]]),
        ("normals", [["a", "b", "c"]]),
        ("points", [[np.nan, 0, 0], [0.03, 0, 0]]),
        ("points", [[0.0, 0, 0], [0.03, 0]]),
        ("points", []),
        ("points", np.zeros((2, 2, 3))),
        ("friction", -1.0),
        ("torsion", -1.0),
        ("torque_scale", 0.0),
        ("origin", [0.0, 0.0]),
        ("rtol", 0.0),
        ("most_points", -1),
    ],
)
def test_bad_arguments_are_named(name, value):
    arguments = {**opposed(0.03), name: value}
    with pytest.raises(MetricError, match=name):
        epsilon(**arguments)


def test_bad_batches_are_refused():
    points, normals, valid = batch_of([opposed(0.03)], 2)
    parameters = {"torsion": 0.003, "torque_scale": 0.05, "origin": np.zeros(3)}
    with pytest.raises(MetricError, match="friction"):
        epsilon_batch(points, normals, valid, friction=-0.1, **parameters)
    normals[0] *= 2
    with pytest.raises(MetricError, match="normals"):
        epsilon_batch(points, normals, valid, friction=0.8, **parameters)
