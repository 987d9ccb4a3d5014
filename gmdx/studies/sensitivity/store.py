"""A sensitivity study's folder: locked, resumable, and never with half a part in it."""

import fcntl
import json
import logging
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gmdx.config import differences
from gmdx.dataset.store import OutputError, writing
from gmdx.errors import DatasetError
from gmdx.files.formats import json_text, read_json, sync_folder, write_text
from gmdx.studies.sensitivity.runs import COUNTS, HULL_COUNT, OUTPUTS, Row

SETTINGS_FILE = "settings.json"
RUNS_FILE = "runs.parquet"
_PARTS = "parts"
_log = logging.getLogger("gmdx")


class StudyFolder:
    """The folder of one study while it runs; a context manager that holds its lock.

    Runs are put into `parts/` a few at a time, each by renaming a complete file, and end up in
    `runs.parquet` in their order, which is the same however often the study was interrupted.
    """

    def __init__(self, root: str | Path, settings: Mapping[str, Any]) -> None:
        """Make `root` ready, or take it up again.

        Args:
            root: The folder; created if it does not exist.
            settings: Everything that the runs depend on.

        Raises:
            OutputError: The folder is in use, cannot be written, holds something else, or a
                study with other settings.
        """
        self.root = Path(root)
        self._settings: dict[str, Any] = json.loads(json_text(settings))
        if self.root.exists() and not self.root.is_dir():
            raise OutputError(f"cannot use {self.root} for output: it is no folder; give another")
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(self.root, os.O_RDONLY)
        except OSError as error:
            raise OutputError(f"cannot use {self.root} for output: {error.strerror}") from error
        try:
            self._take()
            self._begin()
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> "StudyFolder":
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._lock)

    def rows(self, names: Sequence[str]) -> list[Row]:
        """The runs that are there, by object and run.

        Args:
            names: Of the parameters.

        Raises:
            DatasetError: A file is damaged.
        """
        parts = sorted((self.root / _PARTS).glob("[!.]*.parquet"))
        found: dict[tuple[str, int], Row] = {}
        for path in [*parts, self.root / RUNS_FILE]:
            if path.is_file():
                for row in _read(path, _schema(names)):
                    found[str(row["object_id"]), int(row["run"])] = row
        return [found[key] for key in sorted(found)]

    def add(self, rows: Sequence[Row], names: Sequence[str]) -> None:
        """Keep a few runs of one object."""
        name = f"{rows[0]['object_id']}-{rows[0]['run']:06d}.parquet"
        with writing(self.root):
            (self.root / _PARTS).mkdir(exist_ok=True)
        self._write(self.root / _PARTS / name, rows, names)

    def finish(self, rows: Sequence[Row], names: Sequence[str]) -> None:
        """Put all runs into one file; the parts are not needed any more."""
        self._write(self.root / RUNS_FILE, rows, names)
        shutil.rmtree(self.root / _PARTS, ignore_errors=True)

    @contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        """Write a file of the root under another name inside; it is put into place afterwards."""
        path = self.root / name
        partial = path.with_name(f".partial-{path.name}")
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            partial.replace(path)
            sync_folder(path.parent)

    def _write(self, path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
        table = pa.Table.from_pylist(list(rows), schema=_schema(names))
        with self.replacing(str(path.relative_to(self.root))) as partial:
            pq.write_table(table, partial)

    def _take(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OutputError(f"another run is writing {self.root}; wait for it to end") from error
        except OSError as error:  # some network file systems have no locks
            _log.warning("%s cannot be locked (%s): start no second run", self.root, error.strerror)

    def _begin(self) -> None:
        path = self.root / SETTINGS_FILE
        if path.is_file():
            changed = differences(read_json(path), self._settings)
            if changed:
                raise OutputError(
                    f"{self.root} holds a study made otherwise: {'; '.join(changed)}. "
                    "Give another folder, or the same options"
                )
            return
        foreign = sorted(p.name for p in self.root.iterdir() if not p.name.startswith(".partial-"))
        if foreign:
            raise OutputError(
                f"{self.root} is not empty and no sensitivity study (it holds {foreign[0]!r}); "
                "give a new folder"
            )
        with self.replacing(SETTINGS_FILE) as partial:
            write_text(partial, json_text(self._settings))


def _schema(names: Sequence[str]) -> pa.Schema:
    fields = [("object_id", pa.string()), ("run", pa.int32()), ("block", pa.int32())]
    fields += [(name, pa.float64()) for name in (*names, *(output.name for output in OUTPUTS))]
    fields += [(name, pa.int32()) for name in (*COUNTS, HULL_COUNT)]
    return pa.schema(fields)


def _read(path: Path, schema: pa.Schema) -> Iterable[Row]:
    try:
        table = pq.read_table(path, schema=schema)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(
            f"cannot read {path}: {error}; remove it, and the same command makes it anew"
        ) from error
    rows: list[Row] = table.to_pylist()
    return rows
