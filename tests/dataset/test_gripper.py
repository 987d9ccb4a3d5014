"""A dataset brings its gripper along, and says so when that is not the one it was made with."""

import shutil
from pathlib import Path

import pytest

from gmdx.dataset.read import Dataset, read_dataset
from gmdx.dataset.store import DatasetStore
from gmdx.errors import DatasetError
from gmdx.files.folder import PARTIAL
from gmdx.scenes.gripper import gripper_record, load_gripper

GRIPPER = load_gripper("franka_hand")


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    with DatasetStore(tmp_path, {"seed": 0, "gripper": gripper_record(GRIPPER)}) as store:
        store.put_gripper(GRIPPER)
        store.put_gripper(GRIPPER)  # as a run that continues does
        store.finish([], sources=set())
    return read_dataset(tmp_path)


def test_the_gripper_comes_back(dataset: Dataset) -> None:
    assert gripper_record(dataset.gripper()) == gripper_record(GRIPPER)
    assert sorted(p.name for p in (dataset.root / "gripper").iterdir()) == [
        "franka_hand.xml",
        "gripper.toml",
    ]
    assert not (dataset.root / PARTIAL).exists()


def test_a_changed_model_is_refused_by_name(dataset: Dataset) -> None:
    path = dataset.root / "gripper" / "franka_hand.xml"
    path.write_text(path.read_text().replace("<mujoco", "<!-- lighter --><mujoco", 1))
    with pytest.raises(DatasetError, match=r"gripper 'franka_hand'.*sha256.*remove"):
        dataset.gripper()
    path.write_text(path.read_text()[:300])
    with pytest.raises(DatasetError, match=r"damaged: .*cannot read.*writes it anew"):
        dataset.gripper()


def test_missing_files_are_named(dataset: Dataset) -> None:
    (dataset.root / "gripper" / "franka_hand.xml").unlink()
    with pytest.raises(DatasetError, match="must name an MJCF file beside it"):
        dataset.gripper()
    shutil.rmtree(dataset.root / "gripper")
    with pytest.raises(DatasetError, match=r"has no gripper/gripper\.toml"):
        dataset.gripper()


def test_a_run_that_continues_mends_what_was_removed(dataset: Dataset) -> None:
    shutil.rmtree(dataset.root / "gripper")
    left = dataset.root / PARTIAL / "run-of-the-dead" / "1-gripper"  # killed half-way
    left.mkdir(parents=True)
    (left / "gripper.toml").write_text("name = ")
    with DatasetStore(dataset.root, {"seed": 0, "gripper": gripper_record(GRIPPER)}) as store:
        store.put_gripper(GRIPPER)
    assert gripper_record(dataset.gripper()) == gripper_record(GRIPPER)
