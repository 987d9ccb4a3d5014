"""The whole pipeline on real stages: what fails costs itself alone, and is named."""

import errno
import multiprocessing
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gmdx.dataset.read import grasps_in, read_dataset
from gmdx.errors import CatalogError, ConfigError, GripperError
from gmdx.files.folder import PARTIAL, OutputError, StorageError
from gmdx.machine.progress import Progress
from gmdx.metrics.compute import compute_metrics
from gmdx.metrics.table import METRIC_NAMES, METRICS
from gmdx.pipeline.generate import GenerateConfig, generate
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.settle import SettleConfig, settle
from gmdx.trials.protocol import TrialConfig
from gmdx.trials.run import run_trials
from tests.runs import assert_whole, contents, small_config, write_meshes


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def root(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    generate(write_meshes(folder / "meshes"), folder / "out", small_config(cache))
    return folder


def test_every_grasp_has_its_row(root: Path) -> None:
    dataset = read_dataset(root / "out")
    table = dataset.grasps()
    assert len(dataset.objects) == 3
    assert table.num_rows == dataset.info["counts"]["grasps"] == 3 * 2 * 6
    assert dataset.info["status"] == "complete"
    assert set(METRIC_NAMES) <= set(table.column_names)
    for row in table.to_pylist():
        assert row["outcome"] == row["outcomes"][0]
        assert len(row["outcomes"]) == 2
        assert row["sim_success"] == row["outcomes"].count("success") / row["valid_trials"]
    for metric in METRICS:
        if metric.name.endswith("_norm"):
            plain = table[metric.name.removesuffix("_norm")].to_numpy()
            ratio = plain / table["bound_l"].to_numpy()
            np.testing.assert_array_equal(table[metric.name].to_numpy(), ratio)


def test_a_dataset_is_made_under_its_physics_and_its_scenes_bring_it_along(
    root: Path, cache: Path, tmp_path: Path
) -> None:
    """Settling, trials and metrics all go by the one setting, and so does whoever reads it back."""
    physics = PhysicsConfig(timestep=0.002, patch_radius=0.01)
    config = small_config(cache, grasps=12, scenes=1, physics=physics)
    mesh = root / "meshes" / "box0.stl"
    generate(mesh, tmp_path, config)
    dataset = read_dataset(tmp_path)
    (object_id,) = dataset.objects
    scene, rows = dataset.scene(object_id, 0).scene, dataset.grasps(object_id)
    assert scene.physics == physics
    settled = settle(dataset.object(object_id), config.seed, physics=physics)
    np.testing.assert_array_equal(scene.position, settled.position)
    grasps = grasps_in(rows)
    trials = run_trials(scene, grasps, trials=config.trials)
    table = compute_metrics(scene, grasps, trials)
    plain = replace(scene, physics=PhysicsConfig())
    other = compute_metrics(plain, grasps, run_trials(plain, grasps, trials=config.trials))
    for name in ("force", "moved", "g_quality"):
        np.testing.assert_array_equal(rows[name].to_numpy(), table[name], err_msg=name)
        assert not np.array_equal(rows[name].to_numpy(), other[name], equal_nan=True), name


def test_stored_scenes_are_what_was_simulated(root: Path) -> None:
    """Metrics that need only the object and the grasp follow from what is on disk."""
    dataset = read_dataset(root / "out")
    for object_id in dataset.objects:
        for scene_id in dataset.scenes(object_id):
            view = dataset.scene(object_id, scene_id)
            rows = dataset.grasps(object_id, scene_id)
            centers = np.stack([rows[axis].to_numpy() for axis in "xyz"], axis=1)
            distance = np.linalg.norm(centers - view.scene.position, axis=1)
            np.testing.assert_allclose(rows["g_dis"].to_numpy(), distance, atol=1e-12)
            lowest = view.scene.to_world(view.scene.object.vertices)[:, 2].min()
            assert abs(lowest) < 1e-3
            assert view.images[0].segmentation.any()


def test_costs_are_kept_apart(root: Path) -> None:
    dataset = read_dataset(root / "out")
    cost = dataset.cost(dataset.objects[0])
    assert cost["grasps"] == 12
    stages = {"prepare", "settle", "render", "sample", "trials", "metrics", "write"}
    assert set(cost["cpu_seconds"]) == set(cost["wall_seconds"]) == stages
    assert 0 < cost["trials"]["step_seconds"] < cost["trials"]["seconds"]
    described = (root / "out" / "objects" / dataset.objects[0] / "object.json").read_text()
    assert "seconds" not in described


def test_bad_meshes_are_failures_and_the_others_are_unharmed(
    root: Path, cache: Path, tmp_path: Path
) -> None:
    bad = {
        "empty.obj": b"",
        "garbage.stl": os.urandom(1000),
        "text.ply": b"dear diary",
        "single.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n",
        "gone.off": b"OFF\n4 4 0\n0 0 0\n",
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
    meshes = sorted((root / "meshes").iterdir())
    objects = [tmp_path / name for name in bad] + meshes
    summary = generate(objects, tmp_path / "out", small_config(cache))
    assert (summary.requested, summary.produced, summary.failed) == (9, 3, 6)
    failures = read_dataset(tmp_path / "out").failures
    assert len(failures) == 6
    assert {failure.object_id.split("-")[0] + ".obj" for failure in failures} >= {"nan.obj"}
    for failure in failures:
        assert failure.stage == "prepare"
        assert failure.error.endswith("Error")
        assert len(failure.message) > 10
    assert_whole(tmp_path / "out")
    before, after = contents(root / "out"), contents(tmp_path / "out")
    for name in before:
        if name.startswith("objects/"):
            assert after[name] == before[name]


def test_a_scene_that_never_settles_costs_only_itself(
    root: Path, cache: Path, tmp_path: Path
) -> None:
    """With a time limit between two scenes' settling times, one of the two fails."""
    dataset = read_dataset(root / "out")
    object_id = dataset.objects[0]
    times = [dataset.scene(object_id, k).scene.settle_time for k in (0, 1)]
    assert times[0] != times[1]
    slow = int(np.argmax(times))
    mesh = next(p for p in (root / "meshes").iterdir() if object_id.startswith(p.stem))
    config = small_config(cache, settle=SettleConfig(max_time=float(np.mean(times))))
    summary = generate(mesh, tmp_path, config)
    assert (summary.produced, summary.failed, summary.counts["failures"]) == (1, 0, 1)
    again = read_dataset(tmp_path)
    assert again.scenes(object_id) == (1 - slow,)
    (failure,) = again.failures
    assert (failure.object_id, failure.scene_id, failure.stage) == (object_id, slow, "settle")
    assert failure.error == "SceneError"
    kept, before = (d.grasps(object_id, 1 - slow).to_pylist() for d in (again, dataset))
    assert repr(kept) == repr(before)  # NaN, which equals nothing, included


def test_an_object_without_any_scene_is_a_failure(cache: Path, tmp_path: Path) -> None:
    config = small_config(cache, settle=SettleConfig(max_time=0.02))
    summary = generate(write_meshes(tmp_path / "meshes", 1), tmp_path / "out", config)
    assert (summary.produced, summary.failed) == (0, 1)
    failures = read_dataset(tmp_path / "out").failures
    assert [failure.scene_id for failure in failures] == [None, 0, 1]
    assert not list((tmp_path / "out" / "objects").iterdir())


@pytest.mark.slow
def test_a_killed_worker_costs_one_object_and_the_next_run_mends_it(
    cache: Path, tmp_path: Path
) -> None:
    meshes = write_meshes(tmp_path / "meshes", 4)
    config = small_config(cache, workers=2)

    def kill_one(progress: Progress) -> None:
        if progress.done == 1:
            victim = multiprocessing.active_children()[0]
            victim.kill()

    summary = generate(meshes, tmp_path / "out", config, on_progress=kill_one)
    assert (summary.produced, summary.failed) == (3, 1)
    (failure,) = read_dataset(tmp_path / "out").failures
    assert (failure.stage, failure.error, failure.scene_id) == ("worker", "WorkerCrash", None)
    assert "SIGKILL" in failure.message
    assert_whole(tmp_path / "out")
    assert not multiprocessing.active_children()

    again = generate(meshes, tmp_path / "out", config)
    assert (again.produced, again.present, again.failed) == (1, 3, 0)
    generate(meshes, tmp_path / "whole", replace(config, workers=1))
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_full_disk_stops_the_run_and_keeps_what_is_complete(
    workers: int, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one process the third object's mesh cannot be written; with two, the root's files."""
    meshes = write_meshes(tmp_path / "meshes", 4)
    config = small_config(cache, workers=workers)
    written = 0
    real = os.fsync

    def fills_up(descriptor: int) -> None:
        nonlocal written
        written += 1
        if written > 15:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(descriptor)

    def full_after_two(progress: Progress) -> None:
        if workers == 2 and progress.done == 2:
            monkeypatch.setattr(os, "fsync", fills_up)
            nonlocal written
            written = 15

    if workers == 1:
        monkeypatch.setattr(os, "fsync", fills_up)
    with pytest.raises(StorageError, match="No space left on device; free some space"):
        generate(meshes, tmp_path / "out", config, on_progress=full_after_two)
    monkeypatch.undo()
    assert not (tmp_path / "out" / PARTIAL).exists()
    assert not multiprocessing.active_children()
    assert_whole(tmp_path / "out")
    present = len(list((tmp_path / "out" / "objects").iterdir()))
    assert 0 < present < 4
    summary = generate(meshes, tmp_path / "out", config)
    assert (summary.produced, summary.present) == (4 - present, present)


def test_a_dataset_grows_by_more_objects(root: Path, cache: Path, tmp_path: Path) -> None:
    meshes = sorted((root / "meshes").iterdir())
    generate(meshes[:1], tmp_path, small_config(cache))
    summary = generate(meshes[1:], tmp_path, small_config(cache))
    assert (summary.produced, summary.present) == (2, 0)
    assert contents(tmp_path) == contents(root / "out")


def test_a_folder_that_holds_the_output_gives_the_same_run_again(
    cache: Path, tmp_path: Path
) -> None:
    write_meshes(tmp_path, 1)
    for present in (0, 1):
        summary = generate(tmp_path, tmp_path / "out", small_config(cache))
        assert (summary.requested, summary.present) == (1, present)


def test_options_that_change_results_cannot_be_mixed(root: Path, cache: Path) -> None:
    meshes = sorted((root / "meshes").iterdir())
    before = contents(root / "out")
    for change, message in (
        ({"seed": 6}, "seed: 5 -> 6"),
        ({"grasps": 7}, "configuration.grasps: 6 -> 7"),
        ({"trial": TrialConfig(lift_height=0.1)}, "configuration.trial.lift_height: 0.08 -> 0.1"),
        ({"gripper": "franka_hand"}, "gripper.name"),
    ):
        with pytest.raises(OutputError, match=message):
            generate(meshes, root / "out", small_config(cache, **change))
    summary = generate(meshes, root / "out", small_config(cache, block=1, workers=2))
    assert (summary.produced, summary.present) == (0, 3)
    assert contents(root / "out") == before


def test_the_same_id_with_another_content_is_refused(
    root: Path, cache: Path, tmp_path: Path
) -> None:
    meshes = sorted((root / "meshes").iterdir())[:1]
    generate(meshes, tmp_path, small_config(cache))
    (folder,) = (tmp_path / "objects").iterdir()
    path = folder / "object.json"
    path.write_text(path.read_text().replace('"sha256": "', '"sha256": "0'))
    with pytest.raises(OutputError, match="another content"):
        generate(meshes, tmp_path, small_config(cache))
    path.write_text("{}")
    with pytest.raises(OutputError, match="is damaged; remove its folder"):
        generate(meshes, tmp_path, small_config(cache))


def test_what_cannot_be_asked_for(cache: Path, tmp_path: Path) -> None:
    mesh = write_meshes(tmp_path / "meshes", 1)
    with pytest.raises(CatalogError):
        generate(tmp_path / "nowhere", tmp_path / "out", small_config(cache))
    with pytest.raises(GripperError, match="parallel_jaw"):
        generate(mesh, tmp_path / "out", small_config(cache, gripper="tentacle"))
    assert not (tmp_path / "out").exists()
    for options, message in (
        ({"grasps": 0}, "grasps must be at least 1"),
        ({"workers": 0}, "workers must be at least 1"),
        ({"sampler": "psychic"}, "dense, antipodal"),
        ({"engine": "bullets"}, "unknown engine 'bullets'; give one of"),
        ({"trials": 0}, "trials must be at least 1"),
    ):
        with pytest.raises(ConfigError, match=message):
            GenerateConfig(**options)
