"""The bulk kernel for pairs, with the certified routine for single grasps as its judge."""

from functools import lru_cache

import numpy as np
import pytest
from gmdx_kernels.epsilon import IMPLEMENTATIONS, pair_epsilon

from gmdx.metrics.epsilon.certified import epsilon
from tests.kernels.epsilon.cases import mixture, single

both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)


@lru_cache
def certified(count: int) -> np.ndarray:
    pairs = mixture(count, seed=7)
    found = [epsilon(**single(pairs, i)) for i in range(count)]
    return np.array([[e.lower, e.upper] for e in found]).T


def miss(value: np.ndarray, exact: np.ndarray) -> np.ndarray:
    return np.asarray((value - exact) / np.maximum(np.abs(exact), 1e-6))


def assert_as_certified(count: int, implementation: str) -> None:
    lower, upper = certified(count)
    found = pair_epsilon(**vars(mixture(count, seed=7)), implementation=implementation)
    # The judge's direction is itself only known to lie in its bounds: below them nothing may be.
    assert miss(found.upper, upper).max() <= 1e-6
    assert miss(found.upper, lower).min() >= -1e-7
    assert miss(found.lower, upper).max() <= 1e-7
    closed = upper > 0
    gap = (found.upper - found.lower) / np.abs(found.upper)
    assert 0.5 < closed.mean() < 0.95
    assert (gap[closed] <= 1e-4).mean() >= 0.99
    assert (found.lower[closed & (gap > 1e-4)] <= upper[closed & (gap > 1e-4)]).all()
    assert (gap[~closed & (upper < -1e-9)] <= 1e-6).mean() >= 0.99
    assert (found.upper - found.lower)[~closed].max() <= 1e-3


@both
def test_certified_values(implementation: str) -> None:
    assert_as_certified(200, implementation)


@both
@pytest.mark.slow
def test_certified_values_of_two_thousand_pairs(implementation: str) -> None:
    assert_as_certified(2000, implementation)
