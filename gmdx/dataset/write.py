"""One object's folder: scenes and grasps streamed in, so that memory does not grow with them."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from gmdx.arrays import Array
from gmdx.dataset import schema
from gmdx.dataset.contacts import contact_rows, contacts_of
from gmdx.dataset.objects import describe, write_shape
from gmdx.dataset.scenes import image_arrays
from gmdx.dataset.spool import Spool, drained
from gmdx.errors import DatasetError, Failure
from gmdx.files.folder import writing
from gmdx.files.formats import json_text, write_npz, write_parquet, write_text
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.metrics.compute import MetricTable
from gmdx.metrics.quality import Evidence
from gmdx.objects.model import ObjectModel
from gmdx.scenes.camera import DepthImage
from gmdx.scenes.scene import Scene
from gmdx.trials.results import TrialResults

_LABELS = np.array(schema.OUTCOMES, dtype=object)


@dataclass(frozen=True)
class _OpenScene:
    """A scene whose grasps are being written."""

    scene: Scene
    images: Sequence[DepthImage]
    grasps: Spool
    contacts: Spool


class ObjectWriter:
    """Writes one object into a folder that nobody else sees yet.

    Scene by scene: `begin_scene`, `add_grasps` for each block of them, `end_scene`; or
    `drop_scene`, after which it is as if the scene had never begun. Then `close` and `write_cost`.
    """

    def __init__(self, folder: Path, obj: ObjectModel) -> None:
        """Create the folder.

        Raises:
            StorageError: The disk refused, here and in every method.
        """
        self._folder = folder
        self._object = obj
        self._open: _OpenScene | None = None
        self._scenes: list[dict[str, Any]] = []
        self._poses: list[Array] = []  # of the cameras, (views, 4, 4) a scene
        self._intrinsics = np.eye(3)
        self._spools: list[tuple[Spool, Spool]] = []  # grasps and contacts, a pair a scene
        with writing(folder):
            folder.mkdir(parents=True)

    @property
    def grasps(self) -> int:
        """Grasps of the scenes that are complete."""
        return sum(scene["grasps"] for scene in self._scenes)

    def begin_scene(self, scene: Scene, images: Sequence[DepthImage]) -> None:
        """Start on a scene.

        Args:
            scene: The object at rest.
            images: A view each, as many as any other scene has.

        Raises:
            DatasetError: Another scene is open.
        """
        if self._open is not None:
            raise DatasetError(
                f"scene {self._open.scene.scene_id} of {self._object.object_id!r} is still open: "
                "end or drop it first"
            )
        with writing(self._folder):
            self._open = _OpenScene(
                scene=scene,
                images=images,
                grasps=self._spool(scene, "grasps", schema.SCHEMA),
                contacts=self._spool(scene, "contacts", schema.CONTACT_SCHEMA),
            )

    def add_grasps(self, grasps: PlanarGrasp, trials: TrialResults, table: MetricTable) -> None:
        """Write a block of the open scene's grasps; they are on the disk when this returns.

        Args:
            grasps: n of them, ordered by their ids within the scene.
            trials: Their trials.
            table: All their metrics.

        Raises:
            DatasetError: A column of the schema is missing, or there is one too many; or no scene
                is open.
        """
        at = self._opened()
        rows = grasp_rows(at.scene, grasps, table)
        contacts = contact_rows(
            self._object.object_id, at.scene.scene_id, grasps.grasp_id, contacts_of(trials, table)
        )
        with writing(self._folder):
            at.grasps.write(rows)
            at.contacts.write(contacts)

    def end_scene(self) -> None:
        """Complete the open scene.

        Raises:
            DatasetError: No scene is open.
        """
        at = self._opened()
        with writing(self._folder):
            at.grasps.close()
            at.contacts.close()
            arrays = image_arrays(at.scene.scene_id, at.images)
            write_npz(self._folder / schema.SCENES_FILE, arrays, append=True)
        self._spools.append((at.grasps, at.contacts))
        self._poses.append(np.array([image.pose for image in at.images]))
        self._intrinsics = np.asarray(at.images[0].intrinsics)
        self._scenes.append(
            {
                "scene_id": at.scene.scene_id,
                "position": at.scene.position,
                "quaternion": at.scene.quaternion,
                "settle_time": at.scene.settle_time,
                "grasps": at.grasps.count,
            }
        )
        self._open = None

    def drop_scene(self) -> None:
        """Leave nothing of the open scene; without one, do nothing."""
        if self._open is not None:
            with writing(self._folder):
                self._open.grasps.discard()
                self._open.contacts.discard()
            self._open = None

    def close(self, *, failures: Sequence[Failure], evidence: Evidence) -> None:
        """Write what belongs to the whole object; all but its cost is complete after this.

        Args:
            failures: Scenes of this object that were not produced.
            evidence: What the metrics of all scenes rest on.
        """
        obj, folder = self._object, self._folder
        with writing(folder):
            write_shape(folder, obj)
            write_npz(folder / schema.SCENES_FILE, self._scene_arrays(), append=True)
            self._write_tables()
            described = describe(obj, scenes=self._scenes, failures=failures, evidence=evidence)
            described["files"] = {name: _sha256(folder / name) for name in schema.DATA_FILES}
            write_text(folder / schema.OBJECT_FILE, json_text(described))

    def _write_tables(self) -> None:
        grasps, contacts = ([pair[k] for pair in self._spools] for k in (0, 1))
        write_parquet(
            self._folder / schema.GRASPS_FILE,
            drained(grasps, schema.SCHEMA, size=schema.ROW_GROUP),
            schema.SCHEMA,
            row_group=schema.ROW_GROUP,
        )
        write_parquet(
            self._folder / schema.CONTACTS_FILE,
            drained(contacts, schema.CONTACT_SCHEMA, size=schema.CONTACT_ROW_GROUP),
            schema.CONTACT_SCHEMA,
            row_group=schema.CONTACT_ROW_GROUP,
            reals=("x", "y", "z"),
        )

    def write_cost(self, cost: Mapping[str, Any]) -> None:
        """Write seconds by stage, the last file: the folder is complete after this."""
        with writing(self._folder):
            write_text(self._folder / schema.COST_FILE, json_text(cost))

    def _opened(self) -> _OpenScene:
        if self._open is None:
            raise DatasetError(f"no scene of {self._object.object_id!r} is open: begin one first")
        return self._open

    def _spool(self, scene: Scene, name: str, rows: pa.Schema) -> Spool:
        return Spool(self._folder / f"scene{scene.scene_id}.{name}.arrow", rows)

    def _scene_arrays(self) -> dict[str, Array]:
        """What scenes.npz holds besides the images."""
        scenes = self._scenes
        return {
            "scene_id": np.array([scene["scene_id"] for scene in scenes], np.int32),
            "object_pose": np.array([[*at["position"], *at["quaternion"]] for at in scenes]),
            "settle_time": np.array([scene["settle_time"] for scene in scenes]),
            "intrinsics": self._intrinsics,
            "camera_pose": np.array(self._poses),
        }


def grasp_rows(scene: Scene, grasps: PlanarGrasp, table: MetricTable) -> pa.Table:
    """A block of grasps as rows of the schema.

    Raises:
        DatasetError: A column of the schema is missing, or there is one too many.
    """
    if table.outcomes is None:
        raise DatasetError("the metrics are without trials: compute every stage")
    n = len(grasps)
    values: dict[str, Any] = {
        "object_id": np.full(n, scene.object.object_id, dtype=object),
        "scene_id": np.full(n, scene.scene_id),
        "grasp_id": grasps.grasp_id,
        "x": grasps.center[:, 0],
        "y": grasps.center[:, 1],
        "z": grasps.center[:, 2],
        "angle": grasps.angle,
        "width": grasps.width,
        **table.values,
        **table.extra,
        "outcomes": _LABELS[table.outcomes],
    }
    names = {column.name for column in schema.COLUMNS}
    if set(values) != names:
        raise DatasetError(
            f"the columns do not fit the schema: missing {sorted(names - set(values))}, "
            f"unknown {sorted(set(values) - names)}"
        )
    arrays = [pa.array(list(values[f.name]), type=f.type) if pa.types.is_list(f.type)
              else pa.array(values[f.name], type=f.type) for f in schema.SCHEMA]  # fmt: skip
    return pa.Table.from_arrays(arrays, schema=schema.SCHEMA)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
