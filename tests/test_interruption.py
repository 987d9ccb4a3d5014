"""kill -9 at any moment of a dataset or a study, and the same command ends with the same bytes.

Some moments are those of a clock. The others are inside the calls by which a run writes, renames
and waits for the disk: half of what a call writes is in the file, and no more.
"""

import json
import random
import signal
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from gmdx.dataset.schema import COST_FILE
from gmdx.files.folder import PARTIAL, OutputError
from gmdx.machine.progress import OnProgress, Progress
from gmdx.pipeline.generate import generate
from gmdx.scenes.camera import CameraConfig
from gmdx.studies.bias.result import BiasConfig
from gmdx.studies.bias.study import bias_study
from gmdx.studies.sensitivity.study import SensitivityConfig, sensitivity_study
from tests.kills import Call, Death, calls_of, start
from tests.runs import needs_proc, small_config, write_meshes

CHANGING = ("dataset.json", "failures.jsonl", COST_FILE)  # while a run goes on


def make_dataset(
    meshes: Path, cache: Path, out: Path, *, on_progress: OnProgress | None = None
) -> None:
    camera = CameraConfig(width=64, height=48)
    config = small_config(cache, grasps=2, scenes=1, trials=1, camera=camera)
    generate(meshes, out, config, on_progress=on_progress)


def make_bias_study(dataset: Path, out: Path, *, on_progress: OnProgress | None = None) -> None:
    config = BiasConfig(
        engine="mujoco", noise_floor=False, truth=False, grasps=1, resamples=20, disputed=0
    )
    bias_study(dataset, out, config, on_progress=on_progress)


def make_sensitivity_study(
    meshes: Path, cache: Path, out: Path, *, on_progress: OnProgress | None = None
) -> None:
    config = SensitivityConfig(
        parameters=("friction",), method="oat", runs=6, grasps=1, trials=1, cache=cache
    )
    sensitivity_study(sorted(meshes.glob("box*")), out, config, on_progress=on_progress)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Callable[..., None]]:
    """What is interrupted, by its kind: functions of the folder to write."""
    root = tmp_path_factory.mktemp("inputs")
    meshes, cache = root / "meshes", root / "cache"
    write_meshes(meshes, 2)
    for name in ("cracked.stl", "dented.stl"):
        (meshes / name).write_bytes(b"solid, but nothing follows")
    make_dataset(meshes, cache, root / "dataset")
    return {
        "dataset": partial(make_dataset, meshes, cache),
        "bias study": partial(make_bias_study, root / "dataset"),
        "sensitivity study": partial(make_sensitivity_study, meshes, cache),
    }


KINDS = ("dataset", "bias study", "sensitivity study")


def contents(root: Path) -> dict[str, bytes]:
    found = {str(path.relative_to(root)): path for path in root.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in found.items() if path.name != COST_FILE}


def assert_whole(root: Path, expected: dict[str, bytes]) -> None:
    """Whatever a killed run left in place is complete."""
    for path in root.rglob("*"):
        name = str(path.relative_to(root))
        if path.is_dir() or name.startswith(PARTIAL) or path.name == "failures.jsonl":
            continue
        if name in expected and path.name not in CHANGING:
            assert path.read_bytes() == expected[name], name
        elif path.suffix == ".json":
            json.loads(path.read_text())
        else:
            assert pq.read_table(path, partitioning=None).num_rows


def deaths_of(calls: list[Call], moments: random.Random) -> list[Death]:
    """One in a write of every file, one at a rename and one at a wait, in the order of a run."""
    by_file: dict[str, list[Call]] = {}
    for call in calls:
        if call.kind == "write":
            by_file.setdefault(call.name, []).append(call)
    pictures = [name for name in by_file if name.endswith(".png")]
    spared = set(pictures) - set(moments.sample(pictures, min(1, len(pictures))))
    chosen = [Death(moments.choice(of), done=False) for n, of in by_file.items() if n not in spared]
    for kind in ("rename", "fsync"):
        at = moments.choice([call for call in calls if call.kind == kind])
        chosen.append(Death(at, done=moments.random() < 0.5))
    return sorted(chosen, key=lambda death: calls.index(death.at))


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_killed_anywhere_and_started_again(
    kind: str, runs: dict[str, Callable[..., None]], tmp_path: Path
) -> None:
    run, moments = runs[kind], random.Random(f"moments of a {kind}")
    begun = time.monotonic()
    calls = calls_of(run, tmp_path / "whole", tmp_path / "calls.json")
    seconds = time.monotonic() - begun
    expected = contents(tmp_path / "whole")

    out = tmp_path / "by the call"
    deaths = deaths_of(calls, moments)
    assert sum(death.at.kind == "write" for death in deaths) >= 6
    for death in deaths:
        process = start(run, out, death)
        process.join()
        assert process.exitcode == -signal.SIGKILL, death
        assert_whole(out, expected)
    assert_continues(run, out, expected)

    out, kills = tmp_path / "by the clock", 0
    for _ in range(5):
        process = start(run, out)
        process.join(timeout=moments.uniform(0, seconds / 4))
        process.kill()
        process.join()
        kills += process.exitcode == -signal.SIGKILL
        assert_whole(out, expected)
    assert kills > 0
    assert_continues(run, out, expected)


def assert_continues(run: Callable[[Path], None], out: Path, expected: dict[str, bytes]) -> None:
    process = start(run, out)
    process.join()
    assert process.exitcode == 0
    assert contents(out) == expected
    assert not (out / PARTIAL).exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_second_run_in_a_live_folder_is_refused(
    kind: str, runs: dict[str, Callable[..., None]], tmp_path: Path
) -> None:
    """Two bias studies in one folder removed each other's parts once."""
    out = tmp_path / "out"

    def second(progress: Progress) -> None:
        left = sorted(out.rglob("*"))
        with pytest.raises(OutputError, match=f"another run .* is writing the {kind} in {out}"):
            runs[kind](out)
        assert sorted(out.rglob("*")) == left
        if progress.done > 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runs[kind](out, on_progress=second)
    for other in set(KINDS) - {kind}:
        with pytest.raises(OutputError, match=f"holds a {kind} and no {other}"):
            runs[other](out)
