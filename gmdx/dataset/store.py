"""A dataset's folder while it is produced: locked, resumable, and never half-written."""

import contextlib
import errno
import fcntl
import json
import logging
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from gmdx.config import differences
from gmdx.dataset import schema
from gmdx.dataset.schema import Failure
from gmdx.errors import DatasetError, UsageError
from gmdx.files.formats import json_text, read_json, sync_folder, write_text

_log = logging.getLogger("gmdx")

PARTIAL = ".partial"  # folder inside the root for what is not complete yet
_RESULTS = (  # of an object; its costs may go missing
    schema.OBJECT_FILE,
    schema.MESH_FILE,
    schema.HULLS_FILE,
    schema.SCENES_FILE,
    schema.GRASPS_FILE,
)


class OutputError(DatasetError, UsageError):
    """The output folder cannot take this run: foreign, unwritable, in use or configured else."""


class StorageError(DatasetError):
    """The disk refused a write."""


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn what the operating system refuses into a StorageError that says what to do."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        advice = "free some space" if full else "see to the disk"
        reason = error.strerror if error.strerror is not None else str(error)
        raise StorageError(
            f"cannot write to {folder}: {reason}; {advice} and run the same command again: "
            "it continues after the objects that are complete"
        ) from error


class DatasetStore:
    """The root folder of a dataset during one run; a context manager that holds its lock.

    Objects are written into folders under `<root>/.partial` and renamed into place, so that
    `objects/` only ever holds complete ones. What a killed run left under `.partial` is
    removed at the start of the next.
    """

    def __init__(self, root: str | Path, header: Mapping[str, Any]) -> None:
        """Make `root` ready for a run, or take it up again.

        Args:
            root: The folder; created if it does not exist.
            header: What `dataset.json` says about the run: everything that results depend on.

        Raises:
            OutputError: The folder is not empty and not a dataset, cannot be written, is being
                written by another run, or holds a dataset made with another header.
        """
        self.root = Path(root)
        self.objects = self.root / schema.OBJECTS_FOLDER
        self._partial = self.root / PARTIAL
        self._header = {"schema_version": schema.SCHEMA_VERSION, **json.loads(json_text(header))}
        if self.root.exists() and not self.root.is_dir():
            raise OutputError(f"cannot use {self.root} for output: it is no folder; give another")
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self._refuse_foreign()
            self._lock = _locked(self.root)
        except OSError as error:
            raise OutputError(f"cannot use {self.root} for output: {error.strerror}") from error
        try:
            with writing(self.root):
                shutil.rmtree(self._partial, ignore_errors=True)
                self._partial.mkdir()
                self.objects.mkdir(exist_ok=True)
            self._begin()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "DatasetStore":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Remove what is not complete and let other runs in."""
        shutil.rmtree(self._partial, ignore_errors=True)
        os.close(self._lock)

    def complete(self) -> set[str]:
        """Ids of the objects that are in place.

        Raises:
            OutputError: One has lost a file, which no run does: objects come into place whole.
        """
        found = [folder for folder in self.objects.iterdir() if folder.is_dir()]
        for folder in sorted(found):
            lost = [name for name in _RESULTS if not (folder / name).is_file()]
            if lost:
                raise OutputError(
                    f"{folder} has no {', '.join(lost)}: the dataset is damaged; remove that "
                    "folder, and the same command makes the object anew"
                )
        return {folder.name for folder in found}

    def partial(self, object_id: str) -> Path:
        """Where to write an object before it is published; nothing is there yet."""
        return self._partial / "objects" / object_id

    def publish(self, object_id: str) -> None:
        """Put a written object into place.

        Raises:
            StorageError: The disk refused.
        """
        with writing(self.objects):
            self.partial(object_id).rename(self.objects / object_id)
            sync_folder(self.objects)

    def discard(self, object_id: str) -> None:
        """Remove what there is of an object that failed."""
        shutil.rmtree(self.partial(object_id), ignore_errors=True)

    def record(self, failures: Iterable[Failure]) -> None:
        """Append failures while the run goes on.

        Raises:
            StorageError: The disk refused.
        """
        path = self.root / schema.FAILURES_FILE
        with writing(path), path.open("a", encoding="utf-8", newline="\n") as file:
            file.writelines(_line(failure) for failure in failures)

    def finish(self, failures: Iterable[Failure], *, sources: set[str]) -> dict[str, int]:
        """Write the final failures and counts.

        Args:
            failures: Of the objects that this run did not produce.
            sources: Ids of every object that this run was asked for.

        Returns:
            The counts in `dataset.json`: objects, scenes, grasps, failures.

        Raises:
            StorageError: The disk refused.
        """
        everything = {failure.key: failure for failure in failures}
        counts = {"objects": 0, "scenes": 0, "grasps": 0}
        complete = self.complete()
        for object_id in sorted(complete):
            described = read_json(self.objects / object_id / schema.OBJECT_FILE)
            counts["objects"] += 1
            counts["scenes"] += len(described["scenes"])
            counts["grasps"] += sum(scene["grasps"] for scene in described["scenes"])
            for values in described["failures"]:
                failure = Failure(**values)
                everything[failure.key] = failure
        for failure in read_failures(self.root):  # of objects that an earlier run was asked for
            if failure.object_id not in sources | complete:
                everything[failure.key] = failure
        counts["failures"] = len(everything)
        ordered = [everything[key] for key in sorted(everything)]
        self._replace(schema.FAILURES_FILE, "".join(map(_line, ordered)))
        self._write_header(status="complete", counts=counts)
        return counts

    def _refuse_foreign(self) -> None:
        """Refuse a folder with anything in it that is not a dataset."""
        if (self.root / schema.DATASET_FILE).is_file():
            return
        foreign = sorted(p.name for p in self.root.iterdir() if p.name != PARTIAL)
        if foreign and foreign != [schema.OBJECTS_FOLDER]:
            raise OutputError(
                f"{self.root} is not empty and not a gmdx dataset (it holds {foreign[0]!r}); "
                "give a new folder"
            )

    def _begin(self) -> None:
        """Write the header of a new dataset, or compare it with the one that is there."""
        path = self.root / schema.DATASET_FILE
        if path.is_file():
            known = read_json(path)
            before = {k: v for k, v in known.items() if k not in ("status", "counts")}
            changed = differences(before, self._header)
            if changed:
                raise OutputError(
                    f"{self.root} holds a dataset made otherwise: {'; '.join(changed)}. "
                    "Give another folder, or the same options; name in the configuration what "
                    "`auto` stood for on another machine"
                )
        self._write_header(status="running", counts=None)

    def _write_header(self, *, status: str, counts: dict[str, int] | None) -> None:
        content = {**self._header, "status": status, "counts": counts}
        self._replace(schema.DATASET_FILE, json_text(content))

    def _replace(self, name: str, text: str) -> None:
        """Put a file of the root into place at once."""
        with writing(self.root / name):
            write_text(self._partial / name, text)
            (self._partial / name).replace(self.root / name)
            sync_folder(self.root)


def read_failures(root: Path) -> list[Failure]:
    """The failures of a dataset, in order; none where the file does not exist yet.

    Raises:
        DatasetError: The file is damaged.
    """
    path = root / schema.FAILURES_FILE
    if not path.is_file():
        return []
    failures = []
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            failures.append(Failure(**json.loads(line)))
        except (ValueError, TypeError) as error:
            if number == len(lines):  # cut off when a run was killed while it appended
                break
            raise DatasetError(f"{path}, line {number} is damaged: {error}") from error
    return failures


def _line(failure: Failure) -> str:
    return json.dumps(asdict(failure), sort_keys=True) + "\n"


def _locked(folder: Path) -> int:
    """A descriptor that holds the folder's lock until it is closed, or the process ends."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise OutputError(f"another run is writing {folder}; wait for it to end") from error
    except OSError as error:  # some network file systems have no locks
        _log.warning("%s cannot be locked (%s): start no second run", folder, error.strerror)
    return descriptor
