"""The overview's figures, counted another way."""

import io
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console

from gmdx.dataset.inspect import overview, tables
from gmdx.dataset.read import Dataset, read_dataset
from gmdx.dataset.store import DatasetStore
from gmdx.dataset.write import ObjectWriter
from gmdx.errors import Failure
from gmdx.metrics.table import METRIC_NAMES
from gmdx.scenes.camera import render
from gmdx.trials.outcome import Outcome
from tests.dataset.hand_built import (
    CAMERA,
    EVIDENCE,
    HEADER,
    grasps_of,
    scene_of,
    table_of,
    trials_of,
)

INFO = {**HEADER, "gripper": {"name": "tweezers"}, "engine": "by hand"}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two objects whose outcomes, and whose missing values, are known."""
    root: Path = tmp_path_factory.mktemp("dataset")
    with DatasetStore(root, INFO) as store:
        for object_id, ends in (
            ("mug", [Outcome.SUCCESS, Outcome.SUCCESS]),
            ("cup", [Outcome.SUCCESS, Outcome.NO_CONTACT]),
        ):
            scene = scene_of(object_id)
            attempt = store.attempt(object_id)
            writer = ObjectWriter(attempt, scene.object)
            grasps = grasps_of(4)
            table = table_of(
                grasps,
                sim_success=np.array([1.0, 0.0, np.nan, 0.5]),
                force=np.array([0.0, 0.0, 7.0, 9.0]),
                g_coll=np.array([1.0, 0.0, 0.0, 0.0]),
            )
            table = replace(table, outcomes=np.array([ends] * 4))
            writer.begin_scene(scene, [render(scene, config=CAMERA)])
            writer.add_grasps(grasps, trials_of(grasps), table)
            writer.end_scene()
            writer.close(failures=[], evidence=EVIDENCE)
            writer.write_cost({"cpu_seconds": {"trials": 1.5, "settle": 0.5}})
            store.publish(attempt, object_id)
        failure = Failure("jug", None, "prepare", "MeshError", "no [closed] surface")
        store.finish([failure], sources={"mug", "cup", "jug"})
    return read_dataset(root)


def test_counts(dataset: Dataset) -> None:
    view = overview(dataset)
    assert [line.object_id for line in view.objects] == ["cup", "mug"]
    assert view.grasps == 8
    assert view.outcomes == Counter(success=12, no_contact=4)
    assert view.missing == {"sim_success": 2}
    assert view.evidence == EVIDENCE + EVIDENCE
    assert view.seconds == {"trials": 3.0, "settle": 1.0}
    for line in view.objects:
        assert (line.scenes, line.grasps, line.cpu_seconds) == (1, 4, 2.0)
        assert (line.success, line.unsafe, line.held_force) == (0.5, 0.25, 3.5)
    assert len(METRIC_NAMES) == 36


def test_tables_show_them(dataset: Dataset) -> None:
    screen = Console(file=io.StringIO(), width=160)
    for table in tables(overview(dataset)):
        screen.print(table)
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    for word in (
        "tweezers",
        "by hand",
        "no_contact",
        "75 %",
        "2.0e-05",
        "MeshError: no [closed] surface",
    ):
        assert word in text


def test_label_tables_are_listed(dataset: Dataset) -> None:
    keys = dataset.grasps("mug", columns=("object_id", "scene_id", "grasp_id"))
    labels = pa.array([True, True, True, False])
    dataset.write_labels("panel", keys.append_column("label", labels), made_by="three [judges]")
    (line,) = overview(dataset).labels
    assert (line.name, line.labelled, line.positive, line.misfit) == ("panel", 4, 3, None)
    screen = Console(file=io.StringIO(), width=160)
    for table in tables(overview(dataset)):
        screen.print(table)
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    words = text[text.index("Label tables") :].splitlines()[4].replace("│", "").split()
    assert words == ["panel", "4", "50", "%", "75", "%", "three", "[judges]", "yes"]


def test_an_empty_dataset_has_an_overview(tmp_path: Path) -> None:
    with DatasetStore(tmp_path, INFO) as store:
        store.finish([], sources=set())
    view = overview(read_dataset(tmp_path))
    assert view.grasps == 0
    assert list(tables(view))
