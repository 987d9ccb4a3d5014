"""The dataset's folder: atomic, resumable, and the same bytes for the same content."""

import errno
import hashlib
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gmdx.dataset import schema, store, write
from gmdx.dataset.store import DatasetStore, read_failures
from gmdx.errors import DatasetError, Failure
from gmdx.files import formats as files
from gmdx.files.folder import PARTIAL, OutputError, StorageError
from gmdx.scenes.camera import render
from tests.dataset.hand_built import (
    CAMERA,
    EVIDENCE,
    HEADER,
    grasps_of,
    scene_of,
    table_of,
    trials_of,
    write_dataset,
    write_object,
)


def contents(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def put(kept: DatasetStore, object_id: str) -> None:
    attempt = kept.attempt(object_id)
    write_object(attempt, object_id)
    kept.publish(attempt, object_id)


def test_same_content_gives_same_bytes(tmp_path: Path) -> None:
    write_dataset(tmp_path / "a", "mug", "bowl")
    write_dataset(tmp_path / "b", "bowl", "mug")
    assert contents(tmp_path / "a") == contents(tmp_path / "b")
    assert not (tmp_path / "a" / PARTIAL).exists()


def test_bytes_do_not_depend_on_batches(tmp_path: Path) -> None:
    for batch in (1, 999, 4096, 9001):
        write_object(tmp_path / str(batch), "mug", grasps=9001 if batch > 1 else 3, batch=batch)
    one, two, three = (contents(tmp_path / name) for name in ("999", "4096", "9001"))
    assert one == two == three


def test_what_a_killed_run_left_is_removed_and_the_rest_stays(tmp_path: Path) -> None:
    root = tmp_path / "data"
    write_dataset(tmp_path / "whole", "mug", "bowl")
    with DatasetStore(root, HEADER) as kept:
        put(kept, "mug")
    left = root / PARTIAL / "run-of-the-dead" / "1-bowl"
    left.mkdir(parents=True)
    (left / "mesh.ply").write_bytes(b"ply, and then the power went")
    with DatasetStore(root, HEADER) as kept:
        assert kept.complete() == {"mug"}
        assert not left.exists()
        put(kept, "bowl")
        failure = Failure("cup", None, "prepare", "MeshError", "no faces")
        kept.finish([failure], sources={"mug", "bowl", "cup"})
    assert contents(root) == contents(tmp_path / "whole")


def test_an_object_that_has_lost_a_file_is_not_complete(tmp_path: Path) -> None:
    write_dataset(tmp_path, "mug")
    table = tmp_path / schema.OBJECTS_FOLDER / "mug" / schema.GRASPS_FILE
    table.unlink()
    with (
        DatasetStore(tmp_path, HEADER) as store,
        pytest.raises(OutputError, match=r"mug has no grasps\.parquet.*remove that folder"),
    ):
        store.complete()


def test_a_new_folder_killed_before_its_header_can_be_taken_up(tmp_path: Path) -> None:
    (tmp_path / PARTIAL).mkdir()
    (tmp_path / "objects").mkdir()
    with DatasetStore(tmp_path, HEADER):
        assert json.loads((tmp_path / "dataset.json").read_text())["status"] == "running"


def test_scene_failures_of_produced_objects_survive_a_restart(tmp_path: Path) -> None:
    write_dataset(tmp_path, "mug")
    with DatasetStore(tmp_path, HEADER) as again:
        counts = again.finish([], sources={"mug"})
    assert [(f.object_id, f.scene_id) for f in read_failures(tmp_path)] == [
        ("cup", None),  # of the earlier run, which this one was not asked to repeat
        ("mug", 2),
    ]
    assert counts == {"objects": 1, "scenes": 2, "grasps": 20, "failures": 2}


def test_a_failure_that_was_mended_is_forgotten(tmp_path: Path) -> None:
    write_dataset(tmp_path, "mug")
    with DatasetStore(tmp_path, HEADER) as again:
        put(again, "cup")
        again.finish([], sources={"mug", "cup"})
    assert {f.scene_id for f in read_failures(tmp_path)} == {2}


def test_another_configuration_is_refused_by_name(tmp_path: Path) -> None:
    write_dataset(tmp_path, "mug")
    before = contents(tmp_path)
    changed = {"seed": 3, "configuration": {"grasps": 10, "trial": {"step": 0.002}}}
    with pytest.raises(OutputError, match=r"configuration\.trial\.step: 0\.004 -> 0\.002"):
        DatasetStore(tmp_path, changed)
    with pytest.raises(OutputError, match="seed: 3 -> 4"):
        DatasetStore(tmp_path, {**HEADER, "seed": 4})
    assert contents(tmp_path) == before
    DatasetStore(tmp_path, HEADER).close()  # and the lock is free again


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        DatasetStore(tmp_path, HEADER)
    assert contents(tmp_path) == {"thesis.tex": b"years of work"}


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match=r"cannot use .*it is no folder"):
        DatasetStore(tmp_path / "out", HEADER)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(DatasetError, match="Permission denied"):
            DatasetStore(tmp_path / "out", HEADER)
        with pytest.raises(DatasetError, match="Permission denied"):
            DatasetStore(tmp_path, HEADER)
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a file system of the kernel's")
def test_a_file_system_that_takes_no_files_is_refused() -> None:
    for path in ("/proc/gmdx", "/proc/self/task"):
        with pytest.raises(OutputError, match=r"cannot use|not empty"):
            DatasetStore(path, HEADER)


def test_two_runs_cannot_write_one_folder(tmp_path: Path) -> None:
    with (
        DatasetStore(tmp_path, HEADER),
        pytest.raises(OutputError, match="another run"),
    ):
        DatasetStore(tmp_path, HEADER)
    DatasetStore(tmp_path, HEADER).close()


def test_a_full_disk_is_named_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every wait for the disk fails, whichever file that is about."""

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with DatasetStore(tmp_path, HEADER) as kept:
        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(StorageError, match=r"No space left on device; free some space"):
            put(kept, "mug")
        with pytest.raises(StorageError):
            kept.finish([], sources=set())
        monkeypatch.undo()
    assert not (tmp_path / PARTIAL).exists()
    assert not list((tmp_path / "objects").iterdir())
    assert json.loads((tmp_path / "dataset.json").read_text())["status"] == "running"


def test_a_scene_that_fails_half_way_leaves_nothing(tmp_path: Path) -> None:
    """Dropped at any point, and written anew, it is as if it had never begun."""
    scene, grasps = scene_of("mug"), grasps_of(5)
    images = [render(scene, view=view, config=CAMERA) for view in range(CAMERA.views)]
    writer = write.ObjectWriter(tmp_path / "mug", scene.object)
    writer.drop_scene()
    for blocks in (0, 1, 2):
        writer.begin_scene(scene, images)
        for _ in range(blocks):
            writer.add_grasps(grasps, trials_of(grasps), table_of(grasps))
        writer.drop_scene()
        assert writer.grasps == 0
        assert not list((tmp_path / "mug").iterdir())


def test_a_dropped_scene_leaves_the_others_as_they_are(tmp_path: Path) -> None:
    for name, dropped in (("a", False), ("b", True)):
        first = scene_of("mug")
        writer = write.ObjectWriter(tmp_path / name, first.object)
        for scene_id in (0, 1, 2):
            scene, grasps = scene_of("mug", scene_id), grasps_of(5)
            if scene_id == 1 and not dropped:
                continue
            writer.begin_scene(scene, [render(scene, config=CAMERA)])
            writer.add_grasps(grasps, trials_of(grasps), table_of(grasps))
            if scene_id == 1:
                writer.drop_scene()
            else:
                writer.end_scene()
        assert writer.grasps == 10
        writer.close(failures=[], evidence=EVIDENCE)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_calls_out_of_turn_are_refused(tmp_path: Path) -> None:
    scene, grasps = scene_of("mug"), grasps_of(2)
    writer = write.ObjectWriter(tmp_path / "mug", scene.object)
    for call in (
        writer.end_scene,
        lambda: writer.add_grasps(grasps, trials_of(grasps), table_of(grasps)),
    ):
        with pytest.raises(DatasetError, match="no scene of 'mug' is open"):
            call()
    writer.begin_scene(scene, [render(scene, config=CAMERA)])
    with pytest.raises(DatasetError, match="scene 0 of 'mug' is still open"):
        writer.begin_scene(scene, [])
    without = replace(table_of(grasps), contacts=None)
    with pytest.raises(DatasetError, match="lack the analytical contacts"):
        writer.add_grasps(grasps, trials_of(grasps), without)


def test_columns_must_fit_the_schema() -> None:
    grasps = grasps_of(2)
    table = table_of(grasps)
    values = dict(table.values)
    values["colour"] = values.pop("force")
    with pytest.raises(DatasetError, match=r"missing \['force'\], unknown \['colour'\]"):
        write.grasp_rows(scene_of("mug"), grasps, replace(table, values=values))


def test_manifests_name_the_content_of_every_file(tmp_path: Path) -> None:
    write_object(tmp_path / "mug", "mug")
    said = json.loads((tmp_path / "mug" / "object.json").read_text())["files"]
    for path in (tmp_path / "mug").iterdir():
        if path.name not in ("object.json", "cost.json"):
            assert said.pop(path.name) == hashlib.sha256(path.read_bytes()).hexdigest()
    assert said == {}


def test_damage_in_failures_is_named_but_a_cut_last_line_is_not_damage(tmp_path: Path) -> None:
    path = tmp_path / store.schema.FAILURES_FILE
    line = store._line(Failure("cup", 1, "settle", "SceneError", "it rolled"))
    path.write_text(line + line[:20])
    assert len(read_failures(tmp_path)) == 1
    path.write_text("garbage\n" + line)
    with pytest.raises(DatasetError, match="line 1"):
        read_failures(tmp_path)


def test_a_line_that_a_kill_cut_is_gone_before_others_follow(tmp_path: Path) -> None:
    lost = [Failure(name, None, "prepare", "MeshError", "no faces") for name in ("cup", "jug")]
    path = tmp_path / schema.FAILURES_FILE
    with DatasetStore(tmp_path, HEADER) as kept:
        kept.record(lost)
    path.write_text(path.read_text()[:-20])
    with DatasetStore(tmp_path, HEADER) as kept:
        kept.record(lost[1:])
        kept.record(lost[1:])
        kept.finish([], sources=set())
    assert read_failures(tmp_path) == lost


def test_ply_reads_back_exactly_here_and_elsewhere(tmp_path: Path) -> None:
    import trimesh

    rng = np.random.default_rng(0)
    mesh = trimesh.creation.icosphere(subdivisions=1)
    vertices = np.asarray(mesh.vertices) + rng.normal(scale=1e-3, size=mesh.vertices.shape)
    files.write_ply(tmp_path / "m.ply", vertices, np.asarray(mesh.faces, np.int64))
    read, faces = files.read_ply(tmp_path / "m.ply")
    np.testing.assert_array_equal(read, vertices)
    np.testing.assert_array_equal(faces, mesh.faces)
    other = trimesh.load_mesh(tmp_path / "m.ply", process=False)
    np.testing.assert_array_equal(other.vertices, vertices)
    np.testing.assert_array_equal(other.faces, mesh.faces)
