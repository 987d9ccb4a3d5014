"""`pairs.parquet`: every run's outcomes and metrics of each grasp side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gmdx.arrays import Array, Int
from gmdx.dataset.read import Dataset
from gmdx.dataset.schema import GRASP, IDENTITY
from gmdx.files.formats import write_parquet
from gmdx.metrics.table import COMPARED
from gmdx.studies.bias.replay import Run, RunRows
from gmdx.trials.outcome import Outcome

_NAMES = {-1: None, **{int(outcome): outcome.label for outcome in Outcome}}


def write_pairs(
    path: Path,
    dataset: Dataset,
    objects: Sequence[str],
    rows: Sequence[Sequence[int]],
    runs: Sequence[Run],
    found: Mapping[str, RunRows],
) -> None:
    """Write a row per grasp: what it is, then `<metric>_<run>` and the outcomes of every run.

    A field's metadata holds unit, definition and run. What a run lacks is null.

    Args:
        path: The file.
        dataset: Where the grasps are.
        objects: Ids of the objects.
        rows: By object: which of its grasps.
        runs: In the order of the columns.
        found: By run: what it gave.
    """
    described = (*IDENTITY, *GRASP)
    names = [column.name for column in described]
    grasps = pa.concat_tables(
        dataset.grasps(object_id, columns=names).take(list(chosen))
        for object_id, chosen in zip(objects, rows, strict=True)
    )
    fields: list[pa.Field] = [column.field for column in described]
    columns: list[Any] = [grasps[name].combine_chunks() for name in names]
    for metric in COMPARED:
        for run in runs:
            meta = {"unit": metric.unit, "definition": metric.definition, "run": run.label}
            fields.append(pa.field(f"{metric.name}_{run.name}", pa.float64(), metadata=meta))
            columns.append(_doubles(found[run.name].values[metric.name]))
    for run in runs:
        rows_of = found[run.name]
        meta = {"run": run.label}
        lists = rows_of.outcomes.tolist()
        fields += [
            pa.field(f"outcome_{run.name}", pa.string(), metadata=meta),
            pa.field(f"outcomes_{run.name}", pa.list_(pa.string()), metadata=meta),
            pa.field(f"force_is_lower_bound_{run.name}", pa.bool_(), metadata=meta),
        ]
        columns += [
            pa.array([_NAMES[row[0]] for row in lists], pa.string()),
            pa.array([[_NAMES[outcome] for outcome in row] for row in lists],
                     pa.list_(pa.string())),
            pa.array(rows_of.lower_bound, pa.bool_(), mask=~rows_of.present),
        ]  # fmt: skip
    table = pa.table(columns, schema=pa.schema(fields))
    write_parquet(path, [table], table.schema)


def _doubles(values: Array) -> pa.Array:
    return pa.array(values, pa.float64(), mask=np.isnan(values))


def trial_lists(outcomes: Int[Array, "t"]) -> str:
    """Outcomes of one grasp's trials in words, equal ones counted."""
    counts: dict[str, int] = {}
    for outcome in outcomes.tolist():
        name = _NAMES[outcome] or "not run"
        counts[name] = counts.get(name, 0) + 1
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
