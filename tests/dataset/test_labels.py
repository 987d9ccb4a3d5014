"""Label tables: keyed, checked, joined, and refused once the dataset has changed."""

import errno
import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gmdx.dataset.inspect import overview
from gmdx.dataset.label_rows import LabelError
from gmdx.dataset.read import Dataset, read_dataset
from gmdx.dataset.store import DatasetStore
from gmdx.errors import DatasetError
from tests.dataset.hand_built import HEADER, write_dataset, write_object
from tests.dataset.test_store import contents, put


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    """Two objects, two scenes of ten grasps each."""
    write_dataset(tmp_path / "data", "mug", "bowl")
    return read_dataset(tmp_path / "data")


def some(dataset: Dataset, *, seed: int = 0) -> pd.DataFrame:
    """Labels of two thirds of the grasps, shuffled."""
    keys = dataset.grasps(columns=["object_id", "scene_id", "grasp_id"]).to_pandas()
    rng = np.random.default_rng(seed)
    table = keys.sample(frac=0.65, random_state=seed).reset_index(drop=True)
    table["label"] = rng.random(len(table)) < 0.4
    table["score"] = np.where(rng.random(len(table)) < 0.2, np.nan, rng.normal(size=len(table)))
    table["judges"] = rng.integers(1, 9, len(table))
    return table


def test_labels_come_back_in_the_dataset_s_order(dataset: Dataset) -> None:
    given = some(dataset)
    before = contents(dataset.root)
    dataset.write_labels("panel.v1", given, made_by="a coin", made_from={"seed": 0})
    found = dataset.labels("panel.v1").to_pandas()
    expected = given.sort_values(["object_id", "scene_id", "grasp_id"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(found, expected, check_dtype=False)
    assert dataset.label_tables == ("panel.v1",)
    about = dataset.describe_labels("panel.v1")
    assert (about["made_by"], about["made_from"]) == ("a coin", {"seed": 0})
    assert (about["labelled"], about["positive"]) == (len(given), int(given["label"].sum()))
    assert set(about["packages"]) == {"gmdx", "numpy", "pyarrow"}
    after = contents(dataset.root)
    new = {f"labels/panel.v1/{name}" for name in ("labels.parquet", "label.json")}
    assert set(after) == set(before) | new
    assert {name: after[name] for name in before} == before  # nothing existing was touched


def test_same_labels_give_same_bytes_in_any_order(dataset: Dataset) -> None:
    given = some(dataset)
    dataset.write_labels("a", given, made_by="x")
    dataset.write_labels("b", pa.Table.from_pandas(given[::-1], preserve_index=False), made_by="x")
    for name in ("labels.parquet", "label.json"):
        one, two = (dataset.root / "labels" / which / name for which in "ab")
        assert one.read_bytes() == two.read_bytes()


def test_readers_join_labels_on_request(dataset: Dataset) -> None:
    given = some(dataset)
    dataset.write_labels("panel", given, made_by="a coin")
    plain = dataset.grasps().to_pandas()
    key = ["object_id", "scene_id", "grasp_id"]
    expected = plain.merge(given, on=key, how="left")  # pandas keeps the order of the left side
    found = dataset.grasps(labels="panel")
    assert found.column_names == [*plain.columns, "label", "score", "judges"]
    assert found["label"].null_count == len(plain) - len(given)
    for name in ("label", "score", "judges", "force"):
        mine, theirs = found[name].to_pandas(), expected[name]
        assert mine.isna().tolist() == theirs.isna().tolist()
        assert mine.dropna().tolist() == theirs.dropna().tolist()
    one = dataset.grasps("mug", 1, columns=["force"], labels="panel")
    assert one.column_names == ["force", "label", "score", "judges"]
    at = (expected["object_id"] == "mug") & (expected["scene_id"] == 1)
    assert one["label"].to_pylist() == [
        None if pd.isna(v) else bool(v) for v in expected.loc[at, "label"]
    ]
    by_object = pa.concat_tables(dataset.batches(columns=["grasp_id"], labels="panel"))
    assert by_object.equals(dataset.grasps(columns=["grasp_id"], labels="panel"))


def test_a_dataset_without_objects_joins_no_labels(tmp_path: Path) -> None:
    write_dataset(tmp_path)
    dataset = read_dataset(tmp_path)
    none = {"object_id": pa.array([], pa.string()), "scene_id": pa.array([], pa.int32()),
            "grasp_id": pa.array([], pa.int64()), "label": pa.array([], pa.bool_())}  # fmt: skip
    dataset.write_labels("nothing", none, made_by="nobody")
    assert dataset.labels("nothing").num_rows == 0
    joined = dataset.grasps(columns=["force"], labels="nothing")
    assert joined.column_names == ["force", "label", "score"]


def test_labels_do_not_outlive_the_grasps_that_they_are_for(
    dataset: Dataset, tmp_path: Path
) -> None:
    dataset.write_labels("panel", some(dataset), made_by="a coin")
    with DatasetStore(dataset.root, HEADER) as store:  # the same run again changes nothing
        store.finish([], sources={"mug", "bowl"})
    assert len(read_dataset(dataset.root).labels("panel"))

    with DatasetStore(dataset.root, HEADER) as store:
        put(store, "cup")
        store.finish([], sources={"mug", "bowl", "cup"})
    grown = read_dataset(dataset.root)
    for ask in (lambda: grown.labels("panel"), lambda: grown.grasps(labels="panel"),
                lambda: list(grown.batches(labels="panel"))):  # fmt: skip
        with pytest.raises(LabelError, match="for 2 objects, and there are 3; make them again"):
            ask()
    (line,) = overview(grown).labels
    assert line.misfit == "they are for 2 objects, and there are 3"

    write_dataset(tmp_path / "other", "mug", "bowl")
    other = read_dataset(tmp_path / "other")
    other.write_labels("panel", some(other), made_by="a coin")
    folder = tmp_path / "other" / "objects" / "mug"
    folder.rename(tmp_path / "old")
    write_object(folder, "mug", grasps=11)
    with pytest.raises(LabelError, match="the dataset was made anew since"):
        other.labels("panel")


def test_any_change_of_a_table_s_content_changes_the_digest(dataset: Dataset) -> None:
    """The manifests that the digest reads name the content of every file."""
    dataset.write_labels("panel", some(dataset), made_by="a coin")
    assert overview(dataset).labels[0].misfit is None
    manifest = dataset.root / "objects" / "mug" / "object.json"
    said = json.loads(manifest.read_text())
    said["files"]["grasps.parquet"] = 64 * "0"
    manifest.write_text(json.dumps(said))
    with pytest.raises(LabelError, match="made anew"):
        dataset.labels("panel")


@pytest.mark.parametrize("name", ["", ".", "..", "../mug", "a/b", ".hidden", "-x", "a b", 65 * "a"])
def test_names_that_are_no_names_are_refused(dataset: Dataset, name: str) -> None:
    before = contents(dataset.root)
    with pytest.raises(LabelError, match="cannot name labels"):
        dataset.write_labels(name, some(dataset), made_by="a coin")
    with pytest.raises(DatasetError, match="no label table"):
        dataset.labels(name)
    assert contents(dataset.root) == before


def test_a_name_is_taken_once_unless_asked(dataset: Dataset) -> None:
    dataset.write_labels("panel", some(dataset), made_by="a coin")
    with pytest.raises(LabelError, match="has labels 'panel' already"):
        dataset.write_labels("panel", some(dataset, seed=1), made_by="another coin")
    assert dataset.describe_labels("panel")["made_by"] == "a coin"
    dataset.write_labels("panel", some(dataset, seed=1), made_by="another coin", overwrite=True)
    assert dataset.describe_labels("panel")["made_by"] == "another coin"
    assert dataset.labels("panel")["label"].to_pylist() == (
        some(dataset, seed=1).sort_values(["object_id", "scene_id", "grasp_id"])["label"].tolist()
    )
    assert [path.name for path in (dataset.root / "labels").iterdir()] == ["panel"]


WRONG = {
    "no label": (lambda t: t.drop(columns="label"), "lack the column 'label'"),
    "no key": (lambda t: t.drop(columns="grasp_id"), "lack the column 'grasp_id'"),
    "not a table": (lambda _: 3, "not a table"),
    "words": (lambda t: t.assign(label="good"), "'label' must hold true and false, or 1 and 0"),
    "shares": (lambda t: t.assign(label=0.5), "'label' must hold true and false, or 1 and 0"),
    "two": (lambda t: t.assign(label=2), "'label' must hold .*, not 2"),
    "missing": (lambda t: t.assign(label=[None, *t["label"][1:]]), "'label' has missing values"),
    "real ids": (lambda t: t.assign(grasp_id=t["grasp_id"] * 1.0), "'grasp_id' must hold whole"),
    "large ids": (lambda t: t.assign(scene_id=2**40), "'scene_id' does not fit"),
    "number as object": (lambda t: t.assign(object_id=3), "'object_id' must hold text"),
    "score of words": (lambda t: t.assign(score="high"), "'score' must hold numbers"),
    "infinite": (lambda t: t.assign(score=np.inf), "'score' has NaN or infinity"),
    "nan": (
        lambda t: {name: t[name].to_numpy() for name in t if name != "score"}
        | {"object_id": t["object_id"].tolist(), "score": np.full(len(t), np.nan)},
        "'score' has NaN or infinity",
    ),
    "twice": (
        lambda t: pd.concat([t, t[:1]]),
        "grasp .* of scene .* of object .* is labelled more than once",
    ),
    "grasp": (lambda t: t.assign(grasp_id=99), "grasp 99 of scene . of object bowl is not in"),
    "scene": (lambda t: t.assign(scene_id=7), "of scene 7 of object bowl is not in the dataset"),
    "object": (lambda t: t.assign(object_id="jug"), "no object 'jug'"),
    "path": (lambda t: t.assign(object_id="../objects/mug"), "no object '../objects/mug'"),
    "taken": (lambda t: t.assign(force=1.0), "a column 'force' already"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_tables_that_are_wrong_are_refused_by_name(dataset: Dataset, case: str) -> None:
    change, message = WRONG[case]
    with pytest.raises(DatasetError, match=message):
        dataset.write_labels("panel", change(some(dataset)), made_by="a coin")
    assert not (dataset.root / "labels").exists()


def test_labels_may_be_ones_and_zeros_and_have_no_score(dataset: Dataset) -> None:
    given = some(dataset).drop(columns=["score", "judges"])
    dataset.write_labels("panel", given.assign(label=given["label"].astype(np.int8)), made_by="x")
    found = dataset.labels("panel")
    assert found.schema.field("label").type == pa.bool_()
    assert found["score"].null_count == len(found)
    assert int(found["label"].to_pandas().sum()) == int(given["label"].sum())


def test_who_made_them_must_be_said(dataset: Dataset) -> None:
    with pytest.raises(LabelError, match="made_by must say"):
        dataset.write_labels("panel", some(dataset), made_by=" ")


def test_damage_is_named(dataset: Dataset) -> None:
    dataset.write_labels("panel", some(dataset), made_by="a coin")
    folder = dataset.root / "labels" / "panel"
    table = pq.read_table(folder / "labels.parquet")
    pq.write_table(table.slice(1), folder / "labels.parquet")
    with pytest.raises(DatasetError, match=r"labels\.parquet is damaged"):
        dataset.labels("panel")
    (folder / "labels.parquet").unlink()
    with pytest.raises(DatasetError, match=r"cannot read .*labels\.parquet"):
        dataset.labels("panel")
    about = dataset.describe_labels("panel")
    for lacking in ({}, about | {"dataset": {}}, about | {"dataset": None}):
        (folder / "label.json").write_text(json.dumps(lacking))
        for ask in (lambda: dataset.labels("panel"), lambda: overview(dataset)):
            with pytest.raises(DatasetError, match=r"label\.json is damaged: it lacks "):
                ask()


def test_a_write_that_fails_leaves_the_old_table(
    dataset: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset.write_labels("panel", some(dataset), made_by="a coin")
    before = contents(dataset.root)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DatasetError, match="No space left"):
        dataset.write_labels("panel", some(dataset, seed=1), made_by="x", overwrite=True)
    with pytest.raises(DatasetError, match="No space left"):
        dataset.write_labels("new", some(dataset), made_by="x")
    assert contents(dataset.root) == before
