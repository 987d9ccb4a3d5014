"""The same seed gives the same bytes: whatever the workers, the batches, and the interruptions."""

import random
import time
from pathlib import Path

import pytest

from gmdx.files.folder import PARTIAL
from gmdx.pipeline.generate import generate
from tests.runs import (
    FLAGS,
    Command,
    assert_whole,
    contents,
    needs_proc,
    small_config,
    write_meshes,
)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    write_meshes(folder, 4)
    (folder / "broken.stl").write_bytes(b"solid, but nothing follows")
    return folder


@pytest.fixture(scope="module")
def expected(
    meshes: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    """An uninterrupted run in this process."""
    root = tmp_path_factory.mktemp("expected")
    summary = generate(meshes, root, small_config(cache))
    assert (summary.produced, summary.failed) == (4, 1)
    assert_whole(root)
    return contents(root)


def test_batches_change_nothing(
    meshes: Path, cache: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    generate(meshes, tmp_path, small_config(cache, block=1))
    assert contents(tmp_path) == expected


def test_the_cache_changes_nothing(
    meshes: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    generate(meshes, tmp_path, small_config(None, block=4))
    assert contents(tmp_path) == expected


def test_two_workers_and_another_order_change_nothing(
    meshes: Path, cache: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    reverse = sorted(meshes.iterdir(), reverse=True)
    generate(reverse, tmp_path, small_config(cache, workers=2, block=5))
    assert contents(tmp_path) == expected


def test_another_seed_changes_the_grasps(
    meshes: Path, cache: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    generate(meshes, tmp_path, small_config(cache, seed=6))
    tables = [name for name in expected if name.endswith(".parquet")]
    changed = contents(tmp_path)
    assert len(tables) == 2 * 4  # grasps and contacts
    assert all(changed[name] != expected[name] for name in tables)


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_killed_at_any_moment_and_started_again(
    workers: str, meshes: Path, cache: Path, expected: dict[str, bytes], tmp_path: Path
) -> None:
    """Killed after a random time, from the first file on, until a run gets through."""
    moments = random.Random(f"moments {workers}")
    command = ("generate", meshes, "--out", tmp_path, "--workers", workers, *FLAGS)
    kills = 0
    for _ in range(6):
        run = Command(*command, cache=cache)
        run.wait_for(PARTIAL, tmp_path)
        time.sleep(moments.uniform(0.0, 1.5))
        kills += run.process.poll() is None
        run.kill()
        run.assert_no_orphans()
        if (tmp_path / "objects").is_dir():
            assert_whole(tmp_path)
    assert kills > 0
    last = Command(*command, cache=cache).finish()
    assert last.code == 0, last.err
    assert contents(tmp_path) == expected
