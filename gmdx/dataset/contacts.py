"""The contacts of grasps, as rows of `contacts.parquet` and back."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from gmdx.arrays import Array, Int
from gmdx.dataset import schema
from gmdx.errors import DatasetError
from gmdx.grasps.grasp import PadContacts
from gmdx.metrics.compute import MetricTable
from gmdx.trials.results import TrialResults

_POINT = ("x", "y", "z")
_NORMAL = ("normal_x", "normal_y", "normal_z")


def contacts_of(trials: TrialResults, table: MetricTable) -> dict[str, PadContacts]:
    """Every contact that the metrics rest on, by its source.

    Raises:
        DatasetError: The table lacks the analytical contacts.
    """
    if table.contacts is None:
        raise DatasetError("the metrics lack the analytical contacts: compute every stage")
    found = (table.contacts.center, table.contacts.pads, trials.contacts)
    return dict(zip(schema.SOURCES, found, strict=True))


def contact_rows(
    object_id: str, scene_id: int, grasp_id: Int[Array, "n"], contacts: Mapping[str, PadContacts]
) -> pa.Table:
    """A row per contact, in the order of grasps, sources and pads.

    Args:
        object_id: The object.
        scene_id: Its scene.
        grasp_id: Of n grasps of that scene.
        contacts: Of these grasps, by source.
    """
    every = list(contacts.values())
    index = [np.argwhere(c.valid) for c in every]  # of grasp, pad and slot
    source = np.repeat(np.arange(len(every)), [len(found) for found in index])
    grasp, pad, _ = np.concatenate(index).T
    order = np.lexsort((source, grasp))  # stable: pads and slots stay in their order
    points = np.concatenate([c.points[c.valid] for c in every])[order]
    normals = np.concatenate([c.normals[c.valid] for c in every])[order]
    names = np.array(list(contacts), dtype=object)
    columns = {
        "object_id": np.full(len(order), object_id, dtype=object),
        "scene_id": np.full(len(order), scene_id),
        "grasp_id": grasp_id[grasp[order]],
        "source": names[source[order]],
        "pad": pad[order],
        **{name: points[:, axis] for axis, name in enumerate(_POINT)},
        **{name: normals[:, axis] for axis, name in enumerate(_NORMAL)},
    }
    arrays = [pa.array(columns[field.name], type=field.type) for field in schema.CONTACT_SCHEMA]
    return pa.Table.from_arrays(arrays, schema=schema.CONTACT_SCHEMA)


def contacts_in(rows: pa.Table, grasp_id: Int[Array, "n"], source: str) -> PadContacts:
    """The contacts of one source that a scene's rows hold.

    Args:
        rows: Of `contacts.parquet`, of one scene.
        grasp_id: The grasps that are wanted, each once.
        source: One of `schema.SOURCES`.
    """
    rows = rows.filter(pc.equal(rows["source"], source))
    rows = rows.filter(pa.array(np.isin(rows["grasp_id"].to_numpy(), grasp_id)))
    order = np.argsort(grasp_id)
    grasp = order[np.searchsorted(grasp_id, rows["grasp_id"].to_numpy(), sorter=order)]
    pad = rows["pad"].to_numpy()
    slot = _running(2 * grasp + pad)
    shape = (len(grasp_id), 2, int(slot.max(initial=0)) + 1)
    points, normals = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
    valid = np.zeros(shape, bool)
    points[grasp, pad, slot] = np.stack([rows[name].to_numpy() for name in _POINT], axis=1)
    normals[grasp, pad, slot] = np.stack([rows[name].to_numpy() for name in _NORMAL], axis=1)
    valid[grasp, pad, slot] = True
    return PadContacts(points, normals, valid)


def _running(group: Int[Array, "m"]) -> Int[Array, "m"]:
    """How many of the same group come before each."""
    order = np.argsort(group, kind="stable")
    first = np.r_[True, np.diff(group[order]) != 0][: len(group)]
    start = np.maximum.accumulate(np.where(first, np.arange(len(group)), 0))
    running = np.empty(len(group), int)
    running[order] = np.arange(len(group)) - start
    return running
