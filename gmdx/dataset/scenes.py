"""Scenes in `scenes.npz`: poses by scene, and an array an image, so that each is read alone."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from gmdx.arrays import Array, Float
from gmdx.config import merge
from gmdx.dataset.tables import NotFoundError
from gmdx.errors import ConfigError, DatasetError
from gmdx.files.formats import read_npz
from gmdx.objects.model import ObjectModel
from gmdx.scenes.camera import DepthImage
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene


def image_arrays(scene_id: int, images: Sequence[DepthImage]) -> dict[str, Array]:
    """What differs from pixel to pixel, by the name of the array; a view each."""
    arrays: dict[str, Array] = {}
    for view, image in enumerate(images):
        depth, segmentation = _names(scene_id, view)
        arrays[depth] = np.asarray(image.depth, np.float32)
        arrays[segmentation] = np.asarray(image.segmentation, np.uint8)
    return arrays


@dataclass(frozen=True)
class StoredImages:
    """The views of one scene on disk; a view is read when it is taken, and no other is."""

    path: Path  # of scenes.npz
    scene_id: int
    intrinsics: Float[Array, "3 3"]  # pixels
    poses: Float[Array, "views 4 4"]  # camera to world, m

    @classmethod
    def of(cls, path: Path, scene_id: int) -> "StoredImages":
        """The images of a scene in `scenes.npz`.

        Raises:
            DatasetError: There is no such scene, or the file is damaged.
        """
        at = _at_scene(path, scene_id, "camera_pose")
        return cls(path, scene_id, read_npz(path, ("intrinsics",))["intrinsics"], at["camera_pose"])

    def __len__(self) -> int:
        return len(self.poses)

    def __iter__(self) -> Iterator[DepthImage]:
        return (self[view] for view in range(len(self)))

    def __getitem__(self, view: int) -> DepthImage:
        """One view; a negative one counts from the last.

        Raises:
            IndexError: There is no such view.
            DatasetError: The file is damaged.
        """
        names = _names(self.scene_id, range(len(self))[view])
        arrays = read_npz(self.path, names)
        return DepthImage(arrays[names[0]], arrays[names[1]], self.intrinsics, self.poses[view])


@dataclass(frozen=True)
class SceneView:
    """A scene as it is on disk: the object at rest, and its images."""

    scene: Scene
    images: StoredImages  # by view; each is read when it is taken


def read_scene(
    path: Path, obj: ObjectModel, scene_id: int, *, seed: int, physics: PhysicsConfig
) -> Scene:
    """A scene in `scenes.npz`; no image is read.

    Args:
        path: The file.
        obj: The object of the scene.
        scene_id: Which one.
        seed: Of the run.
        physics: Of the run.

    Raises:
        DatasetError: There is no such scene, or the file is damaged.
    """
    at = _at_scene(path, scene_id, "object_pose", "settle_time")
    return Scene(
        object=obj,
        scene_id=scene_id,
        seed=seed,
        position=at["object_pose"][:3],
        quaternion=at["object_pose"][3:],
        settle_time=float(at["settle_time"]),
        physics=physics,
    )


def read_physics(header: Path, info: Mapping[str, Any]) -> PhysicsConfig:
    """Under which every scene of a dataset was settled and tried.

    Args:
        header: `dataset.json`, for messages.
        info: Its content.

    Raises:
        DatasetError: It does not say, or not in a way that this version knows.
    """
    given = info["configuration"].get("physics", {})
    unsaid = sorted({field.name for field in fields(PhysicsConfig)} - set(given))
    if unsaid:
        raise DatasetError(
            f"{header} does not say under which physics its scenes are: configuration.physics "
            f"lacks {', '.join(unsaid)}; make the dataset anew"
        )
    try:
        return merge(PhysicsConfig(), given, where="physics")
    except ConfigError as error:
        raise DatasetError(f"{header}: {error}") from error


def _at_scene(path: Path, scene_id: int, *names: str) -> dict[str, Any]:
    """What arrays by scene hold for one scene."""
    arrays = read_npz(path, ("scene_id", *names))
    known = arrays["scene_id"].tolist()
    if scene_id not in known:
        raise NotFoundError(f"{path.parent} has no scene {scene_id}; it has {known}")
    return {name: arrays[name][known.index(scene_id)] for name in names}


def _names(scene_id: int, view: int) -> tuple[str, str]:
    """Of the arrays of depth and segmentation."""
    return f"depth_{scene_id}_{view}", f"segmentation_{scene_id}_{view}"
