"""The runs of a sensitivity study on disk: a few at a time, and all of them in the end."""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gmdx.errors import DatasetError
from gmdx.files.folder import Kind, RunFolder
from gmdx.files.formats import write_parquet
from gmdx.studies.sensitivity.runs import COUNTS, HULL_COUNT, OUTPUTS, Row

SENSITIVITY_STUDY = Kind("sensitivity study", "settings.json")
RUNS_FILE = "runs.parquet"
_PARTS = "parts"


class StudyFolder(RunFolder):
    """The folder of one study while it runs; a context manager that holds its lock.

    Runs are put into `parts/` a few at a time, and end up in `runs.parquet` in their order, which
    is the same however often the study was interrupted.
    """

    def __init__(self, root: str | Path, settings: Mapping[str, Any]) -> None:
        """Make `root` ready, or take it up again.

        Args:
            root: The folder; created if it does not exist.
            settings: Everything that the runs depend on.

        Raises:
            OutputError: The folder is in use, cannot be written, holds something else, or a
                study with other settings.
            StorageError: The disk refused.
        """
        super().__init__(root, SENSITIVITY_STUDY, settings)

    def rows(self, names: Sequence[str]) -> list[Row]:
        """The runs that are there, by object and run.

        Args:
            names: Of the parameters.

        Raises:
            DatasetError: A file is damaged.
        """
        parts = sorted((self.root / _PARTS).glob("*.parquet"))
        found: dict[tuple[str, int], Row] = {}
        for path in [*parts, self.root / RUNS_FILE]:
            if path.is_file():
                for row in _read(path, _schema(names)):
                    found[str(row["object_id"]), int(row["run"])] = row
        return [found[key] for key in sorted(found)]

    def add(self, rows: Sequence[Row], names: Sequence[str]) -> None:
        """Keep a few runs of one object."""
        name = f"{rows[0]['object_id']}-{rows[0]['run']:06d}.parquet"
        self._write(f"{_PARTS}/{name}", rows, names)

    def finish(self, rows: Sequence[Row], names: Sequence[str]) -> None:
        """Put all runs into one file; the parts are not needed any more."""
        self._write(RUNS_FILE, rows, names)
        shutil.rmtree(self.root / _PARTS, ignore_errors=True)

    def _write(self, name: str, rows: Sequence[Row], names: Sequence[str]) -> None:
        schema = _schema(names)
        table = pa.Table.from_pylist(list(rows), schema=schema)
        with self.replacing(name) as path:
            write_parquet(path, [table], schema, compression="snappy")


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
