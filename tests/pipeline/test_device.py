"""Datasets whose trials ran in batches across objects."""

import json
import logging
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

pytest.importorskip("warp", reason="the extra gmdx[warp] is not installed")

from gmdx.dataset.read import read_dataset
from gmdx.errors import SceneError
from gmdx.machine.devices import cuda_devices
from gmdx.pipeline import device as batched
from gmdx.pipeline.generate import GenerateConfig, generate
from gmdx.pipeline.stages import Task
from gmdx.trials.engines.parallel import ParallelEngine
from gmdx.trials.placement import RawTrials, TrialBatch
from gmdx.trials.protocol import TrialConfig
from tests.runs import assert_whole, contents, small_config, write_meshes

ON_CPU = pytest.mark.skipif(
    cuda_devices() > 0, reason="on a GPU the order of contacts, and so the last bits, may differ"
)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_meshes(tmp_path_factory.mktemp("meshes"))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def _warp(cache: Path, **options: object) -> GenerateConfig:
    return small_config(cache, grasps=3, scenes=1, engine="warp", **options)


@pytest.fixture(scope="module")
def dataset(meshes: list[Path], cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("dataset")
    summary = generate(meshes, root, _warp(cache))
    assert summary.produced == 3
    return root


def test_a_dataset_names_what_ran_its_trials(dataset: Path) -> None:
    assert_whole(dataset)
    header = json.loads((dataset / "dataset.json").read_text())
    assert header["engine"] == "warp"
    assert {"mujoco-mjx", "warp-lang"} <= set(header["packages"])
    read = read_dataset(dataset)
    for object_id in read.objects:
        described = json.loads((dataset / "objects" / object_id / "object.json").read_text())
        assert described["kernels"]["trials"].startswith("warp (mujoco-mjx")


def test_its_trials_are_those_of_mujoco(dataset: Path, meshes: list[Path], cache: Path,
                                        tmp_path: Path) -> None:  # fmt: skip
    generate(meshes, tmp_path, small_config(cache, grasps=3, scenes=1))
    ours, theirs = (_rows(root) for root in (dataset, tmp_path))
    assert list(ours.outcome) == list(theirs.outcome)
    for name in ("real_s_width", "sim_width", "real_s_dis"):
        assert (ours[name] - theirs[name]).abs().median() < 1e-5


@ON_CPU
@pytest.mark.slow
def test_no_byte_depends_on_batches_or_workers(
    dataset: Path, meshes: list[Path], cache: Path, tmp_path: Path
) -> None:
    generate(meshes, tmp_path, _warp(cache, parallel_trials=5, workers=2))
    assert contents(tmp_path) == contents(dataset)


def test_auto_says_what_it_stands_for(
    meshes: list[Path],
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("gmdx.trials.engines.registry.cuda_devices", lambda: 0)
    with caplog.at_level(logging.INFO, logger="gmdx"):
        config = small_config(cache, grasps=2, scenes=1, engine="auto", parallel_trials=5)
        generate(meshes[:1], tmp_path, config)
    assert "engine auto: mujoco runs the trials" in caplog.messages
    header = json.loads((tmp_path / "dataset.json").read_text())
    assert header["engine"] == header["configuration"]["engine"] == "mujoco"


@ON_CPU
def test_a_run_is_continued(dataset: Path, meshes: list[Path], cache: Path, tmp_path: Path) -> None:
    generate(meshes[:1], tmp_path, _warp(cache))
    summary = generate(meshes, tmp_path, _warp(cache))
    assert (summary.present, summary.produced) == (1, 2)
    assert contents(tmp_path) == contents(dataset)


def test_an_object_whose_trials_cannot_be_run_costs_only_itself(
    meshes: list[Path],
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The engine refuses one object of a batch, which otherwise runs for real."""
    run = ParallelEngine.run

    def refusing(
        engine: ParallelEngine, batches: list[TrialBatch], *, config: TrialConfig
    ) -> list[RawTrials]:
        if any(batch.object.object_id.startswith("box1") for batch in batches):
            raise SceneError("box1 is not to be simulated")
        return run(engine, batches, config=config)

    monkeypatch.setattr(ParallelEngine, "run", refusing)
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        summary = generate(meshes, tmp_path, _warp(cache))
    assert (summary.produced, summary.failed) == (2, 1)
    (failure,) = read_dataset(tmp_path).failures
    assert (failure.object_id[:4], failure.stage) == ("box1", "trials")
    assert failure.message == "box1 is not to be simulated"
    assert "a batch of 3 objects failed: box1 is not" in caplog.text


def test_breaking_off_ends_the_device_at_its_next_chunk(
    meshes: list[Path], cache: Path, tmp_path: Path
) -> None:
    begun: list[float] = []

    def report(progress: object) -> None:
        if begun:
            raise KeyboardInterrupt
        begun.append(time.perf_counter())

    with pytest.raises(KeyboardInterrupt):
        generate(meshes, tmp_path, _warp(cache, parallel_trials=3), on_progress=report)
    names = [thread.name for thread in threading.enumerate()]
    assert "gmdx trials" not in names
    assert generate(meshes, tmp_path, _warp(cache)).counts["objects"] == 3


def test_batches_are_made_while_one_is_on_the_device() -> None:
    """The scheduler alone, with a device that never ends: one batch there, one in the making."""

    class Busy:
        objects = 2
        given: list[object] = []  # noqa: RUF012

        def give(self, batch: object) -> None:
            self.given.append(batch)

        def take(self) -> None:
            return None

    def tasks() -> Iterator[Task]:
        while True:
            yield object.__new__(Task)

    schedule = batched._Schedule(tasks(), Busy())  # type: ignore[arg-type]
    stream, begun = schedule.next_tasks(), 0
    for _ in range(20):
        task = next(stream)
        if isinstance(task, Task):
            begun += 1
            result = object.__new__(batched.Begun)
            assert schedule.take(batched.Finished(task, result)) is None
    assert len(Busy.given) == 1
    assert begun == 2 + 2


def _rows(root: Path) -> pd.DataFrame:
    parts = [pd.read_parquet(path) for path in sorted(root.glob("objects/*/grasps.parquet"))]
    return pd.concat(parts, ignore_index=True)
