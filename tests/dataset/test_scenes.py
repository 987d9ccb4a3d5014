"""An image is read alone: what else the file holds may be anything."""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from gmdx.dataset import schema
from gmdx.dataset.read import Dataset, read_dataset
from gmdx.errors import DatasetError
from gmdx.scenes.camera import render
from tests.dataset.hand_built import CAMERA, scene_of, write_dataset


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    write_dataset(tmp_path, "mug")
    return read_dataset(tmp_path)


def damage(path: Path, keep: set[str]) -> list[str]:
    """Overwrite the content of every array but the named ones, and return the names of these."""
    with zipfile.ZipFile(path) as archive:
        entries = [e for e in archive.infolist() if e.filename.removesuffix(".npy") not in keep]
    content = bytearray(path.read_bytes())
    for entry in entries:
        start = entry.header_offset + 30
        start += sum(int.from_bytes(content[k : k + 2], "little") for k in (start - 4, start - 2))
        content[start : start + entry.compress_size] = b"\xff" * entry.compress_size
    path.write_bytes(content)
    return [entry.filename for entry in entries]


def test_an_image_is_read_without_any_other(dataset: Dataset) -> None:
    path = dataset.root / "objects" / "mug" / schema.SCENES_FILE
    keep = {"depth_1_1", "segmentation_1_1", "scene_id", "camera_pose", "intrinsics"}
    lost = damage(path, keep)
    assert len(lost) == 2 * 2 * 2 - 2 + 2  # all other images, and the object's poses
    image, expected = dataset.image("mug", 1, 1), render(scene_of("mug", 1), view=1, config=CAMERA)
    for name in ("depth", "segmentation", "intrinsics", "pose"):
        np.testing.assert_array_equal(getattr(image, name), getattr(expected, name))
    for scene_id, view in ((0, 0), (0, 1), (1, 0)):
        with pytest.raises(DatasetError, match=r"cannot read .*scenes\.npz.*damaged"):
            dataset.image("mug", scene_id, view)


def test_a_scene_is_read_without_any_image(dataset: Dataset) -> None:
    path = dataset.root / "objects" / "mug" / schema.SCENES_FILE
    damage(path, {"scene_id", "object_pose", "settle_time", "camera_pose", "intrinsics"})
    view, expected = dataset.scene("mug", 1), scene_of("mug", 1)
    np.testing.assert_array_equal(view.scene.position, expected.position)
    np.testing.assert_array_equal(view.scene.quaternion, expected.quaternion)
    assert len(view.images) == 2
    with pytest.raises(DatasetError, match="damaged"):
        view.images[0]


def test_images_are_a_sequence(dataset: Dataset) -> None:
    images = dataset.images("mug", 0)
    np.testing.assert_array_equal(images[-1].depth, images[1].depth)
    with pytest.raises(IndexError):
        images[2]
    assert len(list(images)) == 2


def test_an_unknown_view_is_an_error(dataset: Dataset) -> None:
    for view in (-1, 2):
        with pytest.raises(DatasetError, match=f"no view {view} of scene 0 .* views 0 to 1"):
            dataset.image("mug", 0, view)
    with pytest.raises(DatasetError, match=r"no scene 5; it has \[0, 1\]"):
        dataset.image("mug", 5)


def test_an_array_that_is_missing_is_named(dataset: Dataset) -> None:
    path = dataset.root / "objects" / "mug" / schema.SCENES_FILE
    arrays = dict(np.load(path))
    del arrays["segmentation_0_1"]
    np.savez(path, **arrays)
    with pytest.raises(DatasetError, match=r"lacks an array: .*segmentation_0_1"):
        dataset.image("mug", 0, 1)
