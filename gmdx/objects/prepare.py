"""From a mesh file to an object that can be simulated: repair, scale, mass, hulls, rest poses."""

import hashlib
import json
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from gmdx.arrays import Array, Float
from gmdx.errors import ConfigError, MeshError
from gmdx.geometry import quaternion_matrix
from gmdx.machine.caches import cache_folder
from gmdx.objects.box import smallest_box, smallest_rectangle
from gmdx.objects.cache import cache_key, read_cached, write_cached
from gmdx.objects.decompose import DecomposeConfig, decompose
from gmdx.objects.model import ObjectModel, StablePoses
from gmdx.objects.repair import RepairConfig, RepairedMesh, as_trimesh, read_mesh, repair
from gmdx.objects.sources import ObjectSource, file_source
from gmdx.objects.stable import StableConfig, stable_poses

_PLAUSIBLE = (1e-3, 3.0)  # m, longest side of an object that a gripper could be meant for
_log = logging.getLogger("gmdx")

CacheOption = Path | Literal["user"] | str | None  # a folder


@dataclass(frozen=True)
class PrepareConfig:
    """What an object is made to be. The defaults are the paper's."""

    max_footprint: float = 0.05  # m, shorter side of the footprint in every likely pose at most
    min_probability: float = 0.01  # of a stable pose that counts for the footprint
    mass: float = 0.1  # kg
    friction: float = 0.8  # sliding coefficient
    repair: RepairConfig = field(default_factory=RepairConfig)
    stable: StableConfig = field(default_factory=StableConfig)
    decompose: DecomposeConfig = field(default_factory=DecomposeConfig)

    def __post_init__(self) -> None:
        for name in ("max_footprint", "mass"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}")
        if not (np.isfinite(self.friction) and self.friction >= 0):
            raise ConfigError(f"friction must not be negative, as {self.friction} is")


def load_object(
    path: str | Path,
    *,
    scale: float = 1.0,
    config: PrepareConfig | None = None,
    cache: CacheOption = "user",
) -> ObjectModel:
    """Prepare the object in one mesh file.

    Args:
        path: The mesh file.
        scale: Metres / unit of the file.
        config: What to make of it.
        cache: Folder of objects prepared before, "user" for the user's own, None for none.

    Raises:
        MeshError: The file holds no mesh that can be closed.
        DecompositionError: The mesh could not be approximated by convex hulls.
    """
    return prepare(file_source(Path(path).expanduser(), scale=scale), config=config, cache=cache)


def prepare(
    source: ObjectSource,
    *,
    config: PrepareConfig | None = None,
    cache: CacheOption = "user",
) -> ObjectModel:
    """Prepare one object, or fetch it from the cache.

    The object's `report` says where it came from and all that was done to it. Its entry
    "seconds" is the processor time of each step and alone differs from run to run.

    Raises:
        MeshError: The file holds no mesh that can be closed.
        DecompositionError: The mesh could not be approximated by convex hulls.
    """
    config = PrepareConfig() if config is None else config
    digest = content_hash(source.path)
    folder = cache_folder() if cache == "user" else None if cache is None else Path(cache)
    key = cache_key(digest, source, asdict(config))
    if folder is not None:
        kept = read_cached(folder, key, source)
        if kept is not None:
            return kept
    obj = _prepare(source, digest, config)
    # A run of CoACD that hit its time limit may do better another time: it is not kept.
    timed_out = any("failure" in a for a in obj.report["decomposition"]["attempts"])
    if folder is not None and not timed_out:
        write_cached(folder, key, obj)
    return obj


def content_hash(path: Path) -> str:
    """SHA-256 of a mesh file, and for a gltf also of the buffer files that it refers to.

    Raises:
        MeshError: The file cannot be read.
    """
    try:
        data = path.read_bytes()
        digest = hashlib.sha256(data)
        if path.suffix.lower() == ".gltf":
            for name in _gltf_buffers(data):
                digest.update((path.parent / name).read_bytes())
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def footprint(
    vertices: Float[Array, "v 3"], poses: StablePoses, *, min_probability: float
) -> float:
    """The shorter side of the footprint in the stable pose where it is largest, m.

    The footprint is the rectangle of least area around the object seen from above; axes in the
    plane are arbitrary, so it is turned freely. Poses less probable than `min_probability` do
    not count, unless all are (a ball's).
    """
    likely = poses.probabilities >= min_probability
    if not likely.any():
        likely = np.ones_like(likely)
    corners = vertices[_hull_vertices(vertices)]
    turned = [corners @ quaternion_matrix(q).T for q in poses.quaternions[likely]]
    return max(float(smallest_rectangle(points[:, :2])[1].min()) for points in turned)


def _prepare(source: ObjectSource, digest: str, config: PrepareConfig) -> ObjectModel:
    seconds: dict[str, float] = {}
    with _timed(seconds, "read"):
        raw = read_mesh(source.path)
    warnings = _size_warnings(source, raw)
    with _timed(seconds, "repair"):
        try:
            repaired = repair(raw, config.repair)
        except MeshError as error:
            raise MeshError(f"{source.path}: {error}") from error
    mesh = _centred(repaired.mesh, source.scale)
    with _timed(seconds, "stable poses"):
        poses = stable_poses(mesh.vertices, np.zeros(3), config.stable)
    side = footprint(mesh.vertices, poses, min_probability=config.min_probability)
    factor = min(1.0, config.max_footprint / side)
    mesh = as_trimesh(mesh.vertices * factor, np.asarray(mesh.faces))
    properties = mesh.mass_properties
    with _timed(seconds, "box"):
        box = smallest_box(mesh.vertices)
    with _timed(seconds, "decompose"):
        decomposition = decompose(mesh, config=config.decompose)
    decomposed = {k: v for k, v in decomposition.report.items() if k != "seconds"}
    if repaired.misfit > config.repair.misfit:
        warnings.append(
            f"the surface still passes through itself ({100 * repaired.misfit:.1f} % of its area)"
        )
    if box.extents[2] < 1e-3:
        warnings.append(f"only {1e3 * box.extents[2]:.2f} mm thick")
    _log.debug("%s: prepared in %.1f s", source.object_id, sum(seconds.values()))
    return ObjectModel(
        object_id=source.object_id,
        vertices=np.array(mesh.vertices, float),
        faces=np.array(mesh.faces, np.int64),
        hulls=decomposition.hulls,
        mass=config.mass,
        friction=config.friction,
        inertia=_inertia(source, properties, config.mass),
        scale=source.scale * factor,
        box=box,
        stable_poses=StablePoses(poses.quaternions, poses.heights * factor, poses.probabilities),
        report={
            "source": {
                "file": source.path.name,
                "origin": source.origin,
                "sha256": digest,
                "triangles": len(raw.faces),
                "size": [float(x) for x in raw.extents],
                "watertight": repaired.watertight_source,
                "volume": repaired.source_volume,
            },
            "repair": [{"step": s.name, **s.detail} for s in repaired.steps],
            "surface": _surface(repaired, mesh, properties, source.scale * factor),
            "scaling": {
                "metres_per_unit": source.scale,
                "footprint": side,
                "max_footprint": config.max_footprint,
                "scale": source.scale * factor,
            },
            "decomposition": decomposed,
            "warnings": warnings,
            "seconds": seconds,
        },
    )


def _size_warnings(source: ObjectSource, raw: trimesh.Trimesh) -> list[str]:
    """Complaints about the unit of the file.

    Raises:
        MeshError: The object is too small to be one.
    """
    size = float(raw.extents.max()) * source.scale
    low, high = _PLAUSIBLE
    if size < low:
        raise MeshError(
            f"{source.path}: its longest side is {size:.3g} m, too small to grasp; "
            "if the file is not in metres, rescale it, or give load_object its scale"
        )
    if size <= high:
        return []
    unit = "millimetres" if size / 1000 >= 0.1 * low else "an unknown unit"
    return [f"longest side {size:.3g} m is implausible: source probably in {unit}"]


def _centred(mesh: trimesh.Trimesh, scale: float) -> trimesh.Trimesh:
    """The mesh in metres, with its centre of mass at the origin.

    Integrated about the middle of its bounds: far from the origin, cancellation would spoil it.
    """
    middle = mesh.bounds.mean(axis=0)
    near = as_trimesh((mesh.vertices - middle) * scale, np.asarray(mesh.faces))
    return as_trimesh(near.vertices - near.center_mass, np.asarray(mesh.faces))


def _inertia(source: ObjectSource, properties: Any, mass: float) -> Float[Array, "3 3"]:
    """Inertia of uniform density scaled to the mass, kg m^2.

    Raises:
        MeshError: No body could have it, so the surface is not that of a solid.
    """
    inertia = np.array(properties["inertia"], float) * (mass / float(properties["volume"]))
    inertia = 0.5 * (inertia + inertia.T)
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0 or moments[0] + moments[1] < moments[2] * (1 - 1e-6):
        raise MeshError(
            f"{source.path}: principal moments {moments} kg m^2 belong to no body; "
            "the surface passes through itself too much"
        )
    return inertia


def _surface(
    repaired: RepairedMesh, mesh: trimesh.Trimesh, properties: Any, scale: float
) -> dict[str, Any]:
    volume, source_volume = float(properties["volume"]), repaired.source_volume
    return {
        "triangles": len(mesh.faces),
        "bodies": repaired.bodies,
        "volume": volume,
        "area": float(mesh.area),
        "self_intersecting_share": repaired.misfit,
        "volume_ratio": None if source_volume is None else volume / (scale**3 * source_volume),
    }


def _hull_vertices(vertices: Array) -> Array:
    used: Array = ConvexHull(vertices).vertices
    return used


def _gltf_buffers(data: bytes) -> list[str]:
    """Names of the files beside a gltf that hold its numbers; a damaged one names none."""
    try:
        buffers = json.loads(data).get("buffers", [])
        names = [str(b["uri"]) for b in buffers if "uri" in b]
    except (ValueError, AttributeError, TypeError):
        return []
    return [name for name in names if not name.startswith("data:")]


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = _processor_time()
    yield
    seconds[name] = round(_processor_time() - start, 3)


def _processor_time() -> float:
    """Processor time of this process and of those it has waited for, s."""
    return sum(os.times()[:4])
