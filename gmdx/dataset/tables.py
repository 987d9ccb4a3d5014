"""Where a dataset's objects lie, and the rows of their tables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gmdx.dataset import schema
from gmdx.errors import DatasetError, UsageError


class NotFoundError(DatasetError, UsageError):
    """There is no such dataset, or nothing of that name in it."""


def object_ids(root: Path) -> tuple[str, ...]:
    """Ids of a dataset's objects, sorted.

    Raises:
        DatasetError: Their folder is gone.
    """
    folder = root / schema.OBJECTS_FOLDER
    if not folder.is_dir():
        raise DatasetError(f"{root} has no folder {folder.name}; the dataset is damaged")
    return tuple(sorted(path.name for path in folder.iterdir() if path.is_dir()))


def object_folder(root: Path, object_id: str) -> Path:
    """The folder of an object.

    Raises:
        DatasetError: There is no such object.
    """
    folder = root / schema.OBJECTS_FOLDER / object_id
    if Path(object_id).name != object_id or object_id in ("", "..") or not folder.is_dir():
        ids = object_ids(root)
        known = ", ".join(ids[:8]) + (", ..." if len(ids) > 8 else "")
        raise NotFoundError(f"{root} has no object {object_id!r}; it has: {known}")
    return folder


def chosen(full: pa.Schema, columns: Sequence[str] | None) -> pa.Schema:
    """The schema of the named columns; of all for None.

    Raises:
        DatasetError: There is no such column.
    """
    if columns is None:
        return full
    if isinstance(columns, str):
        raise NotFoundError(f"columns are a list of names, as [{columns!r}], and not one text")
    unknown = sorted(set(columns) - set(full.names))
    if unknown:
        raise NotFoundError(f"no column {unknown[0]!r}; the columns are: {', '.join(full.names)}")
    return pa.schema([full.field(name) for name in columns])


def read_rows(
    path: Path,
    *,
    columns: Sequence[str] | None = None,
    only: Mapping[str, Any] = MappingProxyType({}),
) -> pa.Table:
    """Rows of a table, in their order.

    Args:
        path: A parquet file.
        columns: Names of the columns; all by default.
        only: Rows whose columns of these names have these values; None: any value.

    Raises:
        DatasetError: The file cannot be read.
    """
    filters = [(name, "==", value) for name, value in only.items() if value is not None]
    try:
        return pq.read_table(
            path,
            columns=None if columns is None else list(columns),
            filters=filters if filters else None,
            partitioning=None,
        )
    except FileNotFoundError as error:  # its text is the path and nothing else
        raise DatasetError(f"cannot read {path}: no such file; the dataset is damaged") from error
    except (OSError, pa.ArrowInvalid) as error:
        raise DatasetError(f"cannot read {path}: {error}; the dataset is damaged") from error
