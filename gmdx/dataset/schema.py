"""The layout of a dataset: names of files, and the columns of `grasps.parquet`.

```
<root>/
  dataset.json            schema version, configuration, seed, package versions, engine, counts
  failures.jsonl          a line for each object or scene that was not produced
  objects/<object_id>/
    object.json           source, repair, scale, mass, inertia, stable poses; scenes and failures;
                          kernels: which engine and implementations ran; qualities: by metric,
                          how many values, how many certified, the worst gap, what an audit found
    mesh.ply  hulls.npz   what physics saw
    scenes.npz            by scene and view: depth (scene, view, H, W) float32 m, segmentation
                          uint8, intrinsics (3, 3), camera_pose (scene, view, 4, 4) camera to
                          world; by scene: scene_id, object_pose (x y z, then wxyz), settle_time
    grasps.parquet        a row per grasp, in the order of (scene_id, grasp_id)
    cost.json             seconds by stage: what producing this object took
```

Every file but `cost.json` holds the same bytes whenever the same command runs with the same
packages: timings are kept apart because they never repeat.
"""

from dataclasses import dataclass

import pyarrow as pa

from gmdx.metrics.table import METRICS
from gmdx.trials.outcome import Outcome

SCHEMA_VERSION = 2

DATASET_FILE = "dataset.json"
FAILURES_FILE = "failures.jsonl"
OBJECTS_FOLDER = "objects"
OBJECT_FILE = "object.json"
MESH_FILE = "mesh.ply"
HULLS_FILE = "hulls.npz"
SCENES_FILE = "scenes.npz"
GRASPS_FILE = "grasps.parquet"
COST_FILE = "cost.json"

ROW_GROUP = 4096  # rows; fixed, so that the bytes do not depend on how grasps were batched


@dataclass(frozen=True)
class Column:
    """One column of `grasps.parquet`."""

    name: str
    type: pa.DataType
    unit: str
    definition: str

    @property
    def field(self) -> pa.Field:
        """The parquet field; unit and definition go into its metadata."""
        return pa.field(
            self.name, self.type, metadata={"unit": self.unit, "definition": self.definition}
        )


OUTCOMES = tuple(outcome.label for outcome in Outcome)
IDENTITY = (
    Column("object_id", pa.string(), "", "object, the name of its folder"),
    Column("scene_id", pa.int32(), "", "scene of the object"),
    Column("grasp_id", pa.int64(), "", "grasp of the scene"),
)
GRASP = (
    Column("x", pa.float64(), "m", "grasp centre in the world"),
    Column("y", pa.float64(), "m", "grasp centre in the world"),
    Column("z", pa.float64(), "m", "grasp centre in the world, above the table"),
    Column("angle", pa.float64(), "rad", "closing axis about the world's z, in [0, pi)"),
    Column("width", pa.float64(), "m", "opening between the pads before closing"),
)
METRIC_COLUMNS = tuple(
    Column(metric.name, pa.float64(), metric.unit, f"#{metric.number} ({metric.kind}): "
           f"{metric.definition}")
    for metric in METRICS
)  # fmt: skip
BOUNDS = tuple(
    Column(f"{metric.name}_{side}", pa.float64(), metric.unit, f"proven {side} bound of "
           f"{metric.name}")
    for metric in METRICS if metric.is_quality for side in ("lower", "upper")
)  # fmt: skip
OUTCOME = (
    Column("force_is_lower_bound", pa.bool_(), "", "whether the push ended before the object came "
           "out, so that force is a lower bound"),
    Column("valid_trials", pa.int32(), "", "trials that neither diverged nor overflowed: what "
           "sim_success and sim_coll are shares of"),
    Column("outcome", pa.string(), "", f"of the nominal trial: {', '.join(OUTCOMES)}"),
    Column("outcomes", pa.list_(pa.string()), "", "of every trial; the first is the nominal one"),
)  # fmt: skip
COLUMNS = (*IDENTITY, *GRASP, *METRIC_COLUMNS, *BOUNDS, *OUTCOME)
SCHEMA = pa.schema(
    [column.field for column in COLUMNS], metadata={"gmdx_schema_version": str(SCHEMA_VERSION)}
)
