"""The approximations that `gmdx bench epsilon` compares, against geometry done by hand."""

import itertools
import json

import numpy as np
import pytest
from scipy.optimize import linprog

from gmdx.cli.main import main
from gmdx.errors import ConfigError, MetricError
from gmdx.metrics.epsilon.certified import epsilon
from gmdx.studies.epsilon.approximations import (
    linearised_epsilon,
    random_direction_bound,
    sampled_epsilon,
)
from gmdx.studies.epsilon.contacts import GraspSet, random_pairs, random_patches
from gmdx.studies.epsilon.methods import (
    EpsilonStudyConfig,
    MethodFigures,
    epsilon_figures,
)

SETTINGS = {"friction": 0.8, "torsion": 0.004, "torque_scale": 0.05, "origin": np.zeros(3)}


def three_hard_fingers(r: float) -> tuple[np.ndarray, np.ndarray]:
    """Three contacts at 120 degrees on a circle of radius r, facing its centre."""
    turn = 2 * np.pi * np.arange(3) / 3
    out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    return r * out, -out


def ball_by_enumeration(wrenches: np.ndarray) -> float:
    """Largest ball about 0 in the hull: every hyperplane through six points, tried."""
    radius = np.inf
    for six in itertools.combinations(wrenches, 6):
        matrix = np.asarray(six)
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        normal = np.linalg.solve(matrix, np.ones(6))
        if (wrenches @ normal).max() <= 1 + 1e-9:
            radius = min(radius, 1 / np.linalg.norm(normal))
    return radius


def reach(wrenches: np.ndarray, direction: np.ndarray) -> float:
    """The largest t with t * direction in the hull, by linear programming."""
    m = len(wrenches)
    found = linprog(
        np.r_[np.zeros(m), -1.0],
        A_eq=np.block([[wrenches.T, -direction[:, None]], [np.ones((1, m)), np.zeros((1, 1))]]),
        b_eq=np.r_[np.zeros(6), 1.0],
    )
    return float(found.x[-1])


@pytest.mark.parametrize("index", range(4))
def test_hull_of_few_edges_is_what_enumeration_finds(index: int) -> None:
    pairs = random_pairs(4, seed=3)
    found = linearised_epsilon(
        pairs.points[index], pairs.normals[index], **pairs.parameters, edges=4
    )
    assert found.vertices.shape == (12, 6)
    assert found.value > 0
    assert found.value == pytest.approx(ball_by_enumeration(found.vertices), rel=1e-6)


@pytest.mark.parametrize("count", [2, 8])
def test_no_direction_of_a_hull_reaches_less_far_than_its_ball(count: int) -> None:
    grasps = random_patches(1, contacts=count, seed=1) if count > 2 else random_pairs(1, seed=1)
    found = linearised_epsilon(grasps.points[0], grasps.normals[0], **grasps.parameters, edges=8)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(40, 6)) * [1, 1, 1, 4, 4, 4]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert found.value > 0
    assert min(reach(found.vertices, d) for d in directions) >= found.value * (1 - 1e-6)


@pytest.mark.parametrize("gamma", [0.0004, 0.004, 0.04])
def test_bipyramids_of_an_aligned_pair_have_their_closed_form(gamma: float) -> None:
    """With edges along y and z, h(u) <= 1 is a polytope whose farthest vertex is known.

    With a = r / L and g = gamma / L: s u_1 + max(g |u_4|, mu |u_2 - s a u_6|, mu |u_3 + s a u_5|)
    <= 1 for s = 1 and -1. For given u_1 the farthest corner is convex in |u_1|, so at 0 or 1.
    """
    r, scale, mu = 0.04, 0.05, 0.8
    points = np.array([[-r, 0, 0], [r, 0, 0]])
    normals = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    options = {"friction": mu, "torsion": gamma, "torque_scale": scale, "origin": np.zeros(3)}
    found = linearised_epsilon(points, normals, **options, edges=4)
    a, g = r / scale, gamma / scale
    farthest = max(
        g**-2 + 2 * max(1, a**-2) / mu**2,
        1 + 2 * (1 + a**-2) / mu**2,
    )
    assert found.value == pytest.approx(farthest**-0.5, rel=1e-6)
    assert epsilon(points, normals, **options).lower > found.value


def test_error_falls_with_edges_where_there_is_no_torsion() -> None:
    r, mu, scale = 0.04, 0.8, 0.1
    points, normals = three_hard_fingers(r)
    exact = (1 + (scale / r) ** 2 * (3 / mu**2 - 1)) ** -0.5  # closed form F
    values = [
        linearised_epsilon(
            points, normals, friction=mu, torsion=0.0, torque_scale=scale, origin=np.zeros(3),
            edges=edges,
        ).value
        for edges in (4, 8, 16, 32)
    ]  # fmt: skip
    assert exact == pytest.approx(0.203925097, rel=1e-8)
    assert np.all(np.diff(values) >= -1e-8)  # each polygon holds the one before
    errors = 1 - np.array(values) / exact
    assert errors.min() > -1e-6
    assert errors[-1] < 0.02
    assert errors[-1] < 0.2 * errors[0]


@pytest.mark.parametrize("index", range(6))
def test_hulls_of_wrenches_are_below_and_directions_above(index: int) -> None:
    pairs = random_pairs(6, seed=5)
    p, n, options = pairs.points[index], pairs.normals[index], pairs.parameters
    exact = epsilon(p, n, **options)
    for edges in (3, 8, 12):
        assert linearised_epsilon(p, n, **options, edges=edges).value <= exact.upper + 1e-7
    for samples in (8, 16, 24):
        assert sampled_epsilon(p, n, **options, samples=samples).value <= exact.upper + 1e-7
    above = random_direction_bound(p, n, **options, directions=5000)
    assert above.value >= exact.lower
    assert np.linalg.norm(above.direction) == pytest.approx(1)


def test_free_torsion_can_exceed_what_the_contacts_exert() -> None:
    pairs = random_pairs(60, seed=0)
    excess = [
        linearised_epsilon(p, n, **pairs.parameters, edges=16, free_torsion=True).value
        / epsilon(p, n, **pairs.parameters).upper
        for p, n in zip(pairs.points, pairs.normals, strict=True)
    ]
    assert max(excess) > 1.001


def test_without_closure_a_hull_is_worth_nothing() -> None:
    points = np.array([[-0.02, 0, 0], [0.02, 0, 0]])
    away = np.array([[0.0, 0, 1], [0, 0, 1.0]])
    assert linearised_epsilon(points, away, **SETTINGS).value == 0
    assert sampled_epsilon(points, away, **SETTINGS).value == 0


def test_bad_counts_are_named() -> None:
    pair = random_pairs(1)
    p, n = pair.points[0], pair.normals[0]
    with pytest.raises(MetricError, match="edges must be at least 3, not 2"):
        linearised_epsilon(p, n, **SETTINGS, edges=2)
    with pytest.raises(MetricError, match="samples must be at least 4, not 3"):
        sampled_epsilon(p, n, **SETTINGS, samples=3)
    with pytest.raises(MetricError, match="directions must be at least 1"):
        random_direction_bound(p, n, **SETTINGS, directions=0)
    with pytest.raises(MetricError, match="friction"):
        linearised_epsilon(p, n, **{**SETTINGS, "friction": -1.0})
    with pytest.raises(ConfigError, match="even number of contacts"):
        random_patches(1, contacts=3)
    with pytest.raises(ConfigError, match="1 grasp or more"):
        EpsilonStudyConfig(pairs=0)


@pytest.mark.parametrize("make", [random_pairs, random_patches])
def test_grasps_are_seeded_and_hold(make: object) -> None:
    few, more = make(5, seed=2), make(8, seed=2)  # type: ignore[operator]
    assert isinstance(few, GraspSet)
    assert np.array_equal(few.points, more.points[:5])
    assert np.array_equal(more.first(5).normals, few.normals)
    assert not np.array_equal(few.points, make(5, seed=3).points)  # type: ignore[operator]
    assert np.linalg.norm(few.normals, axis=-1) == pytest.approx(1)
    held = [
        epsilon(p, n, **few.parameters, rtol=1e-2).closure
        for p, n in zip(few.points, few.normals, strict=True)
    ]
    assert all(held)


def test_limits_are_kept_or_not() -> None:
    row = MethodFigures("m", 2, 1, 4.0, 0.0, 0.0, proved=False, limit=5.0)
    assert row.within is True
    assert row.per_second == 250
    assert MethodFigures("m", 2, 1, 6.0, 0.0, 0.0, proved=False, limit=5.0).within is False
    assert MethodFigures("m", 2, 1, 6.0, 0.0, 0.0, proved=False).within is None


def test_every_method_is_measured_on_what_it_gets() -> None:
    figures = epsilon_figures(EpsilonStudyConfig(pairs=3, patches=2))
    assert {row.contacts: row.grasps for row in figures.methods} == {2: 3, 8: 2}
    for row in figures.methods:
        assert row.milliseconds > 0
        if row.method.startswith("bulk kernel"):
            assert abs(row.error_worst) < (1e-4 if row.proved else 1e-6)
            assert row.limit == (None if row.proved else 0.3)
            assert row.first_call_seconds is not None
        if row.method == "certified to 1e-4":
            assert 0 <= row.error_median <= row.error_worst <= 1e-4
        if row.method == "certified to 1 %":
            assert row.error_worst <= 1e-2
        if row.method.startswith(("linearised", "limit surface")):
            assert -1 <= row.error_worst <= row.error_median < 1e-3
        if "random" in row.method:
            assert row.error_median > 0
    assert sum(row.method.startswith("bulk kernel") for row in figures.methods) == 4


def test_the_command_prints_a_table_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "epsilon", "--grasps", "2"]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 100
    for word in ("ms a", "error %", "certified to 1e-4", "linearised cones, 64 edges", "0.3: "):
        assert word in printed
    assert main(["bench", "epsilon", "--grasps", "2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["friction"] == 0.8
    (pair,) = [m for m in found["methods"] if m["limit"] == 10.0]
    assert pair["per_second"] == pytest.approx(1e3 / pair["milliseconds"])
    assert pair["within"] == (pair["milliseconds"] <= 10.0)
    assert main(["bench", "epsilon", "--grasps", "0"]) == 2
