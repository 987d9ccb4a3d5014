"""Datasets whose trials ran in batches across objects."""

import itertools
import json
import logging
import threading
import time
from collections.abc import Callable
from concurrent import futures
from pathlib import Path
from random import Random
from typing import Any

import pandas as pd
import pytest

pytest.importorskip("warp", reason="the extra gmdx[warp] is not installed")

from gmdx.dataset.read import read_dataset
from gmdx.errors import SceneError
from gmdx.machine.devices import cuda_devices
from gmdx.machine.executor import Crash, Finished, Inbox
from gmdx.machine.tasks import EXECUTORS
from gmdx.pipeline.device import schedule
from gmdx.pipeline.generate import GenerateConfig, generate
from gmdx.pipeline.stages import ObjectOutcome, ReadyObject, Task, TriedObject
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


class Threads:
    """A second executor, on a library of its own: what a cluster's would be."""

    def __init__(self, inbox: Inbox, places: int) -> None:
        self.inbox, self.places = inbox, places
        self.pool = futures.ThreadPoolExecutor(places)

    def give(self, function: Callable[[Any], Any], task: Any) -> int:
        attempt = self.inbox.number()

        def hand_in(done: "futures.Future[Any]") -> None:
            error = done.exception()
            self.inbox.put(Finished(task, attempt, done.result()) if error is None else error)

        self.pool.submit(function, task).add_done_callback(hand_in)
        return attempt

    def close(self) -> None:
        self.pool.shutdown(cancel_futures=True)


@ON_CPU
def test_another_executor_makes_the_same_bytes(
    dataset: Path,
    meshes: list[Path],
    cache: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened = []

    def threads(inbox: Inbox, workers: int) -> Threads:
        opened.append(workers)
        return Threads(inbox, workers)

    monkeypatch.setitem(EXECUTORS, "processes", threads)
    generate(meshes, tmp_path, _warp(cache, workers=2))
    assert opened == [2]
    assert contents(tmp_path) == contents(dataset)


def blank(kind: type[Any], **fields: object) -> Any:
    """A record of which only some fields matter."""
    made = object.__new__(kind)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


class Still:
    """An executor whose attempts are done when the inbox says so."""

    def __init__(self, places: int) -> None:
        self.places = places
        self.given: list[tuple[int, Any]] = []
        self.seen: list[Any] = []

    def give(self, function: object, task: Any) -> int:
        assert len(self.given) < self.places
        self.seen.append(task)
        self.given.append((len(self.seen), task))
        return len(self.seen)

    def close(self) -> None: ...


class Blocked(Exception):  # noqa: N818, it is no error
    """The schedule waits for what never ends."""


class Chance(Inbox):
    """Ends attempts in random order, and now and then with a crash."""

    def __init__(self, seed: int, *executors: Still, crashes: float) -> None:
        super().__init__()
        self.random, self.executors, self.crashes = Random(seed), executors, crashes

    def take(self) -> Finished[Any, Any]:
        busy = [executor for executor in self.executors if executor.given]
        if not busy:
            raise Blocked
        given = self.random.choice(busy).given
        attempt, task = given.pop(self.random.randrange(len(given)))
        crashed = self.random.random() < self.crashes
        return Finished(task, attempt, Crash("by chance") if crashed else self.done(task))

    def done(self, task: Any) -> Any:
        if isinstance(task, Task):
            return blank(ReadyObject, task=task)
        if isinstance(task, TriedObject):
            return blank(ObjectOutcome)
        return [
            blank(TriedObject if self.random.random() < 0.8 else ObjectOutcome, task=ready.task)
            for ready in task
        ]


@pytest.mark.parametrize("places", [1, 3])
def test_a_batch_is_made_while_one_is_on_the_device(places: int) -> None:
    """With a device that is never done: one batch there, one in the making, and then a wait."""
    host, device = Still(places), Still(1)
    endless = (blank(Task) for _ in itertools.count())
    outcomes = schedule(endless, list, Chance(0, host, crashes=0.0), host, device, batch=2)
    with pytest.raises(Blocked):
        next(outcomes)
    assert [len(batch) for batch in device.seen] == [2]
    assert len(host.seen) == 2 + 2


@pytest.mark.parametrize("seed", range(40))
def test_every_object_comes_to_one_end_whatever_ends_first(seed: int) -> None:
    random = Random(seed)
    count, batch = random.randrange(9), random.randint(1, 4)
    host, device = Still(random.randint(1, 4)), Still(1)
    inbox = Chance(seed, host, device, crashes=random.choice([0.0, 0.2]))
    tasks = [blank(Task) for _ in range(count)]
    outcomes = list(schedule(iter(tasks), list, inbox, host, device, batch=batch))
    assert sorted(id(item.task) for item in outcomes) == sorted(map(id, tasks))
    assert not host.given
    assert not device.given
    *full, _ = device.seen or [[]]
    assert all(len(made) == batch for made in full)


def _rows(root: Path) -> pd.DataFrame:
    parts = [pd.read_parquet(path) for path in sorted(root.glob("objects/*/grasps.parquet"))]
    return pd.concat(parts, ignore_index=True)
