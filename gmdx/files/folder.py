"""A folder that one run writes: locked, taken up again, and never with half a thing in it.

Datasets and studies stand on it:

```
<root>/
  <header>                what the folder holds, and everything that its results depend on
  ...                     what is complete; it came into place by renaming
  .partial/               while a run goes on: its lock, and what is not complete
    run-<unique>/         of one run
      <number>-<name>     one attempt at a file or folder: no two attempts ever share a path
```

Whatever is put into place follows one rule: what the files hold is on the disk, then the name
changes, then the folder's list of names is on the disk.
"""

import contextlib
import errno
import itertools
import json
import logging
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from gmdx.config import differences
from gmdx.errors import DatasetError, UsageError
from gmdx.files.formats import json_text, read_json, write_text
from gmdx.files.lock import FileLock, LockedError, NoLocksError

_LOG = logging.getLogger("gmdx")

RunFolderT = TypeVar("RunFolderT", bound="RunFolder")

PARTIAL = ".partial"  # folder inside the root for what is not complete yet
_LOCK = "lock"  # file in there
_NAMED = 12  # differences that a message names; it says how many more there are
_LENGTH = 160  # characters of each
_KEPT = 60  # characters of a name that an attempt's path shows


class OutputError(DatasetError, UsageError):
    """The output folder cannot take this run: foreign, unwritable, in use or configured else."""


class StorageError(DatasetError):
    """The disk refused a write."""


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the operating system refuses into a StorageError that says what to do."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        advice = "free some space" if full else "see to the disk"
        reason = error.strerror if error.strerror is not None else str(error)
        raise StorageError(
            f"cannot write to {path}: {reason}; {advice} and run the same command again: "
            "it continues after what is complete"
        ) from error


@dataclass(frozen=True)
class Kind:
    """A kind of run folder."""

    name: str  # in words, as in "this folder holds a dataset"
    header: str  # name of the file that says so
    folders: tuple[str, ...] = ()  # that may be there, empty, before the header is


class RunFolder:
    """A folder during one run; a context manager that holds its lock."""

    def __init__(
        self,
        root: str | Path,
        kind: Kind,
        header: Mapping[str, Any],
        *,
        state: Mapping[str, Any] | None = None,
    ) -> None:
        """Make `root` ready for a run, or take it up again.

        What runs that were killed left unfinished is removed.

        Args:
            root: The folder; created if it does not exist.
            kind: What it holds.
            header: Everything that the results depend on.
            state: What the header's file says besides, and may differ from run to run; such as
                how far the run got.

        Raises:
            OutputError: The folder holds something else, or the same made with another header;
                it is being written by another run, or cannot be written.
            StorageError: The disk refused.
        """
        self.root, self.kind = Path(root), kind
        self._header = {"kind": kind.name, **json.loads(json_text(header))}
        self._partial = self.root / PARTIAL
        self._own = self._partial / f"run-{uuid.uuid4().hex}"
        self._numbers = itertools.count(1)
        self._lock: FileLock | None = None  # None: the file system has no locks
        if self.root.exists() and not self.root.is_dir():
            raise OutputError(f"cannot use {self.root} for output: it is no folder; give another")
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self._refuse_foreign()
            self._take_lock()
        except OSError as error:
            raise OutputError(f"cannot use {self.root} for output: {error.strerror}") from error
        try:
            if self._lock is not None:
                self._clear()  # of runs that are dead, as this one holds the lock
            with writing(self.root):
                self._own.mkdir()
            self._begin({} if state is None else state)
        except BaseException:
            self.close()
            raise

    def __enter__(self: RunFolderT) -> RunFolderT:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove what is not complete and let other runs in."""
        shutil.rmtree(self._own, ignore_errors=True)
        if self._lock is not None:
            self._lock.release()
        with contextlib.suppress(OSError):  # another run is in there already
            self._partial.rmdir()

    def attempt(self, name: str) -> Path:
        """A path for a new file or folder, which nobody else is ever given; nothing is there yet.

        Args:
            name: What it will be; the path ends in the same letters, but is not named so.
        """
        return self._own / f"{next(self._numbers)}-{name[-_KEPT:]}"

    def publish(self, attempt: Path, name: str) -> None:
        """Put what was written into place: whole, or not at all.

        A file replaces the one that is there. A folder does not: where the file system has no
        locks, another run may have made the same meanwhile, and that one stays.

        Args:
            attempt: A path that `attempt` gave.
            name: Path inside the root.

        Raises:
            StorageError: The disk refused.
        """
        with writing(self.root / name):
            if not put_into_place(attempt, self.root / name):
                _LOG.warning("%s came into place by another run; it stays", self.root / name)
                self.discard(attempt)

    def discard(self, attempt: Path) -> None:
        """Remove what there is of an attempt that failed."""
        if attempt.is_dir():
            shutil.rmtree(attempt, ignore_errors=True)
        else:
            attempt.unlink(missing_ok=True)

    @contextlib.contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        """Write one file: under the path that is given, to come into place at the end.

        Args:
            name: Path of the file inside the root.

        Raises:
            StorageError: The disk refused.
        """
        attempt = self.attempt(Path(name).name)
        try:
            with writing(self.root / name):
                yield attempt
            self.publish(attempt, name)
        except BaseException:
            self.discard(attempt)
            raise

    def write_header(self, state: Mapping[str, Any]) -> None:
        """Write the header, with what else its file says now.

        Raises:
            StorageError: The disk refused.
        """
        with self.replacing(self.kind.header) as path:
            write_text(path, json_text({**self._header, **state}))

    def _take_lock(self) -> None:
        try:
            self._lock = FileLock(self._partial / _LOCK)
        except LockedError as error:
            raise OutputError(
                f"another run{error} is writing the {self.kind.name} in {self.root}; wait for it "
                "to end"
            ) from error
        except NoLocksError as error:
            _LOG.warning(
                "%s cannot be locked (%s): start no second run there; and what killed runs left "
                "in %s stays, as a living one may need it",
                self.root, error, self._partial,
            )  # fmt: skip

    def _refuse_foreign(self) -> None:
        """Refuse a folder with anything in it that is not of this kind."""
        if (self.root / self.kind.header).is_file():
            return
        known = (PARTIAL, *self.kind.folders)
        foreign = sorted(path.name for path in self.root.iterdir() if path.name not in known)
        if not foreign:
            return
        other = _kind_in(self.root)
        if other is not None:
            raise OutputError(
                f"{self.root} holds a {other} and no {self.kind.name}; give a new folder"
            )
        raise OutputError(
            f"{self.root} is not empty and no {self.kind.name} (it holds {foreign[0]!r}); give a "
            "new folder"
        )

    def _begin(self, state: Mapping[str, Any]) -> None:
        """Write the header of a new folder, or compare it with the one that is there."""
        path = self.root / self.kind.header
        if path.is_file():
            # Headers did not name their kind once; their file's name tells it.
            before = {"kind": self.kind.name, **read_json(path)}
            changed = differences({k: v for k, v in before.items() if k not in state}, self._header)
            if changed:
                named = [line[:_LENGTH] for line in changed[:_NAMED]]
                if len(changed) > _NAMED:
                    named.append(f"and {len(changed) - _NAMED} more")
                raise OutputError(
                    f"{self.root} holds a {self.kind.name} made otherwise: {'; '.join(named)}. "
                    "Give another folder, or the same options; name in the configuration what "
                    "`auto` stood for on another machine"
                )
            if not state:
                return
        self.write_header(state)

    def _clear(self) -> None:
        """Remove everything that is not complete, the lock left out."""
        with contextlib.suppress(OSError):  # it is in nobody's way
            for path in self._partial.iterdir():
                if path.name != _LOCK:
                    self.discard(path)


def put_into_place(attempt: Path, target: Path) -> bool:
    """Give what is written its name, and wait until all of it is on the disk: the one rule.

    Args:
        attempt: A file or folder, on the same file system.
        target: Its name from now on; folders above it that are missing are made.

    Returns:
        False where the target is a folder that is there already; the attempt is still there then.

    Raises:
        OSError: The disk refused.
    """
    _sync(attempt)
    _make_folder(target.parent)
    try:
        attempt.replace(target)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        return False
    _sync_one(target.parent)
    return True


def _kind_in(root: Path) -> str | None:
    """What a folder holds, as one of its headers says."""
    for path in sorted(root.glob("*.json")):
        with contextlib.suppress(DatasetError):
            kind = read_json(path).get("kind")
            if isinstance(kind, str):
                return kind
    return None


def _make_folder(folder: Path) -> None:
    """Make a folder and those above it that are missing, each with its name on the disk."""
    if not folder.is_dir():
        _make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        _sync_one(folder.parent)


def _sync(path: Path) -> None:
    """Wait until a file, or a folder with all that is in it, is on the disk."""
    if path.is_dir():
        for inside in path.iterdir():
            _sync(inside)
    _sync_one(path)


def _sync_one(path: Path) -> None:
    """Wait until a file's bytes, or a folder's list of names, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
