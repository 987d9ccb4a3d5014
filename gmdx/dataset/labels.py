"""Label tables: labels of a dataset's grasps under a name, beside what the dataset holds itself.

A table has a row per labelled grasp: the grasp's key, `label` (whether the grasp is good), `score`
(the higher, the better; null where there is none) and any further columns. Grasps may be left out.
`label.json` says what made it, from what, and with which packages, and holds the digest of the
dataset that it is for: a dataset that was made anew, or has grown since, does not take it.
"""

import hashlib
import re
import shutil
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from gmdx.dataset import schema
from gmdx.dataset.label_rows import KEY, LabelError, label_rows, positions
from gmdx.dataset.tables import NotFoundError, object_ids, read_rows
from gmdx.errors import DatasetError
from gmdx.files.folder import put_into_place, writing
from gmdx.files.formats import json_text, read_json, write_parquet, write_text
from gmdx.machine.packages import versions

if TYPE_CHECKING:
    from gmdx.dataset.label_rows import TableLike

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_SAID = {"made_by", "made_from", "packages", "dataset", "labelled", "positive", "sha256"}
_DIGEST = {"sha256", "objects"}  # under `dataset`
_PACKAGES = ("gmdx", "numpy", "pyarrow")
_ROW_GROUP = 8192  # labels; fixed, and small enough to read one object's without the others'


@dataclass(frozen=True)
class DatasetDigest:
    """What a label table is for."""

    sha256: str  # of the header and every object's manifest, which names the content of its files
    objects: int


def dataset_digest(root: Path, info: Mapping[str, Any]) -> DatasetDigest:
    """What tells a dataset from one that was made otherwise, or holds more or fewer objects.

    Reads `object.json` of each object, some kilobytes, and no table: the manifest holds the
    SHA-256 of every table.

    Raises:
        DatasetError: An object has lost its manifest.
    """
    header = {key: value for key, value in info.items() if key not in ("status", "counts")}
    digest = hashlib.sha256(json_text(header).encode())
    ids = object_ids(root)
    for object_id in ids:
        path = root / schema.OBJECTS_FOLDER / object_id / schema.OBJECT_FILE
        try:
            manifest = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError as error:
            raise DatasetError(f"cannot read {path}: {error.strerror}") from error
        digest.update(f"{object_id}={manifest};".encode())
    return DatasetDigest(digest.hexdigest(), len(ids))


def label_names(root: Path) -> tuple[str, ...]:
    """Names of a dataset's label tables, sorted."""
    folder = root / schema.LABELS_FOLDER
    if not folder.is_dir():
        return ()
    return tuple(sorted(p.name for p in folder.iterdir() if _NAME.fullmatch(p.name) and p.is_dir()))


def read_about(root: Path, name: str) -> dict[str, Any]:
    """What `label.json` says about a table.

    Raises:
        DatasetError: There is no such table, or the file is damaged.
    """
    names = label_names(root)
    if name not in names:
        known = f"it has: {', '.join(names)}" if names else "it has none"
        raise NotFoundError(f"{root} has no label table {name!r}; {known}")
    path = root / schema.LABELS_FOLDER / name / schema.LABEL_FILE
    about = read_json(path)
    digest = about.get("dataset")
    lost = _SAID - set(about) | (_DIGEST - set(digest if isinstance(digest, Mapping) else ()))
    if lost:
        raise DatasetError(f"{path} is damaged: it lacks {sorted(lost)[0]!r}")
    return about


@dataclass(frozen=True)
class LabelTable:
    """A label table on disk that fits its dataset."""

    path: Path  # of labels.parquet
    schema: pa.Schema

    def rows(self, object_id: str | None = None) -> pa.Table:
        """The labels of one object, or of all, in the order of the grasps.

        Raises:
            DatasetError: The table is damaged.
        """
        return read_rows(self.path, only={"object_id": object_id})

    def join(self, grasps: pa.Table, object_id: str) -> pa.Table:
        """Rows of one object with the columns of their labels; null where a grasp has none.

        Args:
            grasps: Rows with `scene_id` and `grasp_id`.
            object_id: Whose they are.

        Raises:
            DatasetError: The table is damaged.
        """
        labels = self.rows(object_id)
        at = positions(grasps, labels)
        take = pa.array(at, mask=at < 0)
        for field in self.schema:
            if field.name not in KEY:
                column = labels[field.name].combine_chunks().take(take)
                grasps = grasps.append_column(field, column)
        return grasps


def open_labels(root: Path, info: Mapping[str, Any], name: str) -> LabelTable:
    """A label table, checked against the dataset.

    Raises:
        DatasetError: There is no such table, it is damaged, or it is for what the dataset was
            before.
    """
    about = read_about(root, name)
    path = root / schema.LABELS_FOLDER / name / schema.LABELS_FILE
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        if found != about["sha256"]:
            raise DatasetError(f"{path} is damaged: its content is not what {name!r} was made with")
        misfit = misfit_of(about, dataset_digest(root, info))
        if misfit is not None:
            raise LabelError(
                f"the labels {name!r} of {root} do not fit it any more: {misfit}; make them again "
                "(write_labels with overwrite=True), or remove their folder"
            )
        return LabelTable(path, pq.read_schema(path))
    except (OSError, pa.ArrowInvalid) as error:
        raise DatasetError(f"cannot read {path}: {error}; the labels are damaged") from error


def misfit_of(about: Mapping[str, Any], now: DatasetDigest) -> str | None:
    """Why a table is not for a dataset as it is now; None: it is.

    Args:
        about: What `label.json` says.
        now: The dataset's digest.
    """
    then = about["dataset"]
    if then["sha256"] == now.sha256:
        return None
    if then["objects"] != now.objects:
        return f"they are for {then['objects']} objects, and there are {now.objects}"
    return "the dataset was made anew since"


def write_labels(
    root: Path,
    info: Mapping[str, Any],
    name: str,
    table: "TableLike",
    *,
    made_by: str,
    made_from: Mapping[str, Any] | None = None,
    packages: Sequence[str] = (),
    overwrite: bool = False,
) -> None:
    """Add a label table to the dataset in `root`; see `Dataset.write_labels`."""
    if not _NAME.fullmatch(name):
        raise LabelError(
            f"{name!r} cannot name labels: give at most 64 letters, digits, dots, dashes and "
            "underscores, the first a letter or a digit"
        )
    folder = root / schema.LABELS_FOLDER / name
    if folder.exists() and not overwrite:
        raise LabelError(f"{root} has labels {name!r} already: give another name, or overwrite")
    if not made_by.strip():
        raise LabelError("made_by must say what made the labels")
    before = dataset_digest(root, info)
    rows = label_rows(root, table)
    about = {
        "made_by": made_by,
        "made_from": {} if made_from is None else made_from,
        "packages": versions((*_PACKAGES, *packages)),
        "dataset": {"sha256": before.sha256, "objects": before.objects},
        "labelled": len(rows),
        "positive": pc.sum(rows["label"], min_count=0).as_py(),
    }
    attempt = folder.with_name(f".{name}.{uuid.uuid4().hex}")
    with writing(folder):
        try:
            attempt.mkdir(parents=True)
            path = attempt / schema.LABELS_FILE
            write_parquet(path, [rows], rows.schema, row_group=_ROW_GROUP)
            with path.open("rb") as file:
                about["sha256"] = hashlib.file_digest(file, "sha256").hexdigest()
            write_text(attempt / schema.LABEL_FILE, json_text(about))
            _put(attempt, folder)
        finally:
            shutil.rmtree(attempt, ignore_errors=True)


def _put(attempt: Path, folder: Path) -> None:
    """Rename a folder into place; the one that it replaces goes only after that."""
    replaced = attempt.with_name(f"{attempt.name}.replaced")
    if folder.exists():
        folder.rename(replaced)
    placed = False
    try:
        placed = put_into_place(attempt, folder)
    finally:
        if not placed and replaced.exists():
            replaced.rename(folder)
    if not placed:
        raise LabelError(f"{folder} came into place meanwhile: give another name, or overwrite")
    shutil.rmtree(replaced, ignore_errors=True)
