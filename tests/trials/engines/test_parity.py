"""Trials on MJX against the same trials in C MuJoCo, and against closed forms."""

from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("warp", reason="the extra gmdx[mjx] is not installed")

from gmdx.grasps.grasp import PlanarGrasp
from gmdx.grasps.sample import sample_grasps
from gmdx.objects.prepare import prepare
from gmdx.objects.sources.resolve import resolve
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
    return scenes, [sample_grasps(scene, grasps, scene.seed, gripper=gripper) for scene in scenes]


def _parity(impl: str, scenes: list[Scene], grasps: list[PlanarGrasp], trials: int) -> EngineParity:
    """All phases of all trials, the push included, of several objects in one run."""
    reference = measure(scenes, grasps, run_trials(scenes, grasps, trials=trials))
    found = run_trials(scenes, grasps, "mjx", impl=impl, trials=trials)
    measured = measure(scenes, grasps, found)
    backend = f"mjx-{impl}"
    return compare_trials(reference, measured, backend=backend, limits=LIMITS[backend])


def test_warp_agrees_with_c() -> None:
    scenes, grasps = _setting(("hammer", "mug", "spanner", "cross"), 16)
    parity = _parity("warp", scenes, grasps, trials=5)
    assert parity.agreement.value >= 0.98, parity.disagreements
    assert parity.passed, parity.as_json()
    force = parity.force
    assert force.pairs >= 30
    assert force.median < 1e-3  # far inside the 2 % that the limits ask for


def test_jax_agrees_with_c() -> None:
    scenes, grasps = _setting(("l_profile", "cross", "bracket"), 16)
    parity = _parity("jax", scenes, grasps, trials=1)
    assert parity.agreement.value >= 0.95, parity.disagreements
    assert parity.metric("moved").median < 1e-4
    assert parity.metric("clo_ori_comfort").median < 1e-3
    assert parity.force.pairs >= 20
    assert parity.force.median < 0.05


@pytest.mark.parametrize("impl", ["warp", "jax"])
def test_forces_are_those_of_the_closed_forms(impl: str) -> None:
    """Boxes of two frictions and masses pushed straight and sideways, and faces that are tilted."""
    rows = [row for row in truth_table([f"mjx-{impl}"]) if row.unit == "N"]
    assert len(rows) >= 15
    for row in rows:
        assert row.measured == pytest.approx(row.expected, rel=0.05), row


@pytest.mark.parametrize("impl", ["warp", "jax"])
def test_other_grippers_run_too(impl: str) -> None:
    scenes, _ = _setting(("cross",), 1)
    for name in ("franka_hand", "robotiq_2f85"):
        gripper = load_gripper(name)
        grasps = sample_grasps(scenes[0], 4, 0, gripper=gripper)
        ours = run_trials(scenes[0], grasps, "mjx", impl=impl, trials=1, gripper=gripper)
        theirs = run_trials(scenes[0], grasps, trials=1, gripper=gripper)
        assert (theirs.outcome == Outcome.SUCCESS).any()
        assert np.mean(ours.outcome == theirs.outcome) >= 0.75
        held = ~np.isnan(theirs.object_position) & ~np.isnan(ours.object_position)
        apart = np.abs(ours.object_position - theirs.object_position)[held]
        assert np.median(apart) < 1e-4
