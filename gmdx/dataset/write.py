"""One object's folder: scenes and grasps streamed in, so that memory does not grow with them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.ipc

from gmdx.arrays import Array
from gmdx.dataset import schema
from gmdx.errors import DatasetError, Failure
from gmdx.files.folder import writing
from gmdx.files.formats import json_text, write_npz, write_parquet, write_ply, write_text
from gmdx.grasps.grasp import PlanarGrasp
from gmdx.metrics.compute import MetricTable
from gmdx.metrics.quality import Evidence
from gmdx.objects.model import ObjectModel
from gmdx.scenes.camera import DepthImage
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import TrialResults

_LABELS = np.array([outcome.label for outcome in Outcome], dtype=object)


@dataclass(frozen=True)
class _OpenScene:
    """A scene that is being written."""

    scene: Scene
    images: Sequence[DepthImage]
    spool: Path  # what its grasps are written to first
    stream: Any  # the writer of that file
    grasps: int = 0  # written


class ObjectWriter:
    """Writes one object into a folder that nobody else sees yet.

    A scene's grasps go to a spool of their own first: a scene that fails half-way leaves no rows.
    """

    def __init__(self, folder: Path, obj: ObjectModel) -> None:
        """Create the folder.

        Raises:
            StorageError: The disk refused, here and in every method.
        """
        self._folder = folder
        self._object = obj
        self._spools: list[Path] = []
        self._scenes: list[dict[str, Any]] = []
        self._images: list[Sequence[DepthImage]] = []
        self._open: _OpenScene | None = None
        with writing(folder):
            folder.mkdir(parents=True)

    def begin_scene(self, scene: Scene, images: Sequence[DepthImage]) -> None:
        """Begin a scene with its views; its grasps follow, a block at a time."""
        spool = self._folder / f"scene{scene.scene_id}.arrow"
        with writing(self._folder):
            stream = pa.ipc.new_stream(spool, schema.SCHEMA)
        self._open = _OpenScene(scene, images, spool, stream)

    def add_grasps(self, grasps: PlanarGrasp, trials: TrialResults, table: MetricTable) -> None:
        """Write a block of grasps of the scene that was begun."""
        at = self._scene
        labels = _LABELS[trials.outcome]
        block = rows(at.scene, grasps, {**table.values, **table.extra, "outcomes": labels})
        with writing(self._folder):
            at.stream.write_table(block)
        self._open = replace(at, grasps=at.grasps + len(grasps))

    def end_scene(self) -> None:
        """Keep the scene that was begun."""
        at = self._scene
        with writing(self._folder):
            at.stream.close()
        self._spools.append(at.spool)
        self._images.append(at.images)
        self._scenes.append(
            {
                "scene_id": at.scene.scene_id,
                "position": at.scene.position,
                "quaternion": at.scene.quaternion,
                "settle_time": at.scene.settle_time,
                "grasps": at.grasps,
            }
        )
        self._open = None

    def drop_scene(self) -> None:
        """Leave nothing of the scene that was begun."""
        if self._open is not None:
            self._open.spool.unlink(missing_ok=True)
            self._open = None

    @property
    def _scene(self) -> "_OpenScene":
        if self._open is None:
            raise DatasetError("no scene was begun: call begin_scene before its grasps")
        return self._open

    @property
    def grasps(self) -> int:
        """Grasps written so far."""
        return sum(scene["grasps"] for scene in self._scenes)

    def close(self, *, failures: Sequence[Failure], evidence: Evidence) -> None:
        """Write what belongs to the whole object; all but its cost is complete after this.

        Args:
            failures: Scenes of this object that were not produced.
            evidence: What the metrics of all scenes rest on.
        """
        obj, folder = self._object, self._folder
        with writing(folder):
            write_ply(folder / schema.MESH_FILE, obj.vertices, obj.faces)
            write_npz(folder / schema.HULLS_FILE, _hull_arrays(obj))
            write_npz(folder / schema.SCENES_FILE, self._scene_arrays())
            self._merge_spools()
            described = describe(obj, scenes=self._scenes, failures=failures, evidence=evidence)
            write_text(folder / schema.OBJECT_FILE, json_text(described))

    def write_cost(self, cost: Mapping[str, Any]) -> None:
        """Write seconds by stage, the last file: the folder is complete after this."""
        with writing(self._folder):
            write_text(self._folder / schema.COST_FILE, json_text(cost))

    def _scene_arrays(self) -> dict[str, Array]:
        views = self._images
        return {
            "scene_id": np.array([scene["scene_id"] for scene in self._scenes], np.int32),
            "object_pose": np.array(
                [[*scene["position"], *scene["quaternion"]] for scene in self._scenes]
            ),
            "settle_time": np.array([scene["settle_time"] for scene in self._scenes]),
            "depth": np.array([[v.depth for v in scene] for scene in views], np.float32),
            "segmentation": np.array([[v.segmentation for v in scene] for scene in views]),
            "intrinsics": np.asarray(views[0][0].intrinsics),
            "camera_pose": np.array([[v.pose for v in scene] for scene in views]),
        }

    def _merge_spools(self) -> None:
        path = self._folder / schema.GRASPS_FILE
        write_parquet(path, _regrouped(self._spools), schema.SCHEMA, row_group=schema.ROW_GROUP)
        for spool in self._spools:
            spool.unlink()


def rows(scene: Scene, grasps: PlanarGrasp, columns: Mapping[str, Array]) -> pa.Table:
    """A batch of grasps as rows of the schema.

    Raises:
        DatasetError: A column of the schema is missing, or there is one too many.
    """
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
        **columns,
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


def describe(
    obj: ObjectModel,
    *,
    scenes: Sequence[Mapping[str, Any]],
    failures: Sequence[Failure],
    evidence: Evidence,
) -> dict[str, Any]:
    """What `object.json` says about an object."""
    return {
        "object_id": obj.object_id,
        "scale": obj.scale,
        "mass": obj.mass,
        "friction": obj.friction,
        "inertia": obj.inertia,
        "box": asdict(obj.box),
        "stable_poses": asdict(obj.stable_poses),
        "hulls": len(obj.hulls),
        "report": {key: value for key, value in obj.report.items() if key != "seconds"},
        "scenes": list(scenes),
        "kernels": evidence.kernels,
        "qualities": {name: asdict(tally) for name, tally in evidence.qualities.items()},
        "failures": [asdict(failure) for failure in failures],
    }


def _hull_arrays(obj: ObjectModel) -> dict[str, Array]:
    """Hull vertices end to end, and how many belong to each."""
    return {
        "vertices": np.concatenate([np.zeros((0, 3)), *obj.hulls]),
        "counts": np.array([len(hull) for hull in obj.hulls], np.int64),
    }


def _regrouped(spools: Iterable[Path]) -> Iterator[pa.Table]:
    """The rows of all spools in tables of exactly ROW_GROUP rows, and what is left."""
    held = schema.SCHEMA.empty_table()
    for spool in spools:
        with pa.ipc.open_stream(pa.OSFile(str(spool))) as batches:
            for batch in batches:
                held = pa.concat_tables([held, pa.Table.from_batches([batch])])
                while held.num_rows >= schema.ROW_GROUP:
                    yield held.slice(0, schema.ROW_GROUP).combine_chunks()
                    held = held.slice(schema.ROW_GROUP)
    if held.num_rows:
        yield held.combine_chunks()
