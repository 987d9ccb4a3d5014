"""An object's own files: what `object.json` says, and the shapes that physics saw."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from gmdx.dataset import schema
from gmdx.errors import Failure
from gmdx.files.formats import read_json, read_npz, read_ply, write_npz, write_ply
from gmdx.metrics.quality import Evidence
from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses


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


def write_shape(folder: Path, obj: ObjectModel) -> None:
    """Write an object's surface and hulls."""
    write_ply(folder / schema.MESH_FILE, obj.vertices, obj.faces)
    hulls = {
        "vertices": np.concatenate([np.zeros((0, 3)), *obj.hulls]),
        "counts": np.array([len(hull) for hull in obj.hulls], np.int64),
    }
    write_npz(folder / schema.HULLS_FILE, hulls)


def read_object(folder: Path) -> ObjectModel:
    """The object that a folder holds.

    Raises:
        DatasetError: A file is damaged.
    """
    described = read_json(folder / schema.OBJECT_FILE)
    vertices, faces = read_ply(folder / schema.MESH_FILE)
    packed = read_npz(folder / schema.HULLS_FILE)
    hulls = np.split(packed["vertices"], np.cumsum(packed["counts"])[:-1])
    poses = {key: np.array(value, float) for key, value in described["stable_poses"].items()}
    return ObjectModel(
        object_id=described["object_id"],
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
