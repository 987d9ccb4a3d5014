"""Statistics of agreement against scikit-learn, SciPy and statsmodels, and a planted bias."""

import numpy as np
import pytest
from scipy import stats
from sklearn.metrics import cohen_kappa_score, confusion_matrix, matthews_corrcoef
from statsmodels.regression.mixed_linear_model import MixedLM
from statsmodels.stats.contingency_tables import mcnemar as reference_mcnemar

from gmdx.rng import generator
from gmdx.statistics.agreement import (
    kendall,
    ks_distance,
    label_agreement,
    limits_of_agreement,
    mcnemar,
    spearman,
)
from gmdx.statistics.clustered import clustered_mean


def _labels(seed: int, classes: int) -> tuple[np.ndarray, np.ndarray]:
    rng = generator(seed, "labels", classes)
    first = rng.integers(0, classes, 300)
    second = np.where(rng.random(300) < 0.7, first, rng.integers(0, classes, 300))
    return first, second


@pytest.mark.parametrize("classes", [2, 3, 6])
@pytest.mark.parametrize("seed", range(4))
def test_labels_agree_with_scikit_learn(seed: int, classes: int) -> None:
    first, second = _labels(seed, classes)
    found = label_agreement(first, second, classes=classes)
    np.testing.assert_array_equal(found.counts, confusion_matrix(first, second))
    assert found.pairs == 300
    assert found.agreement == pytest.approx(np.mean(first == second))
    assert found.kappa == pytest.approx(cohen_kappa_score(first, second))
    assert found.matthews == pytest.approx(matthews_corrcoef(first, second))


def test_labels_of_one_class_have_no_correlation() -> None:
    same = label_agreement(np.zeros(5, int), np.zeros(5, int), classes=2)
    assert same.agreement == 1.0
    assert np.isnan(same.kappa)
    assert np.isnan(same.matthews)
    none = label_agreement(np.zeros(0, int), np.zeros(0, int), classes=2)
    assert np.isnan(none.agreement)


@pytest.mark.parametrize("seed", range(6))
def test_mcnemar_agrees_with_statsmodels(seed: int) -> None:
    rng = generator(seed, "mcnemar")
    first = rng.random(60) < 0.5
    second = np.where(rng.random(60) < 0.6, first, rng.random(60) < 0.7)
    found = mcnemar(first, second)
    table = confusion_matrix(first, second)
    assert found.p_value == pytest.approx(reference_mcnemar(table, exact=True).pvalue)
    assert (found.only_first, found.only_second) == (table[1, 0], table[0, 1])


def test_mcnemar_of_equal_labels_finds_nothing() -> None:
    assert mcnemar(np.array([True, False]), np.array([True, False])).p_value == 1.0


@pytest.mark.parametrize("seed", range(4))
def test_correlations_and_distance_agree_with_scipy(seed: int) -> None:
    rng = generator(seed, "numbers")
    first = np.round(rng.normal(size=80), 1)  # with ties
    second = np.round(first + 0.5 * rng.normal(size=80), 1)
    assert spearman(first, second) == pytest.approx(
        np.corrcoef(stats.rankdata(first), stats.rankdata(second))[0, 1]
    )
    # tau-b by counting pairs
    i, j = np.triu_indices(80, 1)
    a, b = np.sign(first[i] - first[j]), np.sign(second[i] - second[j])
    tau = (a * b).sum() / np.sqrt((a != 0).sum() * (b != 0).sum())
    assert kendall(first, second) == pytest.approx(tau)
    assert ks_distance(first, second[:50]) == pytest.approx(
        stats.ks_2samp(first, second[:50]).statistic
    )


def test_constant_numbers_have_no_rank_correlation() -> None:
    assert np.isnan(spearman(np.ones(4), np.arange(4.0)))
    assert np.isnan(kendall(np.arange(4.0), np.ones(4)))
    assert ks_distance(np.zeros(3), np.ones(4)) == 1.0


def test_limits_of_independent_differences_are_bland_and_altman_s() -> None:
    values = generator(1, "limits").normal(0.3, 2.0, 50)
    found = limits_of_agreement(values, np.arange(50))
    assert found.spread == pytest.approx(values.std(ddof=1))
    assert found.upper - values.mean() == pytest.approx(1.959964 * values.std(ddof=1), rel=1e-6)
    assert values.mean() - found.lower == pytest.approx(found.upper - values.mean())


def test_limits_of_clustered_differences_are_those_of_a_mixed_model() -> None:
    rng = generator(2, "clusters")
    cluster = np.repeat(np.arange(20), 10)
    values = rng.normal(0, 1.5, 20)[cluster] + rng.normal(0, 1.0, 200)
    fit = MixedLM(values, np.ones(200), groups=cluster).fit(reml=True)
    variance = float(fit.cov_re[0, 0] + fit.scale)
    assert limits_of_agreement(values, cluster).spread == pytest.approx(variance**0.5, rel=1e-3)


def _clustered(seed: int, draw: int, clusters: int) -> tuple[np.ndarray, np.ndarray]:
    """Differences with a planted mean of 0.2: unequal clusters, skewed effects of each."""
    rng = generator(seed, "planted", draw, clusters)
    size = rng.integers(4, 17, clusters)
    cluster = np.repeat(np.arange(clusters), size)
    effect = rng.gamma(2.0, 0.5, clusters) - 1.0
    return 0.2 + effect[cluster] + rng.normal(0.0, 1.0, len(cluster)), cluster


@pytest.mark.parametrize(("clusters", "draws"), [(40, 400), (12, 400)])
def test_interval_covers_a_planted_bias_at_its_nominal_rate(clusters: int, draws: int) -> None:
    covered = 0
    for draw in range(draws):
        values, cluster = _clustered(7, draw, clusters)
        found = clustered_mean(values, cluster, seed=draw, resamples=600)
        assert found.method == "bootstrap-t"
        covered += found.low <= 0.2 <= found.high
    low, high = stats.binom.ppf([0.001, 0.999], draws, 0.95)
    assert low <= covered <= high


def test_interval_that_ignores_clusters_covers_too_little() -> None:
    covered = 0
    for draw in range(200):
        values, _ = _clustered(7, draw, 40)
        found = clustered_mean(values, np.arange(len(values)), seed=draw, resamples=300)
        covered += found.low <= 0.2 <= found.high
    assert covered < stats.binom.ppf(0.001, 200, 0.95)


def test_clusters_that_are_all_alike_tell_nothing_of_chance() -> None:
    found = clustered_mean(np.full(12, 0.25), np.repeat(np.arange(3), 4))
    assert (found.mean, found.method) == (0.25, "none")
    assert np.isnan([found.low, found.high]).all()


def test_interval_of_no_difference_is_a_point() -> None:
    found = clustered_mean(np.zeros(12), np.repeat(np.arange(3), 4))
    assert (found.mean, found.low, found.high) == (0.0, 0.0, 0.0)


def test_interval_of_a_difference_in_one_cluster_is_student_s() -> None:
    values = np.zeros(40)
    values[:4] = 1.0
    found = clustered_mean(values, np.repeat(np.arange(10), 4))
    assert found.method == "t"
    sums = np.array([1.0] + [0.0] * 9)  # means of equal clusters: the textbook interval
    half = stats.t.ppf(0.975, 9) * sums.std(ddof=1) / np.sqrt(10)
    assert found.high - found.mean == pytest.approx(half)


def test_interval_of_one_cluster_does_not_exist() -> None:
    found = clustered_mean(np.arange(4.0), np.zeros(4, int))
    assert found.method == "none"
    assert np.isnan(found.low)
