"""The layout of a dataset: names of files, and the columns of its tables.

```
<root>/
  dataset.json            schema version, configuration, seed, package versions, engine, counts
  gripper/                gripper.toml, the MJCF model that it names, and the model's files
  failures.jsonl          a line for each object or scene that was not produced
  objects/<object_id>/
    object.json           source, repair, scale, mass, inertia, stable poses; scenes and failures;
                          kernels: which engine and implementations ran; qualities: by metric,
                          how many values, how many certified, the worst gap, what an audit found;
                          files: SHA-256 of each file below, cost.json aside
    mesh.ply  hulls.npz   what physics saw
    scenes.npz            an array a scene and view, so that an image is read alone:
                          depth_<scene>_<view> (H, W) float32 m, segmentation_<scene>_<view>
                          uint8; by scene: scene_id, object_pose (x y z, then wxyz), settle_time,
                          camera_pose (scene, view, 4, 4) camera to world; intrinsics (3, 3)
    grasps.parquet        a row per grasp, in the order of (scene_id, grasp_id)
    contacts.parquet      a row per contact point, in the order of the grasps
    cost.json             seconds by stage: what producing this object took
  labels/<name>/          a label table that was added later; see `gmdx.dataset.labels`
    labels.parquet        a row per labelled grasp: object_id, scene_id, grasp_id, label, score, ...
    label.json            what made it, from what, and the digest of the dataset that it is for
```

Every file but `cost.json` holds the same bytes whenever the same command runs with the same
packages: timings are kept apart because they never repeat.
"""

from dataclasses import dataclass

import pyarrow as pa

from gmdx.metrics.table import METRICS
from gmdx.trials.outcome import Outcome

SCHEMA_VERSION = 3

DATASET_FILE = "dataset.json"
FAILURES_FILE = "failures.jsonl"
OBJECTS_FOLDER = "objects"
OBJECT_FILE = "object.json"
MESH_FILE = "mesh.ply"
HULLS_FILE = "hulls.npz"
SCENES_FILE = "scenes.npz"
GRASPS_FILE = "grasps.parquet"
CONTACTS_FILE = "contacts.parquet"
COST_FILE = "cost.json"
GRIPPER_FOLDER = "gripper"
GRIPPER_FILE = "gripper.toml"
LABELS_FOLDER = "labels"
LABELS_FILE = "labels.parquet"
LABEL_FILE = "label.json"

DATA_FILES = (MESH_FILE, HULLS_FILE, SCENES_FILE, GRASPS_FILE, CONTACTS_FILE)  # of an object
RESULT_FILES = (OBJECT_FILE, *DATA_FILES)  # that it must have; its costs may go missing

ROW_GROUP = 4096  # grasps; fixed, so that the bytes do not depend on how grasps were batched
CONTACT_ROW_GROUP = 65536  # contacts, likewise


@dataclass(frozen=True)
class Column:
    """One column of a table."""

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


SOURCES = ("original", "analytical", "simulative")  # of a grasp's contacts
CONTACT = (
    Column("source", pa.string(), "", "original: where the closing line through the grasp's centre "
           "first meets the surface from either side (metric 6); analytical: every first-touch "
           "point of a pad that closes on the object at rest (8 to 15); simulative: what carried "
           "force at the end of closing in the nominal trial (16 to 23)"),
    Column("pad", pa.int8(), "", "0: on the negative side of the closing axis; 1: on the positive"),
    *(Column(axis, pa.float64(), "m", "contact point in the object's frame, whose origin is the "
             "centre of mass") for axis in "xyz"),
    *(Column(f"normal_{axis}", pa.float64(), "", "unit normal into the object, in its frame")
      for axis in "xyz"),
)  # fmt: skip
CONTACT_COLUMNS = (*IDENTITY, *CONTACT)
CONTACT_SCHEMA = pa.schema(
    [column.field for column in CONTACT_COLUMNS],
    metadata={"gmdx_schema_version": str(SCHEMA_VERSION)},
)
