"""The figures of `gmdx bench trials`: the same trials on every engine, each in its own process."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import gmdx.trials.engines
from gmdx.cli.bench.trials import show_speed
from gmdx.cli.main import main
from gmdx.errors import GraspError, UsageError
from gmdx.grasps.sample import sample_grasps
from gmdx.machine.progress import Progress
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.scene import Scene
from gmdx.studies.engines.machine import compilations, machine, peak_device_memory
from gmdx.studies.engines.runs import RunFailure, run_apart
from gmdx.studies.engines.speed import trial_figures
from gmdx.trials.outcome import Outcome
from gmdx.trials.run import run_trials
from tests.runs import write_meshes
from tests.support import box_object, resting_scene

GRIPPER = load_gripper()


@pytest.fixture(scope="module")
def scenes() -> list[Scene]:
    sizes = [(0.03, 0.04, 0.05), (0.025, 0.05, 0.06)]
    return [resting_scene(box_object(size, object_id=f"box{size[0]}")) for size in sizes]


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return [str(path) for path in write_meshes(tmp_path_factory.mktemp("meshes"), 2)]


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    monkeypatch.setenv("GMDX_CACHE", str(tmp_path_factory.getbasetemp() / "prepared"))


def test_the_trials_of_all_objects_are_counted_as_they_run_alone(scenes: list[Scene]) -> None:
    speed = trial_figures(scenes, grasps=3, gripper=GRIPPER, trials=2)
    alone = [
        run_trials(
            scene,
            sample_grasps(scene, 3, gripper=GRIPPER),
            gripper=GRIPPER,
            trials=2,
        )
        for scene in scenes
    ]
    (row,) = speed.figures
    outcomes = np.concatenate([results.outcome.ravel() for results in alone])
    assert speed.objects == ("box0.03", "box0.025")
    assert (speed.grasps, row.trials) == (6, 12)
    assert row.steps == sum(results.steps for results in alone)
    assert row.success == np.mean(outcomes == Outcome.SUCCESS)
    assert row.failed == 0
    assert row.version == f"mujoco {mujoco.__version__}"
    assert (row.compiled, row.cached, row.compiled_again, row.device_bytes) == (None,) * 4
    assert row.trials_per_second * row.seconds == pytest.approx(12)
    assert row.steps_per_second * row.seconds == pytest.approx(row.steps)
    assert row.step_microseconds * row.steps_per_second == pytest.approx(1e6 * row.step_share)
    assert 0 < row.step_share <= 1
    assert row.first_seconds > 0


def test_ratios_compare_with_the_first_engine(scenes: list[Scene]) -> None:
    pytest.importorskip("pybullet", reason="the second engine is not installed")
    told: list[Progress] = []
    speed = trial_figures(
        scenes,
        grasps=2,
        gripper=GRIPPER,
        trials=1,
        engines=("mujoco", "bullet"),
        on_progress=told.append,
    )
    first, second = speed.figures
    assert first.ratio == 1.0
    assert second.ratio == pytest.approx(second.trials_per_second / first.trials_per_second)
    assert first.trials == second.trials == 4
    assert (first.threads, second.threads) == (1, None)
    assert [(at.name, at.done, at.total) for at in told] == [
        ("", 0, 2), ("mujoco", 1, 2), ("bullet", 2, 2),
    ]  # fmt: skip
    assert told[-1].count == 2 * (first.trials + second.trials)


@pytest.mark.slow
def test_numbers_of_parallel_trials_get_a_row_each_and_the_timed_run_compiles_nothing(
    scenes: list[Scene],
) -> None:
    pytest.importorskip("warp", reason="the implementation is not installed")
    speed = trial_figures(
        scenes,
        grasps=2,
        gripper=GRIPPER,
        trials=1,
        engines=("mujoco", "warp"),
        parallel_trials=(4, 2, 4),
        isolated=True,
    )
    assert speed.failures == ()
    one, two, four = speed.figures
    assert [row.parallel_trials for row in speed.figures] == [None, 2, 4]
    for row in (two, four):
        assert row.engine == "warp"
        assert row.compiled is not None
        assert row.cached is not None
        assert row.compiled + row.cached > 0
        assert row.compiled_again == 0
        assert row.trials == one.trials == 4
        assert row.ratio == pytest.approx(row.trials_per_second / one.trials_per_second)


def work(task: str) -> int:
    """What an engine may do to its process."""
    if task == "crash":
        os._exit(3)
    if task == "refuse":
        raise GraspError("no grasp")
    if task == "device":
        raise RuntimeError("CUDA error 700")
    return os.getpid()


@pytest.mark.parametrize("isolated", [True, False])
def test_an_engine_that_fails_is_named_and_ends_nothing_else(
    isolated: bool, caplog: pytest.LogCaptureFixture
) -> None:
    def run(task: str) -> int | RunFailure:
        return run_apart(work, task, label="some engine", isolated=isolated)

    assert run("refuse") == RunFailure("some engine", "no grasp")
    assert run("device") == RunFailure("some engine", "RuntimeError: CUDA error 700")
    assert all("some engine failed" in message for message in caplog.messages)
    if isolated:
        assert run("crash") == RunFailure("some engine", "the worker process exited with code 3")
    assert (run("pid") == os.getpid()) != isolated


def test_an_error_that_nobody_foresaw_is_named_with_its_place(
    caplog: pytest.LogCaptureFixture,
) -> None:
    found = run_apart(len, 3, label="some engine", isolated=False)
    assert isinstance(found, RunFailure)
    assert found.error.startswith("TypeError: ")
    (record,) = caplog.records
    assert record.exc_info is not None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"engines": ("mujoco", "pullet")}, "unknown engine 'pullet'"),
        ({"engines": ()}, "at least one engine"),
        ({"grasps": 0}, "grasps must be at least 1"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"parallel_trials": (8, 0)}, "parallel_trials must be at least 1"),
        ({"parallel_trials": (8,)}, "not for mujoco"),
    ],
)
def test_what_cannot_run_is_refused(
    options: dict[str, object], message: str, scenes: list[Scene]
) -> None:
    with pytest.raises(UsageError, match=message):
        trial_figures(scenes, **({"grasps": 1, "gripper": GRIPPER} | options))  # type: ignore[arg-type]


def test_the_machine_is_named() -> None:
    here = machine()
    assert here.packages["mujoco"] == mujoco.__version__
    assert here.processor
    assert 1 <= here.cores <= (os.cpu_count() or 1)
    assert compilations("mujoco") is None
    assert peak_device_memory("bullet") is None


def test_the_command_prints_a_table_and_json(
    meshes: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["bench", "trials", *meshes, "--grasps", "2", "--trials", "1", "--threads", "2"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (row,) = found["figures"]
    assert len(found["objects"]) == 2
    assert (found["grasps"], row["trials"], row["threads"]) == (4, 4, 2)
    assert row["trials_per_second"] == pytest.approx(row["trials"] / row["seconds"])
    assert row["ratio"] == 1.0
    assert found["failures"] == []
    assert found["machine"]["packages"]["mujoco"] == mujoco.__version__
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 100
    for word in ("trials", "us a", "compiled", "device", f"mujoco {mujoco.__version__}, 2 threads"):
        assert word in printed


def test_figures_of_any_size_fit_the_table(
    scenes: list[Scene], capsys: pytest.CaptureFixture[str]
) -> None:
    speed = trial_figures(scenes, grasps=1, gripper=GRIPPER, trials=1)
    (row,) = speed.figures
    on_device = {"engine": "warp", "compiled": 120, "cached": 120, "compiled_again": 0}
    row = replace(
        row, first_seconds=0.00123, seconds=0.000456, processor_seconds=1.2e-7,
        step_seconds=1.2e-7,
    )  # fmt: skip
    slow = replace(
        row, **on_device, parallel_trials=4, seconds=123.4, processor_seconds=99.9,
        step_seconds=99.9, first_seconds=1234.5, ratio=1.23e-4,
    )  # fmt: skip
    fast = replace(
        row, **on_device, parallel_trials=16384, trials=100_000, steps=45_678_901, seconds=3.2,
        device_bytes=139 * 10**9, failed=3, ratio=123.4,
    )  # fmt: skip
    failure = RunFailure("warp x 8", "no memory")
    show_speed(replace(speed, figures=(row, slow, fast), failures=(failure,)))
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 100
    assert "warp: 3 of 100000 trials diverged or overflowed" in printed
    assert "warp x 8 failed: no memory" in printed
    assert "warp x 4: filled" in printed
    assert "120+120; 0" in printed


@pytest.mark.parametrize("command", ["trials", "parity"])
def test_a_missing_extra_is_said_in_one_line_before_anything_runs(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("gmdx.trials.engines.warp")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(gmdx.trials.engines, "warp", raising=False)
    monkeypatch.setitem(sys.modules, "warp", None)
    assert main(["bench", command, "bundled:cup", "--engine", "mujoco,warp"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert "pip install 'gmdx[warp]'" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--engine", "mujoco,pullet"], "unknown engine 'pullet'"),
        (["--engine", "warped"], "unknown engine 'warped'"),
        (["--parallel-trials", "4,x"], "--parallel-trials takes numbers"),
        (["--parallel-trials", "4", "--engine", "mujoco"], "not for mujoco"),
        (["--grasps", "0"], "grasps must be at least 1"),
        (["--trials", "0"], "trials must be at least 1"),
    ],
)
@pytest.mark.parametrize("command", ["trials", "parity"])
def test_wrong_words_are_refused(
    command: str, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", command, "bundled:cup", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err


def test_parity_takes_one_number_of_parallel_trials(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "parity", "bundled:cup", "--parallel-trials", "4,8"]) == 2
    assert "one number" in capsys.readouterr().err


def test_an_object_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    assert main(["bench", "trials", str(tmp_path / "nowhere.obj")]) == 2
