"""Comparisons of runs on synthetic pairs whose truth is known."""

import numpy as np
import pytest
from scipy import stats
from sklearn.metrics import cohen_kappa_score

from gmdx.metrics.table import COMPARED
from gmdx.rng import generator
from gmdx.statistics.clustered import clustered_mean
from gmdx.studies.bias.compare import Comparison, compare, most_disputed
from gmdx.studies.bias.replay import RunRows
from gmdx.trials.outcome import Outcome

OBJECTS = tuple(f"object{k}" for k in range(12))
INDEX = np.repeat(np.arange(12), 10)
TRIALS = 5


def _run(outcomes: np.ndarray, **values: np.ndarray) -> RunRows:
    n = len(outcomes)
    share = (outcomes == Outcome.SUCCESS).mean(axis=1)
    filled = {m.name: np.zeros(n) for m in COMPARED} | {"sim_success": share} | values
    return RunRows(
        values=filled,
        outcomes=outcomes,
        lower_bound=np.zeros(n, bool),
        poses=np.zeros((n, 4, 7)),
        tool=np.zeros((n, 4, 3)),
        present=np.ones(n, bool),
    )


def _compare(first: RunRows, second: RunRows, **options: object) -> Comparison:
    given = {"thresholds": (0.6, 0.8, 1.0), "seed": 0, "resamples": 300} | options
    return compare(first, second, OBJECTS, INDEX, name="b", labels=("one", "two"), **given)  # type: ignore[arg-type]


def _planted(draw: int, bias: float) -> tuple[RunRows, RunRows]:
    """Forces that differ by `bias`, by an effect of the object and by noise."""
    rng = generator(3, "planted", draw)
    force = rng.gamma(4.0, 5.0, len(INDEX))
    other = force + bias + rng.normal(0, 1.0, 12)[INDEX] + rng.normal(0, 2.0, len(INDEX))
    ended = rng.integers(0, 3, (len(INDEX), TRIALS))
    return _run(ended, force=force), _run(ended, force=other)


def test_interval_resamples_objects() -> None:
    first, second = _planted(0, 0.7)
    difference = second.values["force"] - first.values["force"]
    expected = clustered_mean(difference, INDEX, seed=4, resamples=300)
    found = _compare(first, second, seed=4).metric("force").difference
    assert found == expected
    assert found.clusters == 12
    assert found.low < 0.7 < found.high


def test_planted_shift_is_found_in_every_statistic() -> None:
    first, _ = _planted(0, 0.0)
    second = _run(first.outcomes, force=first.values["force"] + 2.0)
    found = _compare(first, second).metric("force")
    assert found.difference.mean == pytest.approx(2.0)
    assert (found.low, found.high, found.rms) == pytest.approx((2.0, 2.0, 2.0))
    assert found.limits.spread == pytest.approx(0.0, abs=1e-12)
    assert found.changed == 1.0
    assert found.spearman == pytest.approx(1.0)
    assert found.kendall == pytest.approx(1.0)
    assert found.ks == pytest.approx(
        stats.ks_2samp(first.values["force"], second.values["force"]).statistic
    )
    by_object = _compare(first, second).objects
    assert [one.object_id for one in by_object] == list(OBJECTS)
    for one in by_object:
        force = next(m for m in one.metrics if m.metric == "force")
        assert force.difference.mean == pytest.approx(2.0)
        assert force.pairs == 10


def test_outcomes_and_flips_are_counted() -> None:
    rng = generator(5, "outcomes")
    ended = rng.integers(0, 5, (len(INDEX), TRIALS))
    other = np.where(rng.random(ended.shape) < 0.8, ended, rng.integers(0, 5, ended.shape))
    first, second = _run(ended), _run(other)
    found = _compare(first, second)
    assert found.outcomes.trials.agreement == pytest.approx((ended == other).mean())
    assert found.outcomes.trials.kappa == pytest.approx(
        cohen_kappa_score(ended.ravel(), other.ravel())
    )
    won, won_other = ended == Outcome.SUCCESS, other == Outcome.SUCCESS
    assert found.outcomes.success_difference.mean == pytest.approx(won_other.mean() - won.mean())
    assert found.outcomes.mcnemar.only_first == int((won[:, 0] & ~won_other[:, 0]).sum())
    for flips, least in zip(found.flips, (3, 4, 5), strict=True):
        yes, yes_other = won.sum(axis=1) >= least, won_other.sum(axis=1) >= least
        assert (flips.positive_first, flips.positive_second) == (yes.sum(), yes_other.sum())
        assert flips.lost == (yes & ~yes_other).sum()
        assert flips.gained == (~yes & yes_other).sum()
        assert flips.flipped.mean == pytest.approx((yes != yes_other).mean())


def test_diverged_trials_are_no_failures_of_a_grasp() -> None:
    ended = np.zeros((len(INDEX), TRIALS), int)
    other = ended.copy()
    other[:, 1] = Outcome.DIVERGED
    found = _compare(_run(ended), _run(other))
    assert found.outcomes.trials.agreement == pytest.approx(0.8)
    assert found.outcomes.success.agreement == 1.0
    assert found.outcomes.success_difference.mean == 0.0


def test_what_exists_in_one_run_alone_is_counted_and_left_out() -> None:
    first, second = _planted(1, 0.0)
    first.values["force"][:5] = np.nan
    second.values["force"][3:9] = np.nan
    found = _compare(first, second).metric("force")
    assert (found.only_first, found.only_second, found.pairs) == (4, 3, len(INDEX) - 9)


def test_most_disputed_come_first() -> None:
    ended = np.zeros((len(INDEX), TRIALS), int)
    other = ended.copy()
    other[7] = Outcome.LOST_IN_LIFT  # all trials
    other[3, 1:3] = Outcome.KNOCKED_AWAY  # two perturbed ones
    other[5, :2] = Outcome.KNOCKED_AWAY  # two, the nominal one among them
    assert most_disputed(_run(ended), _run(other), 10) == [7, 5, 3]
    assert most_disputed(_run(ended), _run(other), 1) == [7]
