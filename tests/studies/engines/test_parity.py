"""Agreement of engines with C MuJoCo: exact with itself, and known changes found as they are."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from gmdx.cli.main import main
from gmdx.errors import MetricError, UsageError
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.metrics.compute import compute_metrics
from gmdx.metrics.table import METRICS
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.scene import Scene
from gmdx.studies.engines.parity import LIMITS, Measured, compare_trials, measure, wilson
from gmdx.studies.engines.parity_result import DifferingTrial, Disagreement, ParityLimits
from gmdx.studies.engines.parity_runs import parity_figures
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import TrialResults
from gmdx.trials.run import run_trials
from tests.runs import write_meshes
from tests.support import box_object, cylinder_object, resting_scene

GRIPPER = load_gripper()
GRASPS, TRIALS = 6, 2
WARP = LIMITS["warp"]


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    box = box_object((0.03, 0.04, 0.05))
    return [
        resting_scene(box),
        resting_scene(cylinder_object(0.02, 0.05)),
        resting_scene(box, scene_id=1, yaw=0.4, seed=7),
    ]


@pytest.fixture(scope="module")
def grasps(scenes: list[Scene]) -> list[PlanarGrasp]:
    return [sample_grasps(scene, GRASPS, gripper=GRIPPER) for scene in scenes]


@pytest.fixture(scope="module")
def results(scenes: list[Scene], grasps: list[PlanarGrasp]) -> list[TrialResults]:
    return run_trials(scenes, grasps, gripper=GRIPPER, trials=TRIALS)


@pytest.fixture(scope="module")
def measured(
    scenes: list[Scene], grasps: list[PlanarGrasp], results: list[TrialResults]
) -> Measured:
    return measure(scenes, grasps, results)


def changed(measured: Measured, name: str, values: np.ndarray) -> Measured:
    return replace(measured, values={**measured.values, name: values})


def test_what_is_measured_are_the_metrics_that_trials_give(
    measured: Measured,
    scenes: list[Scene],
    grasps: list[PlanarGrasp],
    results: list[TrialResults],
) -> None:
    assert set(measured.values) == {m.name for m in METRICS if m.kind != "priori"}
    assert measured.objects == ("box", "cylinder")
    assert measured.object.tolist() == [0] * GRASPS + [1] * GRASPS + [0] * GRASPS
    assert measured.outcomes.shape == (3 * GRASPS, 2)
    table = compute_metrics(scenes[1], grasps[1], results[1])
    rows = slice(GRASPS, 2 * GRASPS)
    np.testing.assert_array_equal(measured.values["force"][rows], table["force"])
    np.testing.assert_array_equal(measured.grasp_id[rows], grasps[1].grasp_id)


def test_an_engine_agrees_with_itself_exactly(measured: Measured) -> None:
    parity = compare_trials(measured, measured, engine="mujoco", limits=WARP)
    assert parity.agreement.value == 1.0
    assert parity.agreement.low < 1.0 == parity.agreement.high
    assert parity.disagreements == ()
    assert parity.success[0] == parity.success[1] > 0
    assert {one.object_id: (one.trials, one.agreement) for one in parity.objects} == {
        "box": (4 * GRASPS, 1.0),
        "cylinder": (2 * GRASPS, 1.0),
    }
    assert all(metric.worst == metric.median == 0.0 for metric in parity.metrics)
    assert all(metric.pairs > 0 for metric in [*parity.metrics, parity.force])
    assert parity.force.worst == 0.0
    assert parity.passed is True


def test_a_second_run_of_the_reference_is_the_same(scenes: list[Scene]) -> None:
    figures = parity_figures(
        scenes[:2], engines=("mujoco",), grasps=2, gripper=GRIPPER, trials=TRIALS, threads=2
    )
    (parity,) = figures.parities
    assert parity.agreement.value == 1.0
    assert max(metric.worst for metric in parity.metrics) == 0.0
    assert parity.passed is None  # nothing to keep to
    assert figures.grasps == parity.grasps == 4
    assert parity.trials == 8


def test_a_nudge_changes_metrics_by_about_its_length(scenes: list[Scene]) -> None:
    figures = parity_figures(scenes[:2], engines=("mujoco",), grasps=4, gripper=GRIPPER)
    assert figures.floor is not None
    for name in ("real_s_offset_l", "moved"):
        assert 0 < figures.floor.metric(name).median < 10 * figures.nudge
    assert figures.floor.metric("force").worst > 0
    assert figures.as_json()["floor"]["outcomes"]["agreement"]["value"] > 0.9
    without = parity_figures(
        scenes[:1], engines=("mujoco",), grasps=1, gripper=GRIPPER, trials=TRIALS, floor=False
    )
    assert without.floor is None
    assert without.as_json()["floor"] is None


def test_flipped_outcomes_are_found_one_by_one(measured: Measured) -> None:
    reference = replace(measured, outcomes=np.full((20, 5), Outcome.SUCCESS), **rows_of(20))
    outcomes = reference.outcomes.copy()
    outcomes[0, 0] = outcomes[3, 4] = outcomes[19, 1] = Outcome.LOST_IN_LIFT
    outcomes[2, 2] = Outcome.OVERFLOWED
    parity = compare_trials(
        reference, replace(reference, outcomes=outcomes), engine="x", limits=ParityLimits(0.96)
    )
    assert parity.agreement.value == pytest.approx(0.96)
    assert parity.agrees
    assert parity.success == pytest.approx((1.0, 0.96))
    assert parity.disagreements == (
        Disagreement("success", "lost_in_lift", 3),
        Disagreement("success", "overflowed", 1),
    )
    assert parity.differing == (
        DifferingTrial("box", 0, 0, "success", "lost_in_lift"),
        DifferingTrial("box", 2, 2, "success", "overflowed"),
        DifferingTrial("box", 3, 4, "success", "lost_in_lift"),
        DifferingTrial("cylinder", 9, 1, "success", "lost_in_lift"),
    )
    assert [one.agreement for one in parity.objects] == pytest.approx([47 / 50, 49 / 50])
    assert parity.outcomes.counts[Outcome.SUCCESS, Outcome.SUCCESS] == 96
    strict = ParityLimits(0.97)
    other = replace(reference, outcomes=outcomes)
    assert compare_trials(reference, other, engine="x", limits=strict).passed is False


def rows_of(n: int) -> dict[str, object]:
    """The rest of a record of n grasps, half of each object; every metric is 1."""
    names = [metric.name for metric in METRICS if metric.kind != "priori"]
    return {
        "object": np.repeat([0, 1], n // 2),
        "grasp_id": np.tile(np.arange(n // 2), 2),
        "values": {name: np.ones(n) for name in names},
        "force_is_lower_bound": np.zeros(n, bool),
    }


def test_a_shift_of_all_is_the_median_and_a_shift_of_one_the_largest(measured: Measured) -> None:
    moved = measured.values["moved"]
    parity = compare_trials(
        measured, changed(measured, "moved", moved - 3e-4), engine="x", limits=WARP
    )
    found = parity.metric("moved")
    assert (found.median, found.p95, found.worst) == pytest.approx((3e-4,) * 3)
    assert (found.unit, found.limit, found.within) == ("m", 1e-4, False)
    assert parity.passed is False
    assert all(row.worst == 0.0 for row in parity.metrics if row.metric != "moved")

    one = moved.copy()
    one[np.flatnonzero(np.isfinite(moved))[2]] += 0.01
    parity = compare_trials(measured, changed(measured, "moved", one), engine="x", limits=WARP)
    found = parity.metric("moved")
    assert found.worst == pytest.approx(0.01)
    assert found.median == 0.0
    assert found.within
    assert parity.passed


@pytest.mark.parametrize(("name", "limit"), [("clo_ori_comfort", 1e-3), ("g_offset_a", 1e-3)])
def test_angles_have_their_own_limit(name: str, limit: float, measured: Measured) -> None:
    for shift, within in ((0.9 * limit, True), (1.1 * limit, False)):
        other = changed(measured, name, measured.values[name] + shift)
        found = compare_trials(measured, other, engine="x", limits=WARP).metric(name)
        assert (found.limit, found.within) == (limit, within)


def test_what_one_engine_lacks_is_counted_and_not_compared(measured: Measured) -> None:
    opening = measured.values["sim_width"]
    has = np.flatnonzero(np.isfinite(opening))
    less = opening.copy()
    less[has[:2]] = np.nan
    found = compare_trials(measured, changed(measured, "sim_width", less), engine="x").metric(
        "sim_width"
    )
    assert (found.pairs, found.only_reference, found.only_other) == (len(has) - 2, 2, 0)
    none = np.full(len(opening), np.nan)
    found = compare_trials(
        changed(measured, "sim_width", none), measured, engine="x", limits=WARP
    ).metric("sim_width")
    assert (found.pairs, found.only_other) == (0, len(has))
    assert np.isnan(found.median)
    assert found.within is False  # nothing was shown


def test_push_out_forces_are_compared_by_ratio(measured: Measured) -> None:
    force = measured.values["force"]
    more = force * np.where(np.arange(len(force)) % 2, 0.95, 1.05)
    parity = compare_trials(measured, changed(measured, "force", more), engine="x", limits=WARP)
    bounds = measured.force_is_lower_bound
    assert parity.force.pairs == ((force > 0) & ~bounds).sum() > 3
    assert (parity.force.median, parity.force.worst) == pytest.approx((0.05, 0.05))
    assert parity.force.within is False
    assert parity.metric("force").worst == pytest.approx(0.05 * np.nanmax(force))

    # Ramps that ended in both engines say nothing about the force.
    ended = replace(measured, force_is_lower_bound=np.arange(len(force)) % 2 == 1)
    shorter = changed(ended, "force", np.where(ended.force_is_lower_bound, force / 2, force))
    found = compare_trials(ended, shorter, engine="x").force
    assert found.worst == 0.0
    assert found.pairs == ((force > 0) & ~ended.force_is_lower_bound).sum()
    one_sided = compare_trials(measured, shorter, engine="x").force
    assert one_sided.worst == pytest.approx(0.5)


@given(count=st.integers(1, 2000), data=st.data())
def test_intervals_are_wilsons(count: int, data: st.DataObject) -> None:
    hits = data.draw(st.integers(0, count))
    expected = stats.binomtest(hits, count).proportion_ci(method="wilson")
    assert wilson(hits / count, count) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_other_grasps_are_not_compared(
    measured: Measured,
    scenes: list[Scene],
    grasps: list[PlanarGrasp],
    results: list[TrialResults],
) -> None:
    others = {
        "fewer": measure(scenes[:2], grasps[:2], results[:2]),
        "ids": replace(measured, grasp_id=measured.grasp_id[::-1].copy()),
        "objects": replace(measured, objects=("box", "ball")),
        "trials": replace(measured, outcomes=measured.outcomes[:, :1]),
    }
    for other in others.values():
        with pytest.raises(UsageError, match="compare the same grasps"):
            compare_trials(measured, other, engine="x")
    with pytest.raises(UsageError, match="one of each for each scene"):
        measure(scenes, grasps, results[:2])
    with pytest.raises(MetricError, match="pass the trials of these grasps"):
        measure(scenes[:1], [grasps[0][:3]], results[:1])
    with pytest.raises(UsageError, match="no compared metric 'g_dis'"):
        compare_trials(measured, measured, engine="x").metric("g_dis")


def no_constant(text: str) -> float:
    raise ValueError(f"{text} is not JSON")


def test_json_has_everything(measured: Measured) -> None:
    none = changed(measured, "moved", np.full(len(measured.object), np.nan))
    parity = compare_trials(measured, none, engine="warp", limits=WARP)
    found = json.loads(json.dumps(parity.as_json()), parse_constant=no_constant)
    assert {row["metric"] for row in found["metrics"]} == set(measured.values)
    assert (found["engine"], found["passed"]) == ("warp", False)
    (moved,) = (row for row in found["metrics"] if row["metric"] == "moved")
    assert (moved["median"], moved["within"], moved["limit"]) == (None, False, 1e-4)
    counts = found["outcomes"]["counts"]
    assert set(counts) == {outcome.label for outcome in Outcome}
    assert sum(sum(row.values()) for row in counts.values()) == found["trials"]
    agreement = found["outcomes"]["agreement"]
    assert (agreement["value"], agreement["within"]) == (1.0, True)
    assert found["limits"] == {"outcomes": 0.98, "length": 1e-4, "angle": 1e-3, "force": 0.02}
    assert found["force"]["limit"] == 0.02


def test_the_command_prints_tables_and_json(
    tmp_path_factory: pytest.TempPathFactory,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("GMDX_CACHE", str(tmp_path_factory.getbasetemp() / "prepared"))
    folder = tmp_path_factory.mktemp("meshes")
    words = ["bench", "parity", *map(str, write_meshes(folder, 2)), "--grasps", "2"]
    words += ["--trials", "1", "--engine", "mujoco"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out, parse_constant=no_constant)
    assert found["reference"] == f"mujoco {mujoco.__version__}"
    assert (found["grasps"], len(found["objects"])) == (4, 2)
    assert found["failures"] == []
    (parity,) = found["parities"]
    assert parity["outcomes"]["agreement"]["value"] == 1.0
    assert all(row["worst"] in (0.0, None) for row in parity["metrics"])
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 100
    for word in ("outcomes that agree", "lif_ori_stability", "force, relative", "median"):
        assert word in printed
    assert "FAIL" not in printed


def test_another_physics_differs_and_its_ways_to_end_are_named(
    scenes: list[Scene], capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pybullet", reason="the second engine is not installed")
    from gmdx.cli.bench.parity import show_parity

    figures = parity_figures(
        scenes[:2], engines=("bullet",), grasps=4, gripper=GRIPPER, trials=TRIALS
    )
    (parity,) = figures.parities
    assert parity.limits is None
    assert parity.passed is None
    differing = sum(one.trials for one in parity.disagreements)
    assert differing == round((1 - parity.agreement.value) * parity.trials)
    assert parity.metric("sim_width").worst > 0
    held = replace(parity, limits=WARP, metrics=tuple(
        replace(row, limit=1e-4 if row.unit == "m" else None) for row in parity.metrics
    ))  # fmt: skip
    show_parity(replace(figures, parities=(held,)))
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 100
    assert "bullet: FAIL" in printed
    assert "< 0.0001: FAIL" in printed
