"""Whole sensitivity studies of boxes: what they find, and that interruptions change nothing."""

import json
import re
import signal
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gmdx.cli.main import main
from gmdx.errors import SceneError, UsageError
from gmdx.files.folder import OutputError
from gmdx.machine.progress import Progress
from gmdx.studies.sensitivity.figures import mean_curve
from gmdx.studies.sensitivity.indices import make_design
from gmdx.studies.sensitivity.parameters import PARAMETERS
from gmdx.studies.sensitivity.result import ALL, pooled
from gmdx.studies.sensitivity.runs import BASELINE, OUTPUTS
from gmdx.studies.sensitivity.study import (
    SensitivityConfig,
    SensitivityStudy,
    sensitivity_study,
)
from tests.runs import Command, needs_proc, write_meshes

NAMES = ("friction", "mass", "hulls")
COLUMNS = (*NAMES, "seed")


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_meshes(tmp_path_factory.mktemp("meshes"), 2)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def small(cache: Path, **options: object) -> SensitivityConfig:
    values = {"parameters": NAMES, "runs": 12, "grasps": 4, "trials": 2, "cache": cache} | options
    return SensitivityConfig(**values)  # type: ignore[arg-type]


def contents(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()
    }


@pytest.fixture(scope="module")
def curves(
    meshes: list[Path], cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> SensitivityStudy:
    out = tmp_path_factory.mktemp("oat") / "study"
    return sensitivity_study(meshes, out, small(cache, method="oat", runs=20))


@pytest.fixture(scope="module")
def morris(
    meshes: list[Path], cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> SensitivityStudy:
    return sensitivity_study(meshes, tmp_path_factory.mktemp("morris") / "study", small(cache))


def test_every_run_has_a_row_with_its_parameters(curves: SensitivityStudy) -> None:
    kept = pd.read_parquet(curves.root / "runs.parquet")
    pd.testing.assert_frame_equal(kept, curves.runs, check_dtype=False)
    assert len(kept) == 2 * (1 + 5 + 5 + 3 + 5)
    baseline = kept[kept.block == BASELINE]
    assert set(baseline.run) == {0}
    np.testing.assert_allclose(baseline[list(COLUMNS)], [[0.8, 0.1, 1e-3, 0.0]] * 2)
    for k, name in enumerate(COLUMNS):
        own = kept[kept.block == k]
        for other in set(COLUMNS) - {name}:
            assert set(own[other]) == set(baseline[other])
        parameter = PARAMETERS[name]
        assert own[name].between(parameter.low, parameter.high).all()
    assert set(kept[kept.block == 2].hulls) == set(PARAMETERS["hulls"].levels)
    assert (kept.grasps == 4).all()
    assert (kept.trials == 8).all()
    assert (kept.hull_count == 1).all()


def test_curves_of_boxes_rise_with_friction_and_fall_with_weight(curves: SensitivityStudy) -> None:
    friction, force = mean_curve(curves.runs, 0, "friction", "force")
    np.testing.assert_allclose(friction, np.linspace(0.4, 1.0, 5))
    # Not more than 2 mu N - m g, which a grasp through the middle of a box withstands.
    assert np.all(force < 1.05 * (2 * friction * 20 - 0.981))
    found = curves.indices["force"][ALL]
    assert found.main[0] == pytest.approx(force[-1] - force[0])
    assert found.main[1] < 0 < found.main[0]
    assert found.above("seed")[0]


def test_hulls_of_a_box_are_the_box_and_chance_does_little(morris: SensitivityStudy) -> None:
    found = morris.indices["force"][ALL]
    at = dict(zip(found.names, range(4), strict=True))
    assert found.names == COLUMNS
    assert np.argmax(found.total) == at["friction"]
    assert found.main[at["friction"]] > 0
    assert found.total[at["hulls"]] == 0
    assert found.total[at["seed"]] < 0.25 * found.total[at["friction"]]
    assert not found.above("seed")[at["seed"]]


def test_files_say_the_same_as_the_record(morris: SensitivityStudy) -> None:
    names = {"settings.json", "runs.parquet", "sensitivity.json", "report.html"}
    pictures = {f"figures/tornado_{output.name}.png" for output in OUTPUTS}
    assert set(contents(morris.root)) == names | pictures
    result = json.loads((morris.root / "sensitivity.json").read_text())
    found = morris.indices["success"][ALL]
    values = result["outputs"]["success"]["indices"][ALL]["parameters"]
    assert [values[name]["total"] for name in COLUMNS] == list(found.total)
    assert result["counts"]["trials"] == len(morris.runs) * 8
    assert [p["reason"] for p in result["parameters"]] == [
        PARAMETERS[name].reason for name in COLUMNS
    ]


def test_report_opens_without_a_network_and_shows_everything(curves: SensitivityStudy) -> None:
    text = (curves.root / "report.html").read_text()
    assert not re.search(r"(src|href)=['\"](?!data:)", text)
    assert text.count('src="data:image/png;base64,') == 2 * len(OUTPUTS)
    for name in COLUMNS:
        assert escape(PARAMETERS[name].reason) in text


def test_interrupted_study_ends_with_the_same_bytes(
    meshes: list[Path], cache: Path, morris: SensitivityStudy, tmp_path: Path
) -> None:
    out = tmp_path / "study"

    def stop(at: Progress) -> None:
        if at.done >= 8:
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            sensitivity_study(meshes, out, small(cache), on_progress=stop)
    assert not (out / "runs.parquet").exists()
    seen: list[Progress] = []
    sensitivity_study(meshes, out, small(cache, workers=2), on_progress=seen.append)
    assert 0 < seen[0].total == seen[-1].done < len(morris.runs)
    assert contents(out) == contents(morris.root)
    sensitivity_study(meshes, out, small(cache), on_progress=seen.append)
    assert seen[-1].total == 0
    assert contents(out) == contents(morris.root)


def test_other_options_and_foreign_folders_are_refused(
    meshes: list[Path], cache: Path, morris: SensitivityStudy, tmp_path: Path
) -> None:
    before = contents(morris.root)
    with pytest.raises(OutputError, match="grasps: 4 -> 5"):
        sensitivity_study(meshes, morris.root, small(cache, grasps=5))
    with pytest.raises(OutputError, match="objects"):
        sensitivity_study(meshes[:1], morris.root, small(cache))
    assert contents(morris.root) == before
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"not empty.*notes\.txt"):
        sensitivity_study(meshes, tmp_path, small(cache))


def test_objects_that_fail_are_named_and_left_out(
    meshes: list[Path], cache: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.obj"
    bad.write_text("no mesh")
    config = small(cache, parameters=("friction",), method="oat", runs=4)
    study = sensitivity_study([*meshes[:1], bad], tmp_path / "out", config)
    assert [name.split("-")[0] for name in study.failures] == ["bad"]
    assert study.runs.object_id.nunique() == 1
    with pytest.raises(SceneError, match="no object can be studied"):
        sensitivity_study([bad], tmp_path / "none", config)


def test_means_are_over_the_same_objects_throughout_a_block() -> None:
    design = make_design("morris", "ab", runs=6)
    values = np.array([[1.0, 2, 3, 4, 5, 6], [10.0, 20, 30, np.nan, 50, 60]])
    np.testing.assert_allclose(pooled(design, values), [5.5, 11, 16.5, 4, 5, 6])
    values[0, 5] = np.nan
    np.testing.assert_allclose(pooled(design, values)[3:], np.nan)
    sobol = make_design("sobol", "ab", runs=64)
    both = np.ones((2, 64))
    both[1, 0] = np.nan
    assert np.isnan(pooled(sobol, both)).sum() == 4


def test_unknown_names_are_refused_before_anything_runs(
    meshes: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["sensitivity", *map(str, meshes), "--out", str(tmp_path / "out")]
    for flags, known in (
        (["--parameters", "fricton"], "did you mean 'friction'?"),
        (["--method", "fast"], "give one of morris, sobol, oat"),
        (["--runs", "3"], "raise --runs"),
    ):
        assert main([*words, *flags]) == 2
        assert known in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    with pytest.raises(UsageError, match="grasps must be at least 1"):
        SensitivityConfig(grasps=0)


def test_help_lists_every_parameter(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["sensitivity", "--help"])
    words = capsys.readouterr().out
    for name in PARAMETERS:
        assert name in words


@needs_proc
@pytest.mark.slow
def test_ctrl_c_leaves_nothing_running_and_the_command_continues(
    meshes: list[Path], cache: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = ["sensitivity", *meshes, "--out", out, "--runs", "40", "--grasps", "8"]
    words += ["--parameters", "friction,mass", "--workers", "2", "--cache", cache]
    command = Command(*words, cache=cache)
    command.wait_for("parts/*.parquet", out)
    command.process.send_signal(signal.SIGINT)
    command.finish()
    assert command.code == 130
    assert command.err.splitlines()[-1].startswith("interrupted; the same command continues")
    command.assert_no_orphans()
    again = Command(*words, cache=cache).finish()
    assert again.code == 0
    assert "there already" in again.err
    assert "friction" in again.out
    assert (out / "report.html").is_file()
    assert not (out / "parts").exists()
