"""Both implementations on the same cases: closed forms, brute force, laws, proofs."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gmdx_kernels.epsilon import IMPLEMENTATIONS, PairEpsilon, pair_epsilon
from gmdx_kernels.epsilon.frame import pairs_in_line
from gmdx_kernels.epsilon.proof import proved
from gmdx_kernels.epsilon.reference import numpy_kernels
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kernels.epsilon.cases import PairBatch, batch, joined, known_pairs, mixture, single
from tests.metrics import epsilon_grasps

BRUTE: Any = epsilon_grasps  # shares no code with what is tested

CASES = Path(__file__).parents[4] / "shared" / "epsilon_cases.json"
FIELDS = ("lower", "upper", "direction")
both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)


def run(pairs: PairBatch, implementation: str, **options: Any) -> PairEpsilon:
    return pair_epsilon(**vars(pairs), implementation=implementation, **options)


# --- known values ---------------------------------------------------------------------


@both
def test_closed_forms(implementation: str) -> None:
    known = known_pairs()
    found = run(joined([k.pair for k in known]), implementation)
    exact = np.array([k.epsilon for k in known])
    np.testing.assert_allclose(found.upper, exact, rtol=1e-6, atol=1e-12)
    assert (found.lower <= exact + 1e-12).all()
    assert (found.upper - found.lower <= 1e-4 * np.abs(exact) + 1e-9).all()


@both
def test_examples_to_nine_digits(implementation: str) -> None:
    found = run(joined([k.pair for k in known_pairs()[:3]]), implementation, prove=False)
    np.testing.assert_allclose(found.upper, [0.492365964, 0.04, 0.059595233], atol=6e-10)


@both
@pytest.mark.skipif(not CASES.exists(), reason="the file of reference cases is not here")
def test_reference_cases(implementation: str) -> None:
    cases = [c for c in json.loads(CASES.read_text())["cases"] if len(c["positions"]) == 2]
    assert len(cases) >= 5
    pairs = [
        batch(
            c["positions"],
            c["normals"],
            friction=c["mu"],
            torsion=c["gamma"],
            torque_scale=c["torque_scale"],
            origin=c["origin"],
        )
        for c in cases
    ]
    found = run(joined(pairs), implementation)
    low = np.array([c["eps_signed_lower"] for c in cases])
    high = np.array([c["eps_signed_upper"] for c in cases])
    np.testing.assert_allclose(found.upper, 0.5 * (low + high), rtol=1e-5, atol=1e-9)
    assert (found.lower <= high + 1e-9).all()


def test_implementations_agree() -> None:
    pairs = mixture(300, seed=3)
    one, other = (run(pairs, implementation) for implementation in IMPLEMENTATIONS)
    np.testing.assert_allclose(other.upper, one.upper, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(other.lower, one.lower, rtol=1e-4, atol=1e-8)


# --- bounds ---------------------------------------------------------------------------


@both
def test_bounds_meet(implementation: str) -> None:
    pairs = mixture(200, seed=7)
    found = run(pairs, implementation)
    closed = found.upper > 0
    gap = (found.upper - found.lower) / np.abs(found.upper)
    assert 0.5 < closed.mean() < 0.95
    assert (gap[closed] <= 1e-4).mean() >= 0.99
    assert (gap[found.upper < -1e-9] <= 1e-6).mean() >= 0.99
    assert (found.upper - found.lower)[~closed].max() <= 1e-3
    attained = [
        BRUTE.brute_h(*BRUTE.brute_cones(**single(pairs, i)), found.direction[i])
        for i in range(200)
    ]
    np.testing.assert_allclose(found.upper, attained, rtol=1e-9, atol=1e-13)


@both
def test_upper_is_attained_and_lower_below_brute_force(implementation: str) -> None:
    pairs = mixture(30, seed=5)
    found = run(pairs, implementation)
    for i in range(30):
        one = single(pairs, i)
        c, b = BRUTE.brute_cones(**one)
        assert np.linalg.norm(found.direction[i]) == pytest.approx(1.0, abs=1e-12)
        h = BRUTE.brute_h(c, b, found.direction[i])
        assert h == pytest.approx(found.upper[i], rel=1e-9, abs=1e-13)
        if found.upper[i] > 0:
            brute = BRUTE.brute_minimum(one, starts=4, samples=4000)
            assert found.lower[i] <= brute * (1 + 1e-9)
            assert found.upper[i] <= brute * (1 + 1e-6)
        else:
            assert -found.upper[i] <= BRUTE.sampled_distance(one, count=300) + 1e-9


def test_no_certificate_proves_too_much() -> None:
    """Bounds hold whatever value and multipliers they are derived from."""
    pairs = mixture(200, seed=9)
    exact = run(pairs, "numpy", prove=False).upper
    lined = pairs_in_line(**vars(pairs))
    closed = np.flatnonzero(lined.through & (exact > 0))
    lined, exact = lined[closed], exact[closed]
    rng = np.random.default_rng(0)
    bounds = []
    for factor in (0.5, 0.99, 1.0, 1.01, 2.0):
        v = numpy_kernels().certificate(
            lined.forms, lined.twists, exact * factor, lined.balances, np.full(exact.size, 1e-4)
        )
        for size in (0.0, 1e-6, 1e-3, 1e-1):
            spoilt = v * (1.0 + size * rng.normal(size=v.shape))
            bounds.append(proved(lined, exact * factor, spoilt))
    shown = np.array(bounds)
    assert (shown <= exact * (1 + 1e-9)).all()
    assert (shown.max(axis=0) >= exact * (1 - 1e-3)).mean() > 0.99
    assert (shown == 0).any()  # spoilt ones that prove nothing say so


@both
def test_without_proof_only_upper_bounds(implementation: str) -> None:
    pairs = mixture(60, seed=2)
    proven, quick = run(pairs, implementation), run(pairs, implementation, prove=False)
    np.testing.assert_array_equal(quick.upper, proven.upper)
    np.testing.assert_array_equal(quick.direction, proven.direction)
    assert (quick.lower <= 0).all()
    assert (quick.lower <= proven.lower).all()
    np.testing.assert_array_equal(quick.lower[quick.upper < 0], proven.lower[quick.upper < 0])


@both
def test_finer_gap_on_request(implementation: str) -> None:
    pairs = mixture(40, seed=4)[np.arange(40) % 10 < 4]
    found = run(pairs, implementation, rtol=1e-5)
    closed = found.upper > 0
    assert ((found.upper - found.lower)[closed] <= 1e-5 * found.upper[closed]).all()


# --- laws -----------------------------------------------------------------------------


def rotation(q: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@both
@settings(max_examples=12, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    turn=st.tuples(*[st.floats(0.1, 1.0)] * 4),
    shift=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    scale=st.floats(1e-3, 1e3),
    grow=st.floats(1.0, 2.0),
)
def test_laws(
    implementation: str,
    seed: int,
    turn: tuple[float, ...],
    shift: tuple[float, ...],
    scale: float,
    grow: float,
) -> None:
    pairs = mixture(10, seed)
    fields, r = vars(pairs), rotation(turn)
    moved = {
        "points": pairs.points @ r.T + np.array(shift),
        "normals": pairs.normals @ r.T,
        "origin": pairs.origin @ r.T + np.array(shift),
    }
    lengths = ("points", "torsion", "torque_scale", "origin")
    same = [
        pairs,
        PairBatch(**{**fields, **moved}),
        PairBatch(**{**fields, "points": pairs.points[:, ::-1], "normals": pairs.normals[:, ::-1]}),
        PairBatch(**{**fields, **{name: scale * fields[name] for name in lengths}}),
    ]
    better = [
        PairBatch(**{**fields, name: factor * fields[name]})
        for name, factor in (("friction", grow), ("torsion", grow), ("torque_scale", 1 / grow))
    ]
    value = run(joined(same + better), implementation, prove=False).upper.reshape(-1, 10)
    for other in value[1:4]:
        np.testing.assert_allclose(other, value[0], rtol=1e-7, atol=1e-10)
    least = value[0] - 1e-7 * np.abs(value[0]) - 1e-10
    assert (value[4:6] >= least).all()
    closed = value[0] > 0  # a smaller torque scale takes K farther from a 0 that lies outside
    assert (value[6] >= least)[closed].all()


@both
def test_a_grasp_is_the_same_in_any_company(implementation: str) -> None:
    pairs = mixture(330, seed=6)
    whole = run(pairs, implementation)
    order = np.random.default_rng(0).permutation(330)
    mixed = run(pairs[order], implementation)
    cuts = (0, 1, 8, 300, 330)
    parts = [run(pairs[a:b], implementation) for a, b in pairwise(cuts)]
    for name in FIELDS:
        expected = getattr(whole, name)
        np.testing.assert_array_equal(getattr(mixed, name), expected[order])
        np.testing.assert_array_equal(np.concatenate([getattr(p, name) for p in parts]), expected)


def test_shared_parameters_and_origin() -> None:
    pairs = mixture(6, seed=8)
    common: dict[str, Any] = {"friction": 0.6, "torsion": 0.002, "torque_scale": 0.07}
    origin = np.array([0.01, 0.0, -0.02])
    shared = pair_epsilon(pairs.points, pairs.normals, **common, origin=origin)
    each: dict[str, Any] = {name: np.full(6, value) for name, value in common.items()}
    apart = pair_epsilon(pairs.points, pairs.normals, **each, origin=np.tile(origin, (6, 1)))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(shared, name), getattr(apart, name))


# --- the edges ------------------------------------------------------------------------


@both
def test_no_grasps(implementation: str) -> None:
    found = run(mixture(10)[:0], implementation)
    assert found.lower.shape == found.upper.shape == (0,)
    assert found.direction.shape == (0, 6)


@both
def test_degenerate_pairs_have_finite_bounds(implementation: str) -> None:
    x, y = np.eye(3)[:2]
    points = [-0.02 * x, 0.02 * x]
    pairs = [
        batch(points, [x, x]),
        batch(points, [-x, x]),  # pulled apart
        batch(points, [y, y]),
        batch(points, [y, -y]),
        batch([x, x], [x, x], torsion=0.0, friction=0.0),
        batch([0 * x, 0 * x], [x, y]),
        batch(points, [x, -x], torsion=1e-12),
        batch(points, [x, -x], torsion=1e6),
        batch(points, [x, -x], friction=1e-9),
        batch(points, [x, -x], friction=1e3),
        batch(points, [x, -x], origin=100.0 * y),
        batch(points, [x, -x], torque_scale=1e-6),
    ]
    found = run(joined(pairs), implementation)
    for name in FIELDS:
        assert np.isfinite(getattr(found, name)).all()
    assert (found.lower <= found.upper).all()
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_a_pair_that_is_nowhere_spoils_no_other(implementation: str) -> None:
    good = mixture(5, seed=3)
    points, normals, friction = good.points.copy(), good.normals.copy(), good.friction.copy()
    points[1, 0, 2], normals[3], friction[4] = np.nan, np.nan, np.inf
    found = pair_epsilon(
        points,
        normals,
        friction=friction,
        torsion=good.torsion,
        torque_scale=good.torque_scale,
        origin=good.origin,
        implementation=implementation,
    )
    expected = run(good, implementation)
    for name in ("lower", "upper", "direction"):
        one, other = getattr(found, name), getattr(expected, name)
        assert one[[0, 2]].tobytes() == other[[0, 2]].tobytes()
        assert np.isnan(one[[1, 3, 4]]).all()


def test_unknown_implementation() -> None:
    with pytest.raises(ValueError, match=r"numpy.*jax.*fortran"):
        run(mixture(2), "fortran")


def test_importing_the_kernel_does_not_import_jax() -> None:
    code = "import sys, gmdx_kernels.epsilon; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
