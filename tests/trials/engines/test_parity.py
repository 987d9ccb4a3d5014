"""Trials on Warp against the same trials in C MuJoCo, and against closed forms."""

from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("warp", reason="the extra gmdx[warp] is not installed")

from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.objects.prepare import prepare
from gmdx.objects.sources import resolve
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.scene import Scene
from gmdx.scenes.settle import settle
from gmdx.studies.engines.parity import LIMITS, compare_trials, measure
from gmdx.studies.engines.parity_result import EngineParity
from gmdx.studies.engines.truth import truth_table
from gmdx.trials.outcome import Outcome
from gmdx.trials.run import run_trials

pytestmark = pytest.mark.slow


def _setting(names: Sequence[str], grasps: int) -> tuple[list[Scene], list[PlanarGrasp]]:
    gripper = load_gripper()
    scenes = [settle(prepare(source)) for source in resolve([f"bundled:{n}" for n in names])]
    return scenes, [sample_grasps(scene, grasps, gripper=gripper) for scene in scenes]


def _parity(scenes: list[Scene], grasps: list[PlanarGrasp], trials: int) -> EngineParity:
    """All phases of all trials, the push included, of several objects in one run."""
    reference = measure(scenes, grasps, run_trials(scenes, grasps, trials=trials))
    found = run_trials(scenes, grasps, "warp", trials=trials)
    measured = measure(scenes, grasps, found)
    return compare_trials(reference, measured, engine="warp", limits=LIMITS["warp"])


def test_warp_agrees_with_c() -> None:
    scenes, grasps = _setting(("hammer", "mug", "spanner", "cross"), 16)
    parity = _parity(scenes, grasps, trials=5)
    assert parity.agreement.value >= 0.98, parity.disagreements
    assert parity.passed, parity.as_json()
    force = parity.force
    assert force.pairs >= 30
    assert force.median < 1e-3  # far inside the 2 % that the limits ask for


def test_forces_are_those_of_the_closed_forms() -> None:
    """Boxes of two frictions and masses pushed straight and sideways, and faces that are tilted."""
    rows = [row for row in truth_table(["warp"]) if row.unit == "N"]
    assert len(rows) >= 15
    for row in rows:
        assert row.measured == pytest.approx(row.expected, rel=0.05), row


def test_other_grippers_run_too() -> None:
    scenes, _ = _setting(("cross",), 1)
    for name in ("franka_hand", "robotiq_2f85"):
        gripper = load_gripper(name)
        grasps = sample_grasps(scenes[0], 4, gripper=gripper)
        ours = run_trials(scenes[0], grasps, "warp", trials=1, gripper=gripper)
        theirs = run_trials(scenes[0], grasps, trials=1, gripper=gripper)
        assert (theirs.outcome == Outcome.SUCCESS).any()
        assert np.mean(ours.outcome == theirs.outcome) >= 0.75
        held = ~np.isnan(theirs.object_position) & ~np.isnan(ours.object_position)
        apart = np.abs(ours.object_position - theirs.object_position)[held]
        assert np.median(apart) < 1e-4
