"""Reading a dataset: nothing is loaded before it is asked for."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gmdx.config import merge
from gmdx.dataset import schema
from gmdx.dataset.store import read_failures
from gmdx.errors import ConfigError, DatasetError, Failure, UsageError
from gmdx.files.formats import read_json, read_npz, read_ply
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.metrics.quality import Evidence, Tally
from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses
from gmdx.scenes.camera import DepthImage
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene


class NotFoundError(DatasetError, UsageError):
    """There is no such dataset, or nothing of that name in it."""


@dataclass(frozen=True)
class SceneView:
    """A scene as it is on disk: the object at rest, and its images."""

    scene: Scene
    images: tuple[DepthImage, ...]  # by view


@dataclass(frozen=True)
class Dataset:
    """A dataset on disk. Objects are named by id; everything is read when asked for."""

    root: Path
    info: Mapping[str, Any]  # dataset.json

    @property
    def objects(self) -> tuple[str, ...]:
        """Ids of the objects, sorted.

        Raises:
            DatasetError: Their folder is gone.
        """
        folder = self.root / schema.OBJECTS_FOLDER
        if not folder.is_dir():
            raise DatasetError(f"{self.root} has no folder {folder.name}; the dataset is damaged")
        return tuple(sorted(path.name for path in folder.iterdir() if path.is_dir()))

    @property
    def failures(self) -> list[Failure]:
        """The objects and scenes that were not produced."""
        return read_failures(self.root)

    @property
    def physics(self) -> PhysicsConfig:
        """Under which every scene was settled and tried.

        Raises:
            DatasetError: `dataset.json` does not say, or not in a way that this version knows.
        """
        given = self.info["configuration"].get("physics", {})
        unsaid = sorted({field.name for field in fields(PhysicsConfig)} - set(given))
        if unsaid:
            raise DatasetError(
                f"{self.root / schema.DATASET_FILE} does not say under which physics its scenes "
                f"are: configuration.physics lacks {', '.join(unsaid)}; make the dataset anew"
            )
        try:
            return merge(PhysicsConfig(), given, where="physics")
        except ConfigError as error:
            raise DatasetError(f"{self.root / schema.DATASET_FILE}: {error}") from error

    def scenes(self, object_id: str) -> tuple[int, ...]:
        """Ids of an object's scenes.

        Raises:
            DatasetError: There is no such object.
        """
        return tuple(int(scene["scene_id"]) for scene in self.describe(object_id)["scenes"])

    def describe(self, object_id: str) -> dict[str, Any]:
        """What `object.json` says: provenance, repair, mass, scenes, failures.

        Raises:
            DatasetError: There is no such object.
        """
        described: dict[str, Any] = read_json(self._folder(object_id) / schema.OBJECT_FILE)
        return described

    def cost(self, object_id: str) -> dict[str, Any]:
        """Seconds by stage that an object took to produce.

        Raises:
            DatasetError: There is no such object.
        """
        cost: dict[str, Any] = read_json(self._folder(object_id) / schema.COST_FILE)
        return cost

    def evidence(self, object_id: str) -> Evidence:
        """What the metrics of an object rest on: kernels that ran, how well qualities are known.

        Raises:
            DatasetError: There is no such object.
        """
        described = self.describe(object_id)
        tallies = {name: Tally(**tally) for name, tally in described["qualities"].items()}
        return Evidence(described["kernels"], tallies)

    def grasps(
        self,
        object_id: str | None = None,
        scene_id: int | None = None,
        *,
        columns: Sequence[str] | None = None,
    ) -> pa.Table:
        """Annotated grasps as an arrow table; each field's metadata holds unit and definition.

        Args:
            object_id: Of one object, or of all.
            scene_id: Of one scene, or of all.
            columns: Names of the columns to read; all by default.

        Raises:
            DatasetError: There is no such object, scene or column.
        """
        ids = self.objects if object_id is None else (object_id,)
        tables = [self._rows(name, scene_id, columns) for name in ids]
        if not tables:
            return self._schema(columns).empty_table()
        return pa.concat_tables(tables)

    def batches(self, *, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """The grasps object by object, for datasets that do not fit into memory.

        Raises:
            DatasetError: There is no such column.
        """
        for object_id in self.objects:
            yield self._rows(object_id, None, columns)

    def object(self, object_id: str) -> ObjectModel:
        """The prepared object, as physics saw it.

        Raises:
            DatasetError: There is no such object, or its files are damaged.
        """
        folder = self._folder(object_id)
        described = self.describe(object_id)
        vertices, faces = read_ply(folder / schema.MESH_FILE)
        packed = read_npz(folder / schema.HULLS_FILE)
        hulls = np.split(packed["vertices"], np.cumsum(packed["counts"])[:-1])
        poses = {key: np.array(value, float) for key, value in described["stable_poses"].items()}
        return ObjectModel(
            object_id=object_id,
            vertices=vertices,
            faces=faces,
            hulls=tuple(hulls),
            mass=described["mass"],
            friction=described["friction"],
            inertia=np.array(described["inertia"]),
            scale=described["scale"],
            box=OrientedBox(**{key: np.array(value) for key, value in described["box"].items()}),
            stable_poses=StablePoses(
                quaternions=poses["quaternions"].reshape(-1, 4),
                heights=poses["heights"],
                probabilities=poses["probabilities"],
            ),
            report=described["report"],
        )

    def scene(self, object_id: str, scene_id: int) -> SceneView:
        """One scene: the object's pose, and depth and segmentation by view.

        Raises:
            DatasetError: There is no such object or scene, or its files are damaged.
        """
        obj = self.object(object_id)
        arrays = read_npz(self._folder(object_id) / schema.SCENES_FILE)
        known = arrays["scene_id"].tolist()
        if scene_id not in known:
            raise NotFoundError(
                f"object {object_id!r} in {self.root} has no scene {scene_id}; it has {known}"
            )
        k = known.index(scene_id)
        pose = arrays["object_pose"][k]
        images = tuple(
            DepthImage(
                depth=arrays["depth"][k, view],
                segmentation=arrays["segmentation"][k, view],
                intrinsics=arrays["intrinsics"],
                pose=arrays["camera_pose"][k, view],
            )
            for view in range(arrays["depth"].shape[1])
        )
        scene = Scene(
            object=obj,
            scene_id=scene_id,
            seed=int(self.info["seed"]),
            position=pose[:3],
            quaternion=pose[3:],
            settle_time=float(arrays["settle_time"][k]),
            physics=self.physics,
        )
        return SceneView(scene=scene, images=images)

    def _folder(self, object_id: str) -> Path:
        folder = self.root / schema.OBJECTS_FOLDER / object_id
        if Path(object_id).name != object_id or object_id in ("", "..") or not folder.is_dir():
            known = ", ".join(self.objects[:8]) + (", ..." if len(self.objects) > 8 else "")
            raise NotFoundError(f"{self.root} has no object {object_id!r}; it has: {known}")
        return folder

    def _schema(self, columns: Sequence[str] | None) -> pa.Schema:
        """The schema of the named columns."""
        if columns is None:
            return schema.SCHEMA
        unknown = sorted(set(columns) - set(schema.SCHEMA.names))
        if unknown:
            raise NotFoundError(
                f"no column {unknown[0]!r}; the columns are: {', '.join(schema.SCHEMA.names)}"
            )
        return pa.schema([schema.SCHEMA.field(name) for name in columns])

    def _rows(
        self, object_id: str, scene_id: int | None, columns: Sequence[str] | None
    ) -> pa.Table:
        """Rows of one object, or of one of its scenes."""
        path = self._folder(object_id) / schema.GRASPS_FILE
        names = self._schema(columns).names
        if scene_id is not None and scene_id not in self.scenes(object_id):
            raise NotFoundError(
                f"object {object_id!r} in {self.root} has no scene {scene_id}; "
                f"it has {list(self.scenes(object_id))}"
            )
        chosen = None if scene_id is None else [("scene_id", "==", scene_id)]
        try:
            return pq.read_table(path, columns=names, filters=chosen, partitioning=None)
        except (OSError, pa.ArrowInvalid) as error:
            raise DatasetError(f"cannot read {path}: {error}; the dataset is damaged") from error


def read_dataset(path: str | Path) -> Dataset:
    """Open a dataset; reads `dataset.json` and nothing else.

    Args:
        path: The folder that `gmdx generate` wrote.

    Raises:
        DatasetError: It is not a dataset, or of a schema that this version does not know.
    """
    root = Path(path)
    header = root / schema.DATASET_FILE
    if not header.is_file():
        raise NotFoundError(f"{root} is not a gmdx dataset: it has no {schema.DATASET_FILE}")
    info = read_json(header)
    version = info.get("schema_version")
    if version != schema.SCHEMA_VERSION:
        raise DatasetError(
            f"{root} has schema version {version}; this gmdx reads {schema.SCHEMA_VERSION}"
        )
    return Dataset(root=root, info=info)


def grasps_in(rows: pa.Table) -> PlanarGrasp:
    """The grasps of a table's rows."""
    return PlanarGrasp(
        grasp_id=rows["grasp_id"].to_numpy(),
        center=np.stack([rows[axis].to_numpy() for axis in "xyz"], axis=1),
        angle=rows["angle"].to_numpy(),
        width=rows["width"].to_numpy(),
    )
