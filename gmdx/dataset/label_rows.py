"""What makes rows a label table: their columns, types and keys, checked against the dataset."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from gmdx.arrays import Array, Int
from gmdx.dataset import schema
from gmdx.dataset.tables import object_folder, read_rows
from gmdx.errors import DatasetError, UsageError

if TYPE_CHECKING:
    import pandas as pd

    TableLike: TypeAlias = pa.Table | pd.DataFrame | Mapping[str, Any]

KEY = tuple(column.name for column in schema.IDENTITY)
LABEL_COLUMNS = (
    *schema.IDENTITY,
    schema.Column("label", pa.bool_(), "", "whether the grasp is good"),
    schema.Column("score", pa.float64(), "", "the higher, the better; null where there is none"),
)
_OWN = tuple(column.name for column in LABEL_COLUMNS)
_TEXT, _WHOLE = (pa.types.is_string, pa.types.is_large_string), (pa.types.is_integer,)
_ACCEPTED = {  # by column: what it may hold, in words and by type
    "object_id": ("text", _TEXT),
    "scene_id": ("whole numbers", _WHOLE),
    "grasp_id": ("whole numbers", _WHOLE),
    "label": ("true and false, or 1 and 0", (pa.types.is_boolean, pa.types.is_integer)),
    "score": ("numbers", (pa.types.is_floating, pa.types.is_integer, pa.types.is_null)),
}


class LabelError(DatasetError, UsageError):
    """A label table that a dataset cannot take, or that does not fit it any more."""


def label_rows(root: Path, table: "TableLike") -> pa.Table:
    """Labels as they are stored: typed, each of another grasp of the dataset, in its order.

    Args:
        root: The dataset's folder.
        table: Columns `object_id`, `scene_id`, `grasp_id` and `label`, `score` if there is one,
            and any others.

    Raises:
        LabelError: A column is missing or holds what it must not, or a grasp is labelled twice or
            is not in the dataset.
        DatasetError: An object is not in the dataset.
    """
    rows = _typed(_as_arrow(table))
    rows = rows.sort_by([(name, "ascending") for name in KEY]).combine_chunks()
    first = 0
    for entry in pc.value_counts(rows["object_id"]).to_pylist():  # each in one run
        mine = rows.slice(first, entry["counts"])
        _check_keys(mine, object_folder(root, entry["values"]) / schema.GRASPS_FILE)
        first += entry["counts"]
    return rows


def positions(rows: pa.Table, among: pa.Table) -> Int[Array, "n"]:
    """Where the grasp of each row stands among others of the same object; -1 where it does not."""
    import pandas as pd

    def keys(table: pa.Table) -> pd.MultiIndex:
        return pd.MultiIndex.from_arrays([table[name].to_numpy() for name in KEY[1:]])

    return np.asarray(keys(among).get_indexer(keys(rows)))


def _as_arrow(table: "TableLike") -> pa.Table:
    try:
        if isinstance(table, Mapping):
            return pa.table(dict(table))
        if isinstance(table, pa.Table):
            return table
        return pa.Table.from_pandas(table, preserve_index=False)
    except (pa.ArrowException, AttributeError, TypeError, ValueError) as error:
        raise LabelError(f"the labels are not a table: {error}") from error


def _typed(given: pa.Table) -> pa.Table:
    """The columns that every label table has, of their types, and then the further ones."""
    names = given.column_names
    missing = [name for name in (*KEY, "label") if name not in names]
    if missing:
        raise LabelError(f"the labels lack the column {missing[0]!r}; they have {', '.join(names)}")
    taken = sorted(set(names) & {column.name for column in schema.COLUMNS} - set(KEY))
    if taken:
        raise LabelError(
            f"the dataset has a column {taken[0]!r} already: name the labels' otherwise"
        )
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LabelError(f"the labels have two columns {twice[0]!r}")
    if "score" not in names:
        given = given.append_column("score", pa.nulls(len(given)))
    further = [name for name in names if name not in _OWN]
    return pa.Table.from_arrays(
        [*(_column(given, column) for column in LABEL_COLUMNS), *(given[name] for name in further)],
        schema=pa.schema(
            [*(column.field for column in LABEL_COLUMNS), *map(given.schema.field, further)]
        ),
    )


def _column(given: pa.Table, column: schema.Column) -> pa.ChunkedArray:
    """A column as the type it is stored in, where nothing is lost by that."""
    name = column.name
    values = given[name]
    if pa.types.is_dictionary(values.type):
        values = values.cast(values.type.value_type)
    words, kinds = _ACCEPTED[name]
    if not any(fits(values.type) for fits in kinds):
        raise LabelError(f"the column {name!r} must hold {words}, not {values.type}")
    if name == "score":
        if not pc.all(pc.is_finite(values.cast(pa.float64()).drop_null()), min_count=0).as_py():
            raise LabelError("the column 'score' has NaN or infinity: no score is null")
    elif values.null_count:
        raise LabelError(f"the column {name!r} has missing values: leave such grasps out")
    if name == "label" and pa.types.is_integer(values.type):
        strange = values.filter(pc.invert(pc.is_in(values, pa.array([0, 1], values.type))))
        if len(strange):
            raise LabelError(f"the column 'label' must hold {words}, not {strange[0]}")
    try:
        return values.cast(column.type)
    except pa.ArrowInvalid as error:
        raise LabelError(f"the column {name!r} does not fit {column.type}: {error}") from error


def _check_keys(rows: pa.Table, grasps: Path) -> None:
    """Refuse a grasp of one object that is not in its table, or comes twice.

    Args:
        rows: Of one object, in order.
        grasps: The object's table.
    """
    strange = positions(rows, read_rows(grasps, columns=KEY)) < 0
    scene, grasp = (rows[name].to_numpy() for name in KEY[1:])
    again = np.r_[False, (np.diff(scene) == 0) & (np.diff(grasp) == 0)]
    for wrong, what in ((strange, "is not in the dataset"), (again, "is labelled more than once")):
        if wrong.any():
            k = int(wrong.argmax())
            raise LabelError(
                f"grasp {grasp[k]} of scene {scene[k]} of object {rows['object_id'][k]} {what}"
            )
