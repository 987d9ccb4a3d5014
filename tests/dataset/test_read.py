"""What was written comes back, and what is not there is named."""

from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from gmdx.dataset import schema
from gmdx.dataset.read import Dataset, read_dataset
from gmdx.errors import DatasetError
from gmdx.metrics.table import METRICS
from gmdx.scenes.camera import render
from tests.dataset.hand_built import (
    CAMERA,
    HEADER,
    PHYSICS,
    columns_of,
    grasps_of,
    scene_of,
    write_dataset,
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("dataset")
    write_dataset(root, "mug", "bowl")
    return read_dataset(root)


def assert_same(a: object, b: object) -> None:
    """Equal to the last bit, through dataclasses and tuples."""
    if is_dataclass(a):
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)  # type: ignore[arg-type]
        for left, right in zip(a, b, strict=True):  # type: ignore[call-overload]
            assert_same(left, right)
    else:
        np.testing.assert_array_equal(a, b)


def test_objects_and_scenes_come_back_exactly(dataset: Dataset) -> None:
    assert dataset.objects == ("bowl", "mug")
    assert dataset.scenes("mug") == (0, 1)
    expected = scene_of("mug", 1)
    view = dataset.scene("mug", 1)
    assert_same(view.scene, expected)
    assert_same(dataset.object("mug"), expected.object)
    assert len(view.images) == 2
    for k, image in enumerate(view.images):
        assert_same(image, render(expected, view=k, config=CAMERA))


def test_physics_is_read_from_the_dataset_and_never_made_up(dataset: Dataset) -> None:
    assert dataset.physics == dataset.scene("mug", 0).scene.physics == PHYSICS
    configuration = HEADER["configuration"]
    for physics, message in (
        ({}, r"dataset\.json does not say .* lacks closing_acceleration, closing_speed"),
        ({**configuration["physics"], "cone": "round"}, "unknown cone 'round'"),
        ({**configuration["physics"], "colour": 3}, "unknown key 'physics.colour'"),
    ):
        info = {**HEADER, "configuration": {**configuration, "physics": physics}}
        with pytest.raises(DatasetError, match=message):
            replace(dataset, info=info).scene("mug", 0)


def test_grasps_come_back_exactly(dataset: Dataset) -> None:
    table = dataset.grasps("mug", 1)
    grasps = grasps_of(10)
    np.testing.assert_array_equal(table["grasp_id"], grasps.grasp_id)
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(table[name], grasps.center[:, axis])
    np.testing.assert_array_equal(table["angle"], grasps.angle)
    np.testing.assert_array_equal(table["width"], grasps.width)
    assert set(table["scene_id"].to_pylist()) == {1}
    for name, values in columns_of(grasps).items():
        assert table[name].to_pylist() == values.tolist()


def test_grasps_of_everything_and_of_chosen_columns(dataset: Dataset) -> None:
    table = dataset.grasps(columns=["object_id", "force"])
    assert table.column_names == ["object_id", "force"]
    assert table["object_id"].to_pylist() == ["bowl"] * 20 + ["mug"] * 20
    assert sum(batch.num_rows for batch in dataset.batches(columns=["force"])) == 40


def test_every_metric_carries_its_unit_and_definition(dataset: Dataset) -> None:
    found = dataset.grasps("mug").schema
    for metric in METRICS:
        metadata = found.field(metric.name).metadata
        assert metadata[b"unit"].decode() == metric.unit
        assert metric.definition in metadata[b"definition"].decode()


def test_failures_are_read(dataset: Dataset) -> None:
    assert [(f.object_id, f.scene_id, f.stage) for f in dataset.failures] == [
        ("bowl", 2, "settle"),
        ("cup", None, "prepare"),
        ("mug", 2, "settle"),
    ]


@pytest.mark.parametrize("name", ["spoon", "", "..", "../objects", "mug/"])
def test_an_unknown_object_is_an_error_that_lists_the_known(dataset: Dataset, name: str) -> None:
    with pytest.raises(DatasetError, match="bowl, mug"):
        dataset.object(name)


def test_unknown_scenes_and_columns_are_errors(dataset: Dataset) -> None:
    with pytest.raises(DatasetError, match=r"no scene 7; it has \[0, 1\]"):
        dataset.scene("mug", 7)
    with pytest.raises(DatasetError, match=r"no scene 7; it has \[0, 1\]"):
        dataset.grasps("mug", 7)
    with pytest.raises(DatasetError, match="no column 'colour'"):
        dataset.grasps(columns=["colour"])
    with pytest.raises(DatasetError, match=r"a list of names, as \['force'\]"):
        dataset.grasps(columns="force")


def test_not_a_dataset(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="not a gmdx dataset"):
        read_dataset(tmp_path)
    (tmp_path / schema.DATASET_FILE).write_text('{"schema_version": 99}')
    with pytest.raises(DatasetError, match="schema version 99"):
        read_dataset(tmp_path)
    (tmp_path / schema.DATASET_FILE).write_text("{")
    with pytest.raises(DatasetError, match="not valid JSON"):
        read_dataset(tmp_path)
    for content in ("[]", "null", "3"):
        (tmp_path / schema.DATASET_FILE).write_text(content)
        with pytest.raises(DatasetError, match="holds no JSON object"):
            read_dataset(tmp_path)


def test_a_dataset_that_lost_its_objects_is_damaged(tmp_path: Path) -> None:
    write_dataset(tmp_path)
    assert read_dataset(tmp_path).objects == ()
    (tmp_path / schema.OBJECTS_FOLDER).rmdir()
    with pytest.raises(DatasetError, match="has no folder objects"):
        read_dataset(tmp_path).grasps()


@pytest.mark.parametrize("name", [schema.MESH_FILE, schema.SCENES_FILE, schema.HULLS_FILE])
def test_damaged_files_are_named(tmp_path: Path, name: str) -> None:
    write_dataset(tmp_path, "mug")
    path = tmp_path / "objects" / "mug" / name
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(DatasetError, match=name):
        read_dataset(tmp_path).scene("mug", 0)


def test_a_damaged_table_is_named(tmp_path: Path) -> None:
    write_dataset(tmp_path, "mug")
    (tmp_path / "objects" / "mug" / schema.GRASPS_FILE).write_bytes(b"PAR1 no more")
    with pytest.raises(DatasetError, match="damaged"):
        read_dataset(tmp_path).grasps()
