"""An interval for a mean of things that come in clusters, as grasps do by object."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import stats

from gmdx.arrays import Array, Float, Int
from gmdx.rng import generator

Method = Literal["bootstrap-t", "t", "none"]


@dataclass(frozen=True)
class Interval:
    """A mean and an interval that covers it at a nominal rate."""

    mean: float
    low: float
    high: float
    clusters: int
    method: Method  # "t": too few clusters differ to resample; "none": no spread between clusters


def clustered_mean(
    values: Float[Array, "n"],
    cluster: Int[Array, "n"],
    *,
    seed: int = 0,
    resamples: int = 2000,
    level: float = 0.95,
) -> Interval:
    """The mean of n values, with a cluster bootstrap-t interval.

    Whole clusters are drawn with replacement. What is resampled is the studentised mean
    t* = (m* - m) / se*, and the interval is [m - q_hi se, m - q_lo se] with its quantiles: the
    plain percentile interval covers too little with few clusters, this one keeps its rate.
    The standard error is that of a ratio of cluster sums, se^2 = K / (K - 1) sum_k
    (S_k - n_k m)^2 / n^2. Where resamples without any spread make a quantile infinite (values
    that differ in very few clusters), Student's t with K - 1 degrees of freedom stands in, and
    `method` says so. Without any spread between clusters there is no interval (NaN), but where
    every value is 0 it is [0, 0].

    Source: Efron and Tibshirani, "An introduction to the bootstrap", 1993, section 12.5;
    Cameron, Gelbach and Miller, "Bootstrap-based improvements for inference with clustered
    errors", 2008; the linearised error: Cochran, "Sampling techniques", 1977, section 6.

    Args:
        values: What is averaged; all finite.
        cluster: Of each value; any integers.
        seed: Of the resampling.
        resamples: How many.
        level: Nominal coverage.
    """
    if len(values) == 0:
        return Interval(np.nan, np.nan, np.nan, 0, "none")
    _, index = np.unique(cluster, return_inverse=True)
    size = np.bincount(index).astype(float)
    K, n = len(size), len(values)
    mean = float(values.mean())
    if K < 2:
        return Interval(mean, np.nan, np.nan, K, "none")
    # Sums of deviations from the mean: what is small stays exact.
    excess = np.bincount(index, values - mean)
    error = float(np.sqrt(K / (K - 1) * (excess**2).sum()) / n)
    if not values.any():
        return Interval(0.0, 0.0, 0.0, K, "bootstrap-t")
    if error <= 1e-12 * abs(mean):  # all clusters alike: no spread to tell chance from
        return Interval(mean, np.nan, np.nan, K, "none")

    drawn = generator(seed, "cluster bootstrap").multinomial(K, np.full(K, 1.0 / K), resamples)
    weights = drawn.astype(float)
    count = weights @ size
    shift = (weights @ excess) / count  # m* - m
    variance = (weights * (excess - shift[:, None] * size) ** 2).sum(axis=1)
    errors = np.sqrt(K / (K - 1) * variance) / count
    spread = errors > 1e-9 * error
    without = np.where(shift == 0.0, 0.0, np.copysign(np.inf, shift))
    t = np.where(spread, shift / np.where(spread, errors, 1.0), without)
    tail = 0.5 * (1.0 - level)
    low, high = np.quantile(t, [tail, 1.0 - tail], method="inverted_cdf")
    method: Method = "bootstrap-t"
    if not (np.isfinite(low) and np.isfinite(high)):
        high = float(stats.t.ppf(1.0 - tail, K - 1))
        low, method = -high, "t"
    return Interval(mean, float(mean - high * error), float(mean - low * error), K, method)
