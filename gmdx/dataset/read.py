"""Reading a dataset: nothing is loaded before it is asked for."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from gmdx.dataset import schema
from gmdx.dataset.gripper import read_gripper
from gmdx.dataset.label_rows import KEY
from gmdx.dataset.labels import LabelTable, label_names, open_labels, read_about, write_labels
from gmdx.dataset.objects import read_object
from gmdx.dataset.scenes import SceneView, StoredImages, read_physics, read_scene
from gmdx.dataset.store import read_failures
from gmdx.dataset.tables import NotFoundError, chosen, object_folder, object_ids, read_rows
from gmdx.errors import DatasetError, Failure
from gmdx.files.formats import read_json
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.metrics.quality import Evidence, Tally
from gmdx.objects.model import ObjectModel
from gmdx.scenes.camera import DepthImage
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.physics import PhysicsConfig

if TYPE_CHECKING:
    from gmdx.dataset.label_rows import TableLike


@dataclass(frozen=True)
class Dataset:
    """A dataset on disk. Objects are named by id; everything is read when asked for."""

    root: Path
    info: Mapping[str, Any] = field(repr=False)  # dataset.json

    @property
    def objects(self) -> tuple[str, ...]:
        """Ids of the objects, sorted.

        Raises:
            DatasetError: Their folder is gone.
        """
        return object_ids(self.root)

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
        return read_physics(self.root / schema.DATASET_FILE, self.info)

    @property
    def label_tables(self) -> tuple[str, ...]:
        """Names of the label tables, sorted."""
        return label_names(self.root)

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
        described: dict[str, Any] = read_json(self._file(object_id, schema.OBJECT_FILE))
        return described

    def cost(self, object_id: str) -> dict[str, Any]:
        """Seconds by stage that an object took to produce.

        Raises:
            DatasetError: There is no such object.
        """
        return read_json(self._file(object_id, schema.COST_FILE))

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
        labels: str | None = None,
    ) -> pa.Table:
        """Annotated grasps as an arrow table; each field's metadata holds unit and definition.

        Args:
            object_id: Of one object, or of all.
            scene_id: Of one scene, or of all.
            columns: Names of the columns to read; all by default.
            labels: Name of a label table, whose columns come after these: null where a grasp has
                no label.

        Raises:
            DatasetError: There is no such object, scene, column or label table, or the labels do
                not fit the dataset any more.
        """
        table = None if labels is None else open_labels(self.root, self.info, labels)
        ids = self.objects if object_id is None else (object_id,)
        if ids:
            return pa.concat_tables(self._rows(each, scene_id, columns, table) for each in ids)
        empty = chosen(schema.SCHEMA, columns)
        further = [] if table is None else [f for f in table.schema if f.name not in KEY]
        return pa.schema([*empty, *further], empty.metadata).empty_table()

    def batches(
        self, *, columns: Sequence[str] | None = None, labels: str | None = None
    ) -> Iterator[pa.Table]:
        """The grasps object by object, for datasets that do not fit into memory.

        Args:
            columns: As of `grasps`.
            labels: As of `grasps`.

        Raises:
            DatasetError: There is no such column or label table, or the labels do not fit.
        """
        table = None if labels is None else open_labels(self.root, self.info, labels)
        for object_id in self.objects:
            yield self._rows(object_id, None, columns, table)

    def contacts(
        self,
        object_id: str | None = None,
        scene_id: int | None = None,
        *,
        grasp_id: int | None = None,
        source: str | None = None,
    ) -> pa.Table:
        """Contact points of grasps, a row each; each field's metadata holds unit and definition.

        Args:
            object_id: Of one object, or of all.
            scene_id: Of one scene, or of all.
            grasp_id: Of the grasps of one id, or of all.
            source: One of original, analytical and simulative; all by default.

        Raises:
            DatasetError: There is no such object, scene or source.
        """
        if source is not None and source not in schema.SOURCES:
            raise NotFoundError(f"no source {source!r}: there are {', '.join(schema.SOURCES)}")
        only = {"scene_id": scene_id, "grasp_id": grasp_id, "source": source}
        tables = [schema.CONTACT_SCHEMA.empty_table()]
        for name in self.objects if object_id is None else (object_id,):
            self._check_scene(name, scene_id)
            tables.append(read_rows(self._file(name, schema.CONTACTS_FILE), only=only))
        return pa.concat_tables(tables)

    def labels(self, name: str) -> pa.Table:
        """A label table: a row per labelled grasp, in the order of the grasps.

        Raises:
            DatasetError: There is no such table, it is damaged, or the dataset was made anew or
                has grown since.
        """
        return open_labels(self.root, self.info, name).rows()

    def describe_labels(self, name: str) -> dict[str, Any]:
        """What `label.json` says: what made a label table, from what, how many it labels.

        Raises:
            DatasetError: There is no such table.
        """
        return read_about(self.root, name)

    def write_labels(
        self,
        name: str,
        table: "TableLike",
        *,
        made_by: str,
        made_from: Mapping[str, Any] | None = None,
        packages: Sequence[str] = (),
        overwrite: bool = False,
    ) -> None:
        """Add a label table; nothing that is there is touched.

        Args:
            name: Of the table: letters, digits, dots, dashes and underscores.
            table: Columns `object_id`, `scene_id`, `grasp_id`, `label` (true and false, or 1 and
                0), and if there are any `score` (null where a grasp has none) and further ones.
                Grasps may be left out, and come in any order.
            made_by: What made the labels.
            made_from: What they depend on: settings, and names of what was used.
            packages: Further packages that they depend on; their versions are kept.
            overwrite: Replace a table of that name.

        Raises:
            LabelError: The name or the table cannot be taken.
            StorageError: The disk refused.
        """
        write_labels(
            self.root, self.info, name, table,
            made_by=made_by, made_from=made_from, packages=packages, overwrite=overwrite,
        )  # fmt: skip

    def gripper(self) -> Gripper:
        """The gripper that the dataset was made with, from the dataset's own files.

        Raises:
            DatasetError: They are missing, damaged or another gripper's.
        """
        return read_gripper(self.root, self.info["gripper"])

    def object(self, object_id: str) -> ObjectModel:
        """The prepared object, as physics saw it.

        Raises:
            DatasetError: There is no such object, or its files are damaged.
        """
        return read_object(object_folder(self.root, object_id))

    def scene(self, object_id: str, scene_id: int) -> SceneView:
        """One scene: the object's pose, and its images, none of which is read yet.

        Raises:
            DatasetError: There is no such object or scene, or its files are damaged.
        """
        obj, path = self.object(object_id), self._file(object_id, schema.SCENES_FILE)
        scene = read_scene(path, obj, scene_id, seed=int(self.info["seed"]), physics=self.physics)
        return SceneView(scene, StoredImages.of(path, scene_id))

    def images(self, object_id: str, scene_id: int) -> StoredImages:
        """The views of a scene; a view is read when it is taken, and no other is.

        Raises:
            DatasetError: There is no such object or scene, or its files are damaged.
        """
        return StoredImages.of(self._file(object_id, schema.SCENES_FILE), scene_id)

    def image(self, object_id: str, scene_id: int, view: int = 0) -> DepthImage:
        """One view of a scene; no other image is read.

        Raises:
            DatasetError: There is no such object, scene or view, or its files are damaged.
        """
        images = self.images(object_id, scene_id)
        if not 0 <= view < len(images):
            raise NotFoundError(
                f"no view {view} of scene {scene_id} of object {object_id!r}; it has the views "
                f"0 to {len(images) - 1}"
            )
        return images[view]

    def _file(self, object_id: str, name: str) -> Path:
        return object_folder(self.root, object_id) / name

    def _check_scene(self, object_id: str, scene_id: int | None) -> None:
        """Refuse a scene that an object does not have."""
        if scene_id is not None and scene_id not in self.scenes(object_id):
            raise NotFoundError(
                f"object {object_id!r} in {self.root} has no scene {scene_id}; "
                f"it has {list(self.scenes(object_id))}"
            )

    def _rows(
        self,
        object_id: str,
        scene_id: int | None,
        columns: Sequence[str] | None,
        labels: LabelTable | None,
    ) -> pa.Table:
        """Rows of one object, or of one of its scenes."""
        path = self._file(object_id, schema.GRASPS_FILE)
        names, only = chosen(schema.SCHEMA, columns).names, {"scene_id": scene_id}
        self._check_scene(object_id, scene_id)
        if labels is None:
            return read_rows(path, columns=names, only=only)
        keyed = [*names, *(name for name in KEY if name not in names)]
        joined = labels.join(read_rows(path, columns=keyed, only=only), object_id)
        return joined.drop_columns(keyed[len(names) :])


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
            f"{root} has schema version {version} and this gmdx reads {schema.SCHEMA_VERSION}: "
            "make it anew"
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
