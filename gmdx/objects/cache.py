"""Keep prepared objects: one file for each content of a mesh with its settings."""

import contextlib
import functools
import hashlib
import json
import logging
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from gmdx.machine.packages import PREPARING, versions
from gmdx.objects.model import ObjectModel, OrientedBox, StablePoses
from gmdx.objects.sources import ObjectSource

_NOT_PREPARATION = frozenset({"cache.py", "report.py", "sources"})  # of gmdx.objects
_GROUND_FLOOR = ("arrays.py", "geometry.py", "rng.py")  # that preparation builds on
_log = logging.getLogger("gmdx")


def cache_key(sha256: str, source: ObjectSource, settings: dict[str, Any]) -> str:
    """Name for what is prepared from a file's content with these settings by this code."""
    parts = {
        "content": sha256,
        "format": source.path.suffix.lower(),
        "scale": source.scale,
        "settings": settings,
        "code": code_version(),
    }
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:32]


@functools.cache
def code_version() -> str:
    """Hash of the modules that prepare objects, and of the versions of what they build on."""
    digest = hashlib.sha256()
    folder = Path(__file__).parent
    own = [
        module
        for module in folder.rglob("*.py")
        if module.relative_to(folder).parts[0] not in _NOT_PREPARATION
    ]
    ground = [folder.parent / name for name in _GROUND_FLOOR]
    for module in sorted([*own, *ground]):
        digest.update(module.relative_to(folder.parent).as_posix().encode() + module.read_bytes())
    for package, version in versions(PREPARING).items():
        digest.update(f"{package}=={version}\n".encode())
    return digest.hexdigest()


def read_cached(folder: Path, key: str, source: ObjectSource) -> ObjectModel | None:
    """The object kept under a key, under the name of this source; None if there is none.

    A damaged file is reported and taken as absent.
    """
    file = folder / f"{key}.npz"
    if not file.exists():
        return None
    try:
        with np.load(file, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        facts = json.loads(arrays.pop("facts").tobytes())
        report = facts["report"]
        report["source"] |= {"file": source.path.name, "origin": source.origin}
        return ObjectModel(
            object_id=source.object_id,
            vertices=arrays["vertices"],
            faces=arrays["faces"],
            hulls=tuple(np.split(arrays["hulls"], arrays["hull_ends"][:-1])),
            mass=facts["mass"],
            friction=facts["friction"],
            inertia=arrays["inertia"],
            scale=facts["scale"],
            box=OrientedBox(arrays["box_center"], arrays["box_axes"], arrays["box_extents"]),
            stable_poses=StablePoses(
                arrays["pose_quaternions"], arrays["pose_heights"], arrays["pose_probabilities"]
            ),
            report=report,
        )
    except Exception as error:  # whatever a damaged zip, array or text may raise
        _log.warning("cache file %s is damaged and is made anew (%s)", file, error)
        return None


def write_cached(folder: Path, key: str, obj: ObjectModel) -> None:
    """Keep an object under a key; a file is there whole or not at all.

    A folder that cannot be written to is reported, and nothing is kept.
    """
    facts = {
        "mass": obj.mass,
        "friction": obj.friction,
        "scale": obj.scale,
        "report": obj.report,
    }
    part = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".part", delete=False) as file:
            part = Path(file.name)
            np.savez(
                file,
                vertices=obj.vertices,
                faces=obj.faces,
                hulls=np.concatenate(obj.hulls),
                hull_ends=np.cumsum([len(h) for h in obj.hulls]),
                inertia=obj.inertia,
                box_center=obj.box.center,
                box_axes=obj.box.axes,
                box_extents=obj.box.extents,
                pose_quaternions=obj.stable_poses.quaternions,
                pose_heights=obj.stable_poses.heights,
                pose_probabilities=obj.stable_poses.probabilities,
                facts=np.frombuffer(json.dumps(facts).encode(), np.uint8),
            )
        part.replace(folder / f"{key}.npz")
    except OSError as error:
        _log.warning("cannot keep %s in the cache %s: %s", obj.object_id, folder, error)
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()
