"""The figures of `gmdx bench` against the files and the laws that they come from."""

import json
from pathlib import Path

import numpy as np
import pytest

from gmdx.cli.main import main
from gmdx.dataset.read import read_dataset
from gmdx.pipeline.generate import generate
from gmdx.studies.throughput import (
    peak_megabytes,
    pipeline_figures,
    worker_figures,
)
from tests.runs import small_config, write_meshes


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_meshes(tmp_path_factory.mktemp("meshes"), 2)


def test_stages_add_up_to_what_the_files_say(meshes: list[Path], tmp_path: Path) -> None:
    generate(meshes, tmp_path / "out", small_config(tmp_path / "cache"))
    dataset = read_dataset(tmp_path / "out")
    figures = pipeline_figures(dataset)
    costs = [dataset.cost(object_id) for object_id in dataset.objects]
    spent = sum(sum(cost["cpu_seconds"].values()) for cost in costs)
    assert figures.grasps == dataset.grasps().num_rows == 24
    assert figures.total * 24 + figures.prepare_seconds * 2 == pytest.approx(spent)
    assert 0 < figures.step_share <= 1
    assert sum(figures.metric_seconds.values()) <= figures.seconds["metrics"] + 0.01


def test_ratios_compare_with_the_first_run() -> None:
    asked = []
    figures = worker_figures(asked.append, [1, 2])
    assert asked == [1, 2]
    assert figures[0].ratio == 1.0
    assert figures[1].ratio == pytest.approx(figures[0].wall_seconds / figures[1].wall_seconds)


def test_bench_depth_prints_json(meshes: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "depth", str(meshes[0]), "--images", "2"]
    assert main([*words, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["object_id"].startswith("box0-")
    assert main(words) == 0
    assert "object id" in capsys.readouterr().out


def test_bench_pipeline_prints_json(meshes: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "pipeline", str(meshes[0]), "--grasps", "2", "--scenes", "1"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["total"] == pytest.approx(sum(found["seconds"].values()))
    assert [run["workers"] for run in found["workers"]] == [1]


def test_peak_memory_sees_what_is_held() -> None:
    held = np.ones(25_000_000)  # 200 MB
    assert held.nbytes / 1e6 < peak_megabytes() < 20_000
