"""A dataset written from hand-made values, for tests of the files alone."""

from pathlib import Path
from typing import Any

import numpy as np

from gmdx.config import as_dict
from gmdx.dataset import schema
from gmdx.dataset.store import DatasetStore
from gmdx.dataset.write import ObjectWriter
from gmdx.errors import Failure
from gmdx.grasps.contact import ClosingContacts
from gmdx.grasps.grasp import PadContacts, PlanarGrasp
from gmdx.metrics.compute import MetricTable
from gmdx.metrics.quality import Evidence, Tally
from gmdx.metrics.table import METRIC_NAMES, STAGES
from gmdx.scenes.camera import CameraConfig, render
from gmdx.scenes.gripper import load_gripper
from gmdx.scenes.physics import PhysicsConfig
from gmdx.scenes.scene import Scene
from gmdx.trials.outcome import Outcome
from gmdx.trials.results import TrialResults
from tests.support import box_object, resting_scene

PHYSICS = PhysicsConfig(patch_radius=0.004)  # not the default, which nobody would have to read
HEADER: dict[str, Any] = {
    "seed": 3,
    "configuration": {"grasps": 10, "trial": {"step": 0.004}, "physics": as_dict(PHYSICS)},
}
EVIDENCE = Evidence(
    kernels={"closing_lines": "numpy"},
    qualities={"g_quality": Tally(9, 7, 8, 2e-5, {"kernel": 9}, audited=2, worst_audit=3e-9)},
)
CAMERA = CameraConfig(width=32, height=24, views=2)


def scene_of(object_id: str, scene_id: int = 0) -> Scene:
    obj = box_object((0.04, 0.05, 0.06), object_id=object_id)
    return resting_scene(obj, yaw=0.1 * scene_id, scene_id=scene_id, seed=3, physics=PHYSICS)


def grasps_of(n: int) -> PlanarGrasp:
    rng = np.random.default_rng(n)
    return PlanarGrasp(
        np.arange(n), rng.normal(size=(n, 3)), rng.uniform(0, np.pi, n), rng.uniform(0, 0.08, n)
    )


def columns_of(grasps: PlanarGrasp) -> dict[str, np.ndarray]:
    """Values for every column past the grasp: each a different function of the grasp's id."""
    made = {}
    for k, column in enumerate(schema.COLUMNS[8:]):
        values = grasps.grasp_id * 100.0 + k
        if str(column.type) == "string":
            made[column.name] = np.array([f"v{v:.0f}" for v in values], dtype=object)
        elif column.name == "outcomes":
            labels = np.array(schema.OUTCOMES, dtype=object)
            made[column.name] = labels[outcomes_of(grasps)]
        elif str(column.type) == "bool":
            made[column.name] = grasps.grasp_id % 2 == 0
        else:
            made[column.name] = values.astype(column.type.to_pandas_dtype())
    return made


def outcomes_of(grasps: PlanarGrasp) -> np.ndarray:
    """Of two trials of each grasp."""
    return np.stack([grasps.grasp_id % len(Outcome), (3 * grasps.grasp_id) % len(Outcome)], axis=1)


def touched(grasps: PlanarGrasp, slots: int, seed: int) -> PadContacts:
    """Contacts that depend on the grasp's id alone; some pads touch nothing."""
    count, one = grasps.grasp_id.max(initial=-1) + 1, (2, slots)
    valid = np.random.default_rng(seed).random((count, *one))[grasps.grasp_id] < 0.6
    points = np.random.default_rng(seed).normal(size=(count, *one, 3))[grasps.grasp_id]
    normals = points / np.linalg.norm(points, axis=3, keepdims=True)
    keep = valid[..., None]
    return PadContacts(np.where(keep, points, np.nan), np.where(keep, normals, np.nan), valid)


def trials_of(grasps: PlanarGrasp) -> TrialResults:
    n, outcome = len(grasps), outcomes_of(grasps)
    return TrialResults(
        grasp_id=grasps.grasp_id,
        gripper=load_gripper(),
        outcome=outcome,
        collision=np.zeros(outcome.shape, bool),
        object_position=np.zeros((n, 4, 3)),
        object_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (n, 4, 1)),
        tool_position=np.zeros((n, 4, 3)),
        contacts=touched(grasps, 12, seed=3),
        opening=np.zeros(n),
        push_force=np.zeros(n),
        push_force_is_lower_bound=np.zeros(n, bool),
        engine="by hand",
        steps=0,
        step_seconds=0.0,
        seconds=0.0,
    )


def table_of(grasps: PlanarGrasp, **changed: np.ndarray) -> MetricTable:
    """What `columns_of` says as a table, some columns changed."""
    columns = columns_of(grasps) | changed
    del columns["outcomes"]
    return MetricTable(
        grasp_id=grasps.grasp_id,
        stages=STAGES,
        values={name: columns.pop(name) for name in METRIC_NAMES if name in columns},
        extra=columns,
        outcomes=outcomes_of(grasps),
        contacts=ClosingContacts(touched(grasps, 1, seed=1), touched(grasps, 5, seed=2)),
        cost={},
        evidence=Evidence(),
    )


def write_object(
    folder: Path, object_id: str, *, grasps: int = 10, scenes: int = 2, batch: int = 4
) -> None:
    first = scene_of(object_id)
    writer = ObjectWriter(folder, first.object)
    for scene_id in range(scenes):
        scene = scene_of(object_id, scene_id)
        images = [render(scene, view=view, config=CAMERA) for view in range(CAMERA.views)]
        every = grasps_of(grasps)
        writer.begin_scene(scene, images)
        for start in range(0, grasps, batch):
            part = every[start : start + batch]
            writer.add_grasps(part, trials_of(part), table_of(part))
        writer.end_scene()
    writer.close(
        failures=[Failure(object_id, scenes, "settle", "SceneError", "it rolled away")],
        evidence=EVIDENCE,
    )
    writer.write_cost({"wall_seconds": {"settle": 1.0}, "cpu_seconds": {"settle": 1.0}})


def write_dataset(root: Path, *object_ids: str) -> None:
    with DatasetStore(root, HEADER) as store:
        for object_id in object_ids:
            attempt = store.attempt(object_id)
            write_object(attempt, object_id)
            store.publish(attempt, object_id)
        failure = Failure("cup", None, "prepare", "MeshError", "no faces")
        store.record([failure])
        store.finish([failure], sources={*object_ids, "cup"})
