"""Designs and indices, through the code that the studies use, on functions with known answers."""

import itertools
import subprocess
import sys
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from gmdx.errors import UsageError
from gmdx.studies.sensitivity.indices import LEVELS, METHODS, Indices, indices, make_design

Function = Callable[[np.ndarray], np.ndarray]


def ishigami(u: np.ndarray) -> np.ndarray:
    """On [-pi, pi]^3, with a = 7 and b = 0.1."""
    x = np.pi * (2 * u - 1)
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def study(method: str, function: Function, names: Sequence[str], runs: int) -> Indices:
    design = make_design(method, names, runs=runs, seed=3)
    assert len(design) <= runs
    assert design.places.min() >= 0
    assert design.places.max() <= 1
    return indices(design, function(design.places), seed=3)


def test_sobol_finds_the_indices_of_ishigami() -> None:
    # Ishigami and Homma (1990): the variance's parts have closed forms.
    a, b, pi = 7.0, 0.1, np.pi
    first = np.array([0.5 * (1 + b * pi**4 / 5) ** 2, a**2 / 8, 0.0])
    cross = b**2 * pi**8 * (1 / 18 - 1 / 50)
    variance = first.sum() + cross
    total = first + np.array([cross, 0.0, cross])
    found = study("sobol", ishigami, "xyz", 5 * 2048)
    assert found.blocks == 2048
    assert np.all(np.abs(found.main - first / variance) < found.main_half + 0.02)
    assert np.all(np.abs(found.total - total / variance) < found.total_half + 0.02)
    assert np.all(found.main_half < 0.1)


def test_sobol_shares_of_a_linear_function_are_squares() -> None:
    slopes = np.array([3.0, -2.0, 1.0, 0.0])
    found = study("sobol", lambda u: u @ slopes, "abcd", 6 * 1024)
    shares = slopes**2 / (slopes**2).sum()
    np.testing.assert_allclose(found.total, shares, atol=0.03)
    np.testing.assert_allclose(found.main, shares, atol=0.05)


def test_morris_effects_of_a_linear_function_are_its_slopes() -> None:
    slopes = np.array([3.0, -2.0, 1.0, 0.0])
    found = study("morris", lambda u: 5 + u @ slopes, "abcd", 50)
    assert found.blocks == 10
    np.testing.assert_allclose(found.main, slopes, atol=1e-12)
    np.testing.assert_allclose(found.total, np.abs(slopes), atol=1e-12)
    np.testing.assert_allclose(found.spread, 0, atol=1e-12)
    np.testing.assert_allclose(found.total_half, 0, atol=1e-12)


def test_morris_agrees_with_all_effects_on_its_grid() -> None:
    found = study("morris", ishigami, "xyz", 4 * 400)
    step = LEVELS / (2 * (LEVELS - 1))
    grid = np.array(list(itertools.product(np.linspace(0, 1, LEVELS), repeat=3)))
    for k in range(3):
        start = grid[grid[:, k] + step <= 1 + 1e-9]
        end = start.copy()
        end[:, k] += step
        effects = (ishigami(end) - ishigami(start)) / step
        half = 1.5 * found.total_half[k] + 1e-9
        assert abs(found.total[k] - np.abs(effects).mean()) <= half
        assert abs(found.main[k] - effects.mean()) <= 4 * effects.std() / 20 + 1e-9


@pytest.mark.parametrize("method", ["morris", "sobol"])
def test_interval_of_what_does_nothing_covers_zero(method: str) -> None:
    found = study(method, ishigami, ["x", "y", "z", "dummy"], 64 * 6)
    assert abs(found.main[3]) <= np.nan_to_num(found.main_half[3]) + 1e-12
    assert found.total[3] <= found.total_half[3] + 1e-12
    assert found.above("dummy") == (True, True, True, False)


def test_chance_gets_its_share_and_is_drawn_anew_in_every_block() -> None:
    loud = 0.5

    def noisy(u: np.ndarray) -> np.ndarray:
        chance = np.modf(np.sin(1e4 * np.floor(u[:, 1] * 2**20)) * 43758.5453)[0] % 1.0
        return u[:, 0] + loud * chance

    design = make_design("sobol", ["x", "seed"], runs=4 * 2048, seed=1, shifted=("seed",))
    found = indices(design, noisy(design.places))
    assert found.total[1] == pytest.approx(loud**2 / (1 + loud**2), abs=0.04)
    assert found.total[0] == pytest.approx(1 / (1 + loud**2), abs=0.04)
    morris = make_design("morris", ["x", "seed"], runs=3 * 50, shifted=("seed",))
    assert len(np.unique(morris.places[:, 0])) == LEVELS
    assert len(np.unique(morris.places[:, 1])) == 2 * 50  # before and after its one move


@pytest.mark.parametrize(("method", "size"), [("morris", 4), ("sobol", 5)])
def test_blocks_with_missing_values_are_left_out_and_counted(method: str, size: int) -> None:
    slopes = np.array([3.0, -2.0, 1.0])
    design = make_design(method, "abc", runs=size * 16)
    values = design.places @ slopes
    whole = indices(design, values)
    holes = values.copy()
    holes[[0, 1, 2 * size]] = np.nan
    found = indices(design, holes)
    assert (found.blocks, found.blocks_left_out) == (14, 2)
    kept = ~np.isin(design.block, [0, 2])
    # The rest counts as if it had been the whole design: wild values in the two change nothing.
    wild = np.where(kept, values, np.nan)
    np.testing.assert_array_equal(indices(design, wild).total, found.total)
    if method == "morris":
        np.testing.assert_allclose(found.total, whole.total)
    holes[:] = np.nan
    nothing = indices(design, holes)
    assert nothing.blocks == 0
    assert np.isnan(nothing.total).all()
    assert not any(nothing.above("a"))


def test_constant_output_has_no_variance_to_share() -> None:
    for method in ("morris", "sobol"):
        design = make_design(method, "abc", runs=200)
        found = indices(design, np.ones(len(design)))
        assert found.constant
        expected = 0.0 if method == "morris" else np.nan
        np.testing.assert_array_equal(found.total, expected)


def test_one_at_a_time_leaves_the_rest_and_takes_every_level_once() -> None:
    design = make_design("oat", "ab", runs=10, levels=[0, 3])
    assert len(design) == 5 + 3
    assert np.all(np.isnan(design.places).sum(axis=1) == 1)
    np.testing.assert_allclose(design.places[:5, 0], np.linspace(0, 1, 5))
    np.testing.assert_allclose(design.places[5:, 1], [1 / 6, 0.5, 5 / 6])
    values = np.where(np.isnan(design.places[:, 0]), 7.0, (design.places[:, 0] - 0.25) ** 2)
    found = indices(design, values)
    np.testing.assert_allclose(found.main, [0.75**2 - 0.25**2, 0.0])
    np.testing.assert_allclose(found.total, [0.75**2, 0.0])


def test_design_and_bootstrap_depend_on_the_seed_alone() -> None:
    for method in ("morris", "sobol"):
        one, same, other = (make_design(method, "abc", runs=80, seed=s) for s in (0, 0, 1))
        np.testing.assert_array_equal(one.places, same.places)
        assert not np.array_equal(one.places, other.places)
        values = ishigami(one.places)
        np.testing.assert_array_equal(
            indices(one, values, seed=0).total_half, indices(one, values, seed=0).total_half
        )


def test_small_budgets_and_unknown_methods_are_refused_by_name() -> None:
    for method, least in (("morris", 8), ("sobol", 80), ("oat", 6)):
        assert len(make_design(method, "abc", runs=least)) <= least
        with pytest.raises(UsageError, match=f"needs {least} at least"):
            make_design(method, "abc", runs=least - 1)
    with pytest.raises(UsageError, match=f"give one of {', '.join(METHODS)}"):
        make_design("fast", "abc")


def test_without_salib_one_line_says_what_to_install() -> None:
    code = (
        "import sys; sys.modules['SALib'] = None\n"
        "from gmdx.studies.sensitivity.indices import make_design\n"
        "make_design('oat', 'abc')\n"
        "make_design('morris', 'abc')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("gmdx.errors.UsageError: morris and sobol need SALib")
    assert last.endswith("pip install 'gmdx[sensitivity]'")
