"""Metrics derived again from the files of a dataset, by code that knows only their definitions."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import trimesh

import gmdx
from gmdx.dataset.contacts import contact_rows, contacts_in
from gmdx.dataset.read import Dataset, read_dataset
from gmdx.dataset.schema import CONTACT_COLUMNS, SOURCES
from gmdx.dataset.store import DatasetStore
from gmdx.dataset.write import ObjectWriter
from gmdx.errors import DatasetError
from gmdx.grasps.sample import sample_grasps
from gmdx.metrics.compute import compute_metrics
from gmdx.metrics.quality import Evidence
from gmdx.scenes.camera import render
from gmdx.scenes.gripper import gripper_record, load_gripper
from gmdx.trials.run import run_trials
from tests.dataset.hand_built import CAMERA, grasps_of, touched, write_dataset
from tests.support import mesh_object, resting_scene, turned_quaternion

FRICTION, PATCH_RADIUS = 0.8, 0.005  # of the defaults


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lopsided L of two bars, twice at rest; its trials end in several ways."""
    bars = [trimesh.creation.box((0.08, 0.02, 0.03)), trimesh.creation.box((0.02, 0.05, 0.02))]
    bars[1].apply_translation([0.028, 0.034, 0.0])
    obj = mesh_object(
        trimesh.boolean.union(bars), object_id="ell", hulls=[bar.vertices for bar in bars]
    )
    root = tmp_path_factory.mktemp("dataset")
    info = {"seed": 7, "gripper": gripper_record(load_gripper())}
    with DatasetStore(root, info) as store:
        attempt = store.attempt("ell")
        writer = ObjectWriter(attempt, obj)
        for scene_id, turn in enumerate([0.0, np.pi / 2]):
            scene = resting_scene(
                obj, quaternion=turned_quaternion((1, 0, 0), turn), yaw=0.7, scene_id=scene_id,
                seed=7,
            )  # fmt: skip
            grasps = sample_grasps(scene, 8)
            writer.begin_scene(scene, [render(scene, config=CAMERA)])
            for part in (grasps[:3], grasps[3:]):
                trials = run_trials(scene, part, trials=1)
                writer.add_grasps(part, trials, compute_metrics(scene, part, trials))
            writer.end_scene()
        writer.close(failures=[], evidence=Evidence())
        writer.write_cost({})
        store.publish(attempt, "ell")
        store.finish([], sources={"ell"})
    return root


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    cosine = abs(a @ b) / (np.linalg.norm(a) * np.linalg.norm(b))
    sine = np.linalg.norm(np.cross(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.arctan2(sine, cosine))


def turned_by(q: np.ndarray) -> np.ndarray:
    """The matrix of a quaternion (wxyz), by Rodrigues' formula."""
    w, v = q[0], q[1:]
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def pair(contacts: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Midpoint and axis of the pads' mean contact points; NaN where a pad has none."""
    means = [
        contacts.loc[contacts["pad"] == side, ["x", "y", "z"]].to_numpy().mean(axis=0)
        if (contacts["pad"] == side).any() else np.full(3, np.nan)
        for side in (0, 1)
    ]  # fmt: skip
    return (means[0] + means[1]) / 2, means[1] - means[0]


def test_metrics_16_to_22_and_32_to_34_follow_from_the_files(root: Path) -> None:
    """Read with pyarrow, numpy and json alone; definitions from the table of the 36 metrics."""
    folder = root / "objects" / "ell"
    box = json.loads((folder / "object.json").read_text())["box"]
    shortest, box_center = min(box["extents"]), np.array(box["center"])
    scenes = np.load(folder / "scenes.npz")
    poses = dict(zip(scenes["scene_id"].tolist(), scenes["object_pose"], strict=True))
    rows = pq.read_table(folder / "grasps.parquet", partitioning=None).to_pandas()
    contacts = pq.read_table(folder / "contacts.parquet", partitioning=None).to_pandas()
    found, expected = [], []
    for row in rows.itertuples():
        mine = contacts[
            (contacts["scene_id"] == row.scene_id) & (contacts["grasp_id"] == row.grasp_id)
        ]
        middle, axis = pair(mine[mine["source"] == "simulative"])
        middle_d, axis_d = pair(mine[mine["source"] == "analytical"])
        pose = poses[row.scene_id]
        to_object = turned_by(pose[3:]).T
        center = to_object @ (np.array([row.x, row.y, row.z]) - pose[:3])
        closing = to_object @ np.array([np.cos(row.angle), np.sin(row.angle), 0.0])
        lengths = [
            np.linalg.norm(axis),
            np.linalg.norm(middle - box_center),
            np.linalg.norm(middle - center),
            np.linalg.norm(middle - middle_d),
        ]
        angles = [angle_between(axis, closing), angle_between(axis, axis_d)]
        found.append([*lengths, *(length / shortest for length in lengths), *angles])
        names = ("real_s_width", "real_s_dis", "real_s_offset_l", "g_offset_l")
        names += (*(f"{name}_norm" for name in names), "real_s_offset_a", "g_offset_a")
        expected.append([getattr(row, name) for name in names])
    np.testing.assert_allclose(np.array(found, float), expected, rtol=0, atol=1e-9, equal_nan=True)
    known = ~np.isnan(expected)
    assert known.any(axis=0).all()  # every metric was compared
    assert (~known).any()  # and some grasp touched nothing


@pytest.mark.parametrize(
    ("source", "metric"),
    [("original", "g_quality"), ("analytical", "real_d_quality"), ("simulative", "real_s_quality")],
)
def test_qualities_of_stored_contacts_lie_within_the_stored_bounds(
    root: Path, source: str, metric: str
) -> None:
    dataset = read_dataset(root)
    obj = dataset.object("ell")
    radius = float(np.linalg.norm(obj.vertices, axis=1).max())
    compared = 0
    for row in dataset.grasps("ell").to_pandas().itertuples():
        one = dataset.contacts("ell", row.scene_id, grasp_id=row.grasp_id, source=source)
        one = one.to_pandas()
        lower, upper = (getattr(row, f"{metric}_{side}") for side in ("lower", "upper"))
        if set(one["pad"]) != {0, 1}:
            assert np.isnan([lower, upper]).all()
            continue
        quality = gmdx.epsilon(
            one[["x", "y", "z"]].to_numpy(),
            one[["normal_x", "normal_y", "normal_z"]].to_numpy(),
            friction=FRICTION,
            torsion=2 / 3 * FRICTION * PATCH_RADIUS,
            torque_scale=radius,
            origin=np.zeros(3),
        )
        assert max(quality.upper, 0.0) >= lower - 1e-12  # 0 without force closure
        assert max(quality.lower, 0.0) <= upper + 1e-12
        compared += upper > 0
    assert compared >= 3


def distance_to_bars(points: np.ndarray, bars: tuple[np.ndarray, ...]) -> np.ndarray:
    """From the surface of two bars along the axes, negative inside (of one bar: a lower bound)."""
    distances = []
    for corners in bars:
        low, high = corners.min(axis=0), corners.max(axis=0)
        q = np.abs(points - (low + high) / 2) - (high - low) / 2
        distances.append(np.linalg.norm(q.clip(min=0), axis=1) + q.max(axis=1).clip(max=0))
    return np.min(distances, axis=0)


def test_contacts_lie_on_the_surface_and_normals_point_inward(root: Path) -> None:
    dataset = read_dataset(root)
    bars = dataset.object("ell").hulls
    rows = dataset.contacts("ell").to_pandas()
    points, normals = rows[["x", "y", "z"]].to_numpy(), rows.filter(like="normal_").to_numpy()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    distance = np.abs(distance_to_bars(points, bars))
    assert distance[rows["source"] != "simulative"].max() < 1e-6  # the union is in single precision
    assert distance.max() < 1e-3  # a soft contact sinks in
    assert distance_to_bars(points + 2e-3 * normals, bars).max() < 1e-4  # 2e-3 if outward


def test_rows_and_contacts_are_each_other_s_inverse() -> None:
    grasps = grasps_of(9)
    sets = {source: touched(grasps, k, seed=k) for k, source in enumerate(SOURCES, start=2)}
    rows = contact_rows("mug", 3, grasps.grasp_id + 40, sets)
    assert rows.schema.names == [column.name for column in CONTACT_COLUMNS]
    order = rows.select(["grasp_id"]).to_pandas()["grasp_id"]
    assert order.is_monotonic_increasing
    wanted = np.array([7, 0, 4])
    for source, contacts in sets.items():
        found = contacts_in(rows, wanted + 40, source)
        for side in (0, 1):
            for k, grasp in enumerate(wanted):
                for name in ("points", "normals"):
                    was = getattr(contacts, name)[grasp, side][contacts.valid[grasp, side]]
                    now = getattr(found, name)[k, side][found.valid[k, side]]
                    np.testing.assert_array_equal(now, was)
    assert len(contacts_in(rows, np.zeros(0, int), "original")) == 0
    assert not contacts_in(rows, np.array([99]), "original").valid.any()


def test_contacts_are_read_by_scene_grasp_and_source(tmp_path: Path) -> None:
    write_dataset(tmp_path, "mug", "bowl")
    dataset: Dataset = read_dataset(tmp_path)
    everything = dataset.contacts().to_pandas()
    for key in ({"scene_id": 1}, {"grasp_id": 3}, {"source": "analytical"}):
        ((name, value),) = key.items()
        expected = everything[(everything[name] == value) & (everything["object_id"] == "mug")]
        found = dataset.contacts("mug", **key).to_pandas()  # type: ignore[arg-type]
        pd.testing.assert_frame_equal(found, expected.reset_index(drop=True))
        assert len(found)
    for column in CONTACT_COLUMNS:
        metadata = dataset.contacts("mug").schema.field(column.name).metadata
        assert metadata[b"unit"].decode() == column.unit
        assert metadata[b"definition"].decode() == column.definition
    with pytest.raises(DatasetError, match="no source 'guessed': there are original, analytical"):
        dataset.contacts(source="guessed")
    with pytest.raises(DatasetError, match="no scene 9"):
        dataset.contacts("mug", 9)
