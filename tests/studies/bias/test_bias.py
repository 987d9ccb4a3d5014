"""The bias study on real runs: exact replays, a null study, resumption, the report, refusals."""

import json
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from gmdx.dataset.read import Dataset, read_dataset
from gmdx.errors import ConfigError, DatasetError, UsageError
from gmdx.metrics.table import COMPARED
from gmdx.objects.decompose.decomposition import DecomposeConfig
from gmdx.pipeline.generate import generate
from gmdx.scenes.gripper import load_gripper, save_gripper
from gmdx.studies.bias.figures import bias_figures
from gmdx.studies.bias.replay import other_hulls, runs_of
from gmdx.studies.bias.result import BiasConfig, BiasStudy
from gmdx.studies.bias.study import bias_study, choose
from gmdx.trials.protocol import TrialConfig, compile_schedule
from tests.runs import Command, needs_proc, small_config, write_meshes

NULL = BiasConfig(engine="mujoco", noise_floor=False, truth=False, grasps=8, resamples=200)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("bias")
    meshes = write_meshes(root / "meshes")
    generate(meshes, root / "dataset", small_config(root / "cache", trials=3))
    return read_dataset(root / "dataset")


@pytest.fixture(scope="module")
def null(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> BiasStudy:
    """MuJoCo against itself, all grasps, same seed."""
    return bias_study(
        dataset, tmp_path_factory.mktemp("null") / "study", replace(NULL, grasps=None)
    )


@pytest.fixture(scope="module")
def floor(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> BiasStudy:
    """MuJoCo against itself, noise floor and closed forms included."""
    config = BiasConfig(engine="mujoco", grasps=6, objects=2, resamples=200)
    return bias_study(dataset, tmp_path_factory.mktemp("floor") / "study", config)


def test_replay_in_the_same_engine_reproduces_the_rows(dataset: Dataset, null: BiasStudy) -> None:
    pairs, rows = pq.read_table(null.root / "pairs.parquet"), dataset.grasps()
    assert len(pairs) == len(rows) == 36
    for name in ("object_id", "scene_id", "grasp_id", "x", "angle", "width"):
        assert pairs[name].equals(rows[name])
    for metric in COMPARED:
        for run in "ab":
            np.testing.assert_array_equal(
                pairs[f"{metric.name}_{run}"].to_numpy(), rows[metric.name].to_numpy()
            )
    assert pairs["outcomes_a"].to_pylist() == rows["outcomes"].to_pylist()
    assert pairs["outcome_b"].to_pylist() == rows["outcome"].to_pylist()
    assert null.versions["a"].startswith("mujoco")


def test_null_study_finds_exactly_no_difference(null: BiasStudy) -> None:
    engines = null.engines
    assert engines.grasps == 36
    assert engines.outcomes.trials.agreement == 1.0
    assert engines.outcomes.mcnemar.p_value == 1.0
    for metrics in (engines.metrics, *(one.metrics for one in engines.objects)):
        for found in metrics:
            assert found.only_first == found.only_second == 0
            if found.pairs == 0:
                continue
            assert found.difference.mean == found.rms == found.changed == found.ks == 0.0
            assert found.limits.spread == found.low == found.high == 0.0
            if not np.isnan(found.difference.low):
                assert found.difference.low == found.difference.high == 0.0
    for flips in engines.flips:
        assert flips.lost == flips.gained == 0
        assert flips.flipped.high == 0.0
    assert null.disputed == ()
    assert "agree about every trial" in (null.root / "report.html").read_text()


def test_noise_floor_changes_what_it_says_and_nothing_else(
    dataset: Dataset, floor: BiasStudy
) -> None:
    runs = {run.name: run for run in runs_of(dataset, "mujoco", noise_floor=True)}
    assert [comparison.name for comparison in floor.floor] == ["seed", "timestep", "hulls"]
    gripper = load_gripper()
    whole, half = (
        compile_schedule(
            TrialConfig(),
            physics=run.physics,
            stroke=gripper.stroke,
            closing_force=20.0,
            descent=0.1,
        )
        for run in (runs["a"], runs["timestep"])
    )
    for name in ("approach", "close", "lift", "hold", "push"):
        a, b = getattr(whole, name), getattr(half, name)
        assert len(b) * b.timestep == pytest.approx(len(a) * a.timestep, abs=a.timestep)
    assert half.close.timestep == 0.5 * whole.close.timestep
    # The nominal trial has no noise: other noise leaves its metrics as they are.
    seed = floor.floor[0]
    assert seed.metric("moved").changed == seed.metric("sim_width").changed == 0.0
    # A box has one hull at every resolution.
    assert floor.floor[2].metric("moved").rms == 0.0
    assert floor.floor[1].metric("moved").rms > 0.0
    assert floor.engines.metric("moved").rms == 0.0


def test_other_hulls_are_bounded_otherwise_but_as_faithful() -> None:
    config = DecomposeConfig()
    other = other_hulls(config)
    assert other.max_vertices < config.max_vertices
    assert other.max_hulls < config.max_hulls
    assert other.fidelity == config.fidelity


def test_choice_is_seeded_and_grows_with_its_size(dataset: Dataset) -> None:
    few, many = (choose(dataset, replace(NULL, objects=2, grasps=g)) for g in (3, 7))
    assert few.objects == many.objects
    assert all(set(a) < set(b) for a, b in zip(few.rows, many.rows, strict=True))
    assert few == choose(dataset, replace(NULL, objects=2, grasps=3))
    others = [choose(dataset, replace(NULL, objects=2, grasps=3, seed=s)).rows for s in range(1, 5)]
    assert any(rows != few.rows for rows in others)
    assert [list(rows) for rows in few.rows] == [sorted(rows) for rows in few.rows]


class _Page(HTMLParser):
    """Tables of a page as rows of cells, and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[list[int]] = []
        self.loads: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append(0)
        elif tag in ("td", "th"):
            self.tables[-1][-1] += 1
        self.loads += [value or "" for name, value in attrs if name in ("src", "href", "data")]
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_report_is_one_page_that_loads_nothing(floor: BiasStudy) -> None:
    text = (floor.root / "report.html").read_text()
    page = _Page(text)
    assert not page.open
    assert page.tables
    for rows in page.tables:
        assert len(set(rows)) == 1, "cells do not line up with the head"
        assert len(rows) > 1
    assert all(address.startswith("data:image/png;base64,") for address in page.loads)
    assert not re.search(r"https?:|url\(|@import|<script|<link", text)
    drawn = bias_figures(floor)
    assert len(page.loads) == len(drawn)
    assert {"outcomes", "differences", "bland_altman", "truth"} <= set(drawn)
    for name in drawn:
        assert f'<figure id="{name}">' in text
    for comparison in floor.comparisons:
        assert comparison.label in text


def test_statistics_are_written_as_they_are(floor: BiasStudy) -> None:
    kept = json.loads((floor.root / "bias.json").read_text())
    assert kept["engines"]["outcomes"]["trials"]["agreement"] == 1.0
    assert [c["name"] for c in kept["noise_floor"]] == ["seed", "timestep", "hulls"]
    seen = {m["metric"]: m for m in kept["noise_floor"][1]["metrics"]}
    for found in floor.floor[1].metrics:
        assert seen[found.metric]["rms"] == pytest.approx(found.rms, nan_ok=True) or not found.pairs
    fields = pq.read_schema(floor.root / "pairs.parquet")
    assert fields.field("force_timestep").metadata[b"unit"] == b"N"
    assert fields.field("force_timestep").metadata[b"run"] == b"mujoco, half the step"


@pytest.mark.slow
def test_same_bytes_however_it_ran(dataset: Dataset, floor: BiasStudy, tmp_path: Path) -> None:
    """With one part lost, and with two processes."""
    again = tmp_path / "study"
    bias_study(dataset, again, replace(floor.config, workers=2))
    (again / "parts" / floor.choice.objects[1] / "seed.parquet").unlink()
    (again / "pairs.parquet").unlink()
    done: list[int] = []
    bias_study(dataset, again, floor.config, on_progress=lambda at: done.append(at.total))
    assert done == [1, 1]
    assert _contents(again) == _contents(floor.root)


def test_part_that_could_not_run_is_named_and_left_out(dataset: Dataset, tmp_path: Path) -> None:
    # A hulls file that is gone: the object cannot be read.
    copy = tmp_path / "dataset"
    for path in dataset.root.rglob("*"):
        if path.is_file():
            target = copy / path.relative_to(dataset.root)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
    broken = dataset.objects[0]
    (copy / "objects" / broken / "hulls.npz").write_bytes(b"")
    study = bias_study(copy, tmp_path / "study", NULL)
    assert {failure.object_id for failure in study.failures} == {broken}
    assert study.engines.grasps == 16
    assert broken not in {one.object_id for one in study.engines.objects}
    pairs = pq.read_table(tmp_path / "study" / "pairs.parquet")
    assert pairs["force_a"].null_count >= 8
    assert "could not be run" in (tmp_path / "study" / "report.html").read_text()


def test_wrong_usage_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"unknown engine 'ode'.*auto, mujoco, warp, bullet"):
        bias_study(dataset, tmp_path / "a", replace(NULL, engine="ode"))
    with pytest.raises(ConfigError, match="grasps must be at least 1"):
        BiasConfig(grasps=0)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.txt").write_text("")
    with pytest.raises(UsageError, match=r"not empty and no bias study.*mine\.txt"):
        bias_study(dataset, tmp_path / "b", NULL)
    bias_study(dataset, tmp_path / "c", replace(NULL, grasps=1, objects=1))
    with pytest.raises(UsageError, match="study made otherwise"):
        bias_study(dataset, tmp_path / "c", replace(NULL, grasps=2, objects=1))


def test_the_dataset_s_own_gripper_is_used_and_checked(dataset: Dataset, tmp_path: Path) -> None:
    """A gripper that is nowhere else but in the dataset; and one that is not what was used."""
    copy = tmp_path / "dataset"
    shutil.copytree(dataset.root, copy)
    model = copy / "gripper" / "parallel_jaw.xml"
    model.write_text(model.read_text().replace("<mujoco", "<!-- changed --><mujoco", 1))
    with pytest.raises(DatasetError, match=r"does not hold the gripper 'parallel_jaw' that"):
        bias_study(copy, tmp_path / "a", NULL)
    assert not (tmp_path / "a").exists()
    own = tmp_path / "own"
    save_gripper(load_gripper("franka_hand"), own / "mine.toml")
    text = (own / "mine.toml").read_text().replace('"franka_hand"', '"mine"', 1)
    (own / "mine.toml").write_text(text)
    meshes = write_meshes(tmp_path / "meshes", count=1)
    config = small_config(tmp_path / "cache", gripper=str(own / "mine.toml"), grasps=2, scenes=1)
    generate(meshes, tmp_path / "mine", config)
    shutil.rmtree(own)
    study = bias_study(tmp_path / "mine", tmp_path / "b", replace(NULL, grasps=None))
    assert study.gripper.name == "mine"
    assert study.engines.grasps == 2
    assert not study.failures


def test_without_pybullet_one_line_says_what_to_install(dataset: Dataset, tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['pybullet'] = None\n"
        "from gmdx.cli.main import main\n"
        f"sys.exit(main(['bias', {str(dataset.root)!r}, '--out', {str(tmp_path / 'o')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert "pip install 'gmdx[bullet]'" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "o").exists()


def _contents(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@needs_proc
@pytest.mark.slow
def test_killed_or_interrupted_run_continues_to_the_same_bytes(
    dataset: Dataset, tmp_path: Path
) -> None:
    whole = tmp_path / "whole"
    words = ("bias", dataset.root, "--engine", "mujoco", "--grasps", "6", "--workers", "2")
    done = Command(*words, "--out", whole, cache=tmp_path / "cache").finish()
    assert done.code == 0
    assert "same outcome" in done.out
    for number in (signal.SIGKILL, signal.SIGINT):
        out = tmp_path / number.name
        command = Command(*words, "--out", out, cache=tmp_path / "cache")
        command.wait_for("parts/*/*.parquet", out)
        assert not (out / "report.html").exists()
        if number == signal.SIGKILL:
            command.kill()
        else:
            command.process.send_signal(number)
            command.finish()
            assert command.code == 130
            assert "the same command continues" in command.err
        command.assert_no_orphans()
        assert Command(*words, "--out", out, cache=tmp_path / "cache").finish().code == 0
        assert _contents(out) == _contents(whole)


@pytest.mark.slow
def test_study_of_two_engines(dataset: Dataset, tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="the second engine")
    config = BiasConfig(objects=2, grasps=4, noise_floor=False, resamples=200)
    study = bias_study(dataset, tmp_path / "study", config)
    assert not study.failures
    assert study.engines.grasps == 8
    assert {row.engine for row in study.truth} == {"mujoco", "bullet"}
    assert study.engines.label == "bullet - mujoco"
    again = bias_study(dataset, tmp_path / "again", config)
    assert _contents(again.root) == _contents(study.root)
