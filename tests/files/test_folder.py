"""A run's folder: one run at a time, nothing half-written in place, nothing of others touched."""

import contextlib
import errno
import fcntl
import json
import logging
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from gmdx.files.folder import PARTIAL, Kind, OutputError, RunFolder, StorageError
from gmdx.files.formats import write_npz, write_parquet, write_ply, write_text
from gmdx.files.lock import FileLock, LockedError

SOUP = Kind("soup", "soup.json", folders=("bowls",))
SALAD = Kind("salad", "salad.json")
HEADER = {"salt": 2, "herbs": {"parsley": 1, "dill": 0}}


def contents(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def put(folder: RunFolder, name: str, text: str) -> None:
    with folder.replacing(name) as path:
        write_text(path, text)


def fail_half_way(folder: RunFolder, name: str) -> None:
    with folder.replacing(name) as path:
        write_text(path, "thr")
        raise ValueError("there is no third one")


def put_on_full_disk(folder: RunFolder, name: str) -> None:
    with folder.replacing(name) as path:
        path.symlink_to("/dev/full")
        write_text(path, "nothing of this fits")


def test_header_says_what_the_folder_holds(tmp_path: Path) -> None:
    with RunFolder(tmp_path / "a" / "b", SOUP, HEADER, state={"status": "running"}) as folder:
        header = json.loads((folder.root / "soup.json").read_text())
        assert header == {"kind": "soup", **HEADER, "status": "running"}
        folder.write_header({"status": "complete"})
    assert list(contents(tmp_path)) == ["a/b/soup.json"]
    assert json.loads((tmp_path / "a/b/soup.json").read_text())["status"] == "complete"
    RunFolder(tmp_path / "a" / "b", SOUP, HEADER, state={"status": "running"}).close()


def test_a_header_from_before_kinds_were_named_is_continued(tmp_path: Path) -> None:
    (tmp_path / "soup.json").write_text(json.dumps(HEADER))
    RunFolder(tmp_path, SOUP, HEADER).close()


def test_other_settings_are_refused_by_name(tmp_path: Path) -> None:
    RunFolder(tmp_path, SOUP, HEADER).close()
    before = contents(tmp_path)
    other = {"salt": 3, "herbs": {"parsley": 1, "chives": 2}}
    with pytest.raises(OutputError, match="holds a soup made otherwise") as refusal:
        RunFolder(tmp_path, SOUP, other)
    for line in ("salt: 2 -> 3", "herbs.dill: 0 -> null", "herbs.chives: null -> 2"):
        assert line in str(refusal.value)
    assert "parsley" not in str(refusal.value)
    many = {f"spice{k}": "x" * 1000 for k in range(100)}
    with pytest.raises(OutputError, match="and 88 more") as refusal:
        RunFolder(tmp_path, SOUP, HEADER | many)
    assert len(str(refusal.value)) < 3000
    assert contents(tmp_path) == before


def test_what_is_something_else_is_refused_and_left_alone(tmp_path: Path) -> None:
    salad, notes, file = tmp_path / "salad", tmp_path / "notes", tmp_path / "file"
    RunFolder(salad, SALAD, HEADER).close()
    notes.mkdir()
    (notes / "thesis.tex").write_text("years of work")
    file.write_text("")
    before = contents(tmp_path)
    with pytest.raises(OutputError, match="salad holds a salad and no soup; give a new folder"):
        RunFolder(salad, SOUP, HEADER)
    with pytest.raises(OutputError, match=r"not empty and no soup \(it holds 'thesis\.tex'\)"):
        RunFolder(notes, SOUP, HEADER)
    with pytest.raises(OutputError, match="it is no folder"):
        RunFolder(file, SOUP, HEADER)
    assert contents(tmp_path) == before
    assert not (notes / PARTIAL).exists()


def test_a_run_killed_before_its_header_leaves_a_folder_that_can_be_taken_up(
    tmp_path: Path,
) -> None:
    (tmp_path / PARTIAL / "run-1").mkdir(parents=True)
    (tmp_path / "bowls").mkdir()
    RunFolder(tmp_path, SOUP, HEADER).close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bowls", "soup.json"]


_OTHER_PROCESS = """
import sys
from gmdx.files.folder import Kind, RunFolder
folder = RunFolder(sys.argv[1], Kind("soup", "soup.json"), {"salt": 2})
folder.attempt("bowl").mkdir()
print("here", flush=True)
sys.stdin.read()
"""


def test_a_second_process_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _OTHER_PROCESS, str(tmp_path)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "here\n"
        (theirs,) = tmp_path.glob(f"{PARTIAL}/run-*/*-bowl")
        with pytest.raises(OutputError, match=f"another run .process {other.pid} on") as refusal:
            RunFolder(tmp_path, SOUP, {"salt": 2})
        assert f"the soup in {tmp_path}" in str(refusal.value)
        assert theirs.is_dir()
        other.kill()
        other.communicate()
    with RunFolder(tmp_path, SOUP, {"salt": 2}):
        assert not theirs.exists(), "what a dead run left is removed"
    assert not (tmp_path / PARTIAL).exists()


def test_no_two_attempts_share_a_path(tmp_path: Path) -> None:
    seen = set()
    for _ in range(3):
        with RunFolder(tmp_path, SOUP, HEADER) as folder:
            for name in ("bowl", "bowl", "b" * 255):
                attempt = folder.attempt(name)
                attempt.mkdir()
                assert attempt.name.endswith(name[-60:])
                seen.add(attempt)
    assert len(seen) == 9


def test_an_attempt_comes_into_place_whole_or_goes(tmp_path: Path) -> None:
    with RunFolder(tmp_path, SOUP, HEADER) as folder:
        good, bad = folder.attempt("bowl"), folder.attempt("bowl")
        for attempt in (good, bad):
            attempt.mkdir()
            write_text(attempt / "spoon", "silver")
        folder.discard(bad)
        folder.discard(folder.attempt("never written"))
        assert not bad.exists()
        folder.publish(good, "bowls/mine")
        put(folder, "deep/er/note", "one")
        put(folder, "deep/er/note", "two")
        with pytest.raises(ValueError, match="no third one"):
            fail_half_way(folder, "deep/er/note")
    assert contents(tmp_path) == {
        "soup.json": (tmp_path / "soup.json").read_bytes(),
        "bowls/mine/spoon": b"silver",
        "deep/er/note": b"two",
    }


def test_the_one_rule_content_then_name_then_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever was written, and by whom: all of it is on the disk before its name is."""
    calls: list[tuple[str, int]] = []
    fsync, replace = os.fsync, os.replace

    def watched_fsync(descriptor: int) -> None:
        calls.append(("sync", os.fstat(descriptor).st_ino))
        fsync(descriptor)

    def watched_replace(source: Path, target: Path) -> None:
        calls.append(("rename", Path(source).stat().st_ino))
        replace(source, target)

    with RunFolder(tmp_path, SOUP, HEADER) as folder:
        attempt = folder.attempt("bowl")
        (attempt / "inner").mkdir(parents=True)
        write_npz(attempt / "inner" / "a.npz", {})
        write_ply(attempt / "b.ply", np.zeros((0, 3)), np.zeros((0, 3), int))
        table = pa.table({"x": [1]})
        write_parquet(attempt / "c.parquet", [table], table.schema)
        inside = {path.stat().st_ino for path in (attempt, *attempt.rglob("*"))}
        monkeypatch.setattr(os, "fsync", watched_fsync)
        monkeypatch.setattr(os, "replace", watched_replace)
        folder.publish(attempt, "new/bowl")
        monkeypatch.undo()
        new, root = ((tmp_path / name).stat().st_ino for name in ("new", "."))
    (renamed,) = [k for k, (call, _) in enumerate(calls) if call == "rename"]
    assert {inode for _, inode in calls[:renamed]} == inside | {root}
    assert calls[renamed + 1 :] == [("sync", new)]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_a_full_disk_is_named_and_nothing_comes_into_place(tmp_path: Path) -> None:
    with RunFolder(tmp_path, SOUP, HEADER) as folder:
        with pytest.raises(StorageError, match="No space left on device; free some space"):
            put_on_full_disk(folder, "note")
        assert not (tmp_path / "note").is_symlink()
        put(folder, "note", "room again")
    assert (tmp_path / "note").read_text() == "room again"


@pytest.fixture
def lockless(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file system without locks, which there is none of on most machines."""

    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", flock)


@pytest.mark.usefixtures("lockless")
def test_without_locks_the_log_says_so_and_each_run_removes_its_own(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    killed = tmp_path / PARTIAL / "run-killed"
    killed.mkdir(parents=True)
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        first = RunFolder(tmp_path, SOUP, HEADER)
    assert "cannot be locked (No locks available): start no second run there" in caplog.text
    assert f"{PARTIAL} stays" in caplog.text
    mine = first.attempt("bowl")
    mine.mkdir()
    write_text(mine / "spoon", "mine")
    with RunFolder(tmp_path, SOUP, HEADER) as second:
        theirs = second.attempt("bowl")
        assert theirs != mine
        theirs.mkdir()
        write_text(theirs / "spoon", "theirs")
        second.publish(theirs, "bowls/one")
    assert mine.is_dir()
    with caplog.at_level(logging.WARNING, logger="gmdx"):
        first.publish(mine, "bowls/one")
    assert "came into place by another run; it stays" in caplog.text
    first.close()
    assert (tmp_path / "bowls" / "one" / "spoon").read_text() == "theirs"
    assert killed.is_dir()
    assert {path.name for path in (tmp_path / PARTIAL).iterdir()} == {"run-killed", "lock"}


def test_a_lock_on_a_file_that_its_holder_has_just_removed_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One opens the file, another who holds it removes it and lets go, then the one locks it."""
    path = tmp_path / "partial" / "lock"
    first, flock = FileLock(path), fcntl.flock

    def late(descriptor: int, operation: int) -> None:
        monkeypatch.undo()
        first.release()
        path.parent.rmdir()
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    second = FileLock(path)
    with pytest.raises(LockedError, match=f"process {os.getpid()}"):
        FileLock(path)
    second.release()
    FileLock(path).release()


def _take_and_give_back(path: Path, rounds: int, taken: "multiprocessing.Queue[int]") -> None:
    """Hold the lock again and again; a mark that is there already says that another holds it."""
    count = 0
    for _ in range(rounds):
        try:
            lock = FileLock(path)
        except LockedError:
            continue
        mark = path.parent.parent / "mark"
        os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
        mark.unlink()
        lock.release()
        with contextlib.suppress(OSError):
            path.parent.rmdir()
        count += 1
    taken.put(count)


def test_only_one_of_many_ever_holds_a_lock(tmp_path: Path) -> None:
    """Though its file, and the folder of it, come and go."""
    context = multiprocessing.get_context("spawn")
    taken: multiprocessing.Queue[int] = context.Queue()
    arguments = (tmp_path / "partial" / "lock", 200, taken)
    crowd = [context.Process(target=_take_and_give_back, args=arguments) for _ in range(3)]
    for one in crowd:
        one.start()
    for one in crowd:
        one.join()
    assert [one.exitcode for one in crowd] == [0, 0, 0]
    assert sum(taken.get() for _ in crowd) > 10
