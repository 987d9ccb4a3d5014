"""How far two raters of the same things agree: statistics of paired labels and numbers.

Pure functions on arrays, each with its formula and source. A statistic that does not exist
(one class only, constant values, too few pairs) is NaN. Intervals are in `clustered`.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from gmdx.arrays import Array, Bool, Float, Int


@dataclass(frozen=True)
class LabelAgreement:
    """Agreement of two raters over n things, each put into one of k classes."""

    counts: Int[Array, "k k"]  # rows: the first rater's class, columns: the second's
    agreement: float  # share of equal labels
    kappa: float  # Cohen's: agreement beyond that of two raters with these shares by chance
    matthews: float  # correlation of the two labellings

    @property
    def pairs(self) -> int:
        """Number of things."""
        return int(self.counts.sum())


@dataclass(frozen=True)
class McNemar:
    """McNemar's exact test of two paired yes-no labels."""

    only_first: int  # yes by the first rater alone
    only_second: int  # yes by the second alone
    p_value: float  # two-sided, of "both say yes equally often"


@dataclass(frozen=True)
class Limits:
    """Limits of agreement: between them lie 95 % of normal differences."""

    spread: float  # standard deviation of a difference
    lower: float
    upper: float


def confusion(first: Int[Array, "n"], second: Int[Array, "n"], *, classes: int) -> Array:
    """How often the raters gave each pair of classes: (k, k) counts, rows are the first's."""
    counts = np.zeros((classes, classes), np.int64)
    np.add.at(counts, (first, second), 1)
    return counts


def label_agreement(
    first: Int[Array, "n"], second: Int[Array, "n"], *, classes: int
) -> LabelAgreement:
    """Confusion matrix, agreement, kappa and Matthews correlation of two labellings."""
    counts = confusion(first, second, classes=classes)
    total = int(counts.sum())
    return LabelAgreement(
        counts=counts,
        agreement=float(np.trace(counts) / total) if total else np.nan,
        kappa=cohen_kappa(counts),
        matthews=matthews(counts),
    )


def cohen_kappa(counts: Int[Array, "k k"]) -> float:
    """Agreement beyond chance: (p_o - p_e) / (1 - p_e).

    p_o is the share of equal labels, p_e what two independent raters with the same shares of
    classes would reach. NaN where chance alone agrees always.

    Source: Cohen, "A coefficient of agreement for nominal scales", 1960.
    """
    total = int(counts.sum())
    if total == 0:
        return np.nan
    observed = np.trace(counts) / total
    chance = float((counts.sum(axis=1) / total * (counts.sum(axis=0) / total)).sum())
    return float((observed - chance) / (1.0 - chance)) if chance < 1.0 else np.nan


def matthews(counts: Int[Array, "k k"]) -> float:
    """Correlation of two labellings, for two classes Matthews' coefficient (phi).

    (c s - sum_k p_k t_k) / sqrt((s^2 - sum p_k^2) (s^2 - sum t_k^2)), with s pairs, c of them
    equal, and p_k, t_k how often each rater used class k. NaN where a rater used one class only.

    Source: Gorodkin, "Comparing two K-category assignments by a K-category correlation
    coefficient", 2004; Matthews 1975.
    """
    s, c = float(counts.sum()), float(np.trace(counts))
    p, t = counts.sum(axis=0).astype(float), counts.sum(axis=1).astype(float)
    scale = (s**2 - (p**2).sum()) * (s**2 - (t**2).sum())
    return float((c * s - (p * t).sum()) / np.sqrt(scale)) if scale > 0 else np.nan


def mcnemar(first: Bool[Array, "n"], second: Bool[Array, "n"]) -> McNemar:
    """Exact test whether two raters say yes equally often.

    Of the b + c pairs in which they differ, the number with a yes of the first is binomial with
    share 1/2 under the hypothesis: p = min(1, 2 P(X <= min(b, c))). Pairs must be independent;
    trials of one object are not quite, so beside it belongs an interval clustered by object.

    Source: McNemar 1947, in its exact (binomial) form.
    """
    b, c = int((first & ~second).sum()), int((~first & second).sum())
    p_value = min(1.0, 2.0 * float(stats.binom.cdf(min(b, c), b + c, 0.5))) if b + c else 1.0
    return McNemar(only_first=b, only_second=c, p_value=p_value)


def limits_of_agreement(differences: Float[Array, "n"], cluster: Int[Array, "n"]) -> Limits:
    """Where 95 % of differences lie: mean -+ 1.96 spread.

    Differences within a cluster resemble each other, so the variance of a new one is that
    between clusters plus that within: s^2 = max(0, (MSB - MSW) / m0) + MSW, by one-way analysis
    of variance, with m0 = (n - sum n_k^2 / n) / (K - 1). With one difference a cluster, or in
    one cluster alone, it is the plain standard deviation.

    Source: Bland and Altman, "Statistical methods for assessing agreement", 1986, and
    "Agreement between methods of measurement with multiple observations per individual", 2007.
    """
    n = len(differences)
    if n < 2:
        return Limits(np.nan, np.nan, np.nan)
    mean = float(differences.mean())
    _, index = np.unique(cluster, return_inverse=True)
    size = np.bincount(index).astype(float)
    means = np.bincount(index, differences) / size
    K = len(size)
    if K in (1, n):
        variance = float(differences.var(ddof=1))
    else:
        between = float((size * (means - mean) ** 2).sum()) / (K - 1)
        within = float(((differences - means[index]) ** 2).sum()) / (n - K)
        typical = (n - float((size**2).sum()) / n) / (K - 1)
        variance = max(0.0, (between - within) / typical) + within
    spread = variance**0.5
    half = float(stats.norm.ppf(0.975)) * spread
    return Limits(spread, mean - half, mean + half)


def spearman(first: Float[Array, "n"], second: Float[Array, "n"]) -> float:
    """Correlation of the ranks, ties sharing their mean rank (Spearman 1904)."""
    if _constant(first) or _constant(second):
        return np.nan
    return float(stats.spearmanr(first, second).statistic)


def kendall(first: Float[Array, "n"], second: Float[Array, "n"]) -> float:
    """Pairs ordered alike less pairs ordered otherwise, corrected for ties: tau-b (Kendall 1945).

    (P - Q) / sqrt((P + Q + T) (P + Q + U)), with T and U pairs tied in one of the two alone.
    """
    if _constant(first) or _constant(second):
        return np.nan
    return float(stats.kendalltau(first, second, variant="b").statistic)


def ks_distance(first: Float[Array, "n"], second: Float[Array, "m"]) -> float:
    """Largest gap between two distribution functions: max_x |F(x) - G(x)|.

    Source: Smirnov 1939 (the two-sample Kolmogorov-Smirnov statistic).
    """
    if not len(first) or not len(second):
        return np.nan
    x = np.concatenate([first, second])
    below = np.searchsorted(np.sort(first), x, side="right") / len(first)
    below_second = np.searchsorted(np.sort(second), x, side="right") / len(second)
    return float(np.abs(below - below_second).max())


def _constant(values: Float[Array, "n"]) -> bool:
    return len(values) < 2 or bool((values == values[0]).all())
