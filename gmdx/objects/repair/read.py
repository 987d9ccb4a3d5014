"""Read a mesh file into one triangle mesh, and refuse what is no mesh, with the reason."""

import io
from pathlib import Path

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gmdx.arrays import Array, Bool, Float, Int
from gmdx.errors import MeshError

FORMATS = frozenset(trimesh.exchange.load.mesh_formats()) - {"xyz", "stl_ascii"}
_TEXT_FORMATS = frozenset({"obj", "off"})
_SMALLEST = 1e-12  # longest side of a mesh, in the file's unit: below, nothing can be computed
_LARGEST = 1e12
_FLAT = 1e-6  # thickness / length below which vertices count as lying in one plane


def read_mesh(path: Path) -> trimesh.Trimesh:
    """All triangles of a mesh file, as they are in the file, in the file's unit.

    The parts of a scene (glb, gltf) are put in their places and joined. Nothing is merged or
    repaired.

    Raises:
        MeshError: The file is missing, empty, truncated, of another kind than its extension
            says, or holds no surface that could bound a volume.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if not path.is_file():
        raise MeshError(f"{path}: no such file")
    if kind not in FORMATS:
        known = ", ".join(sorted(FORMATS))
        raise MeshError(f"{path}: '.{kind}' is no mesh format that is known; known: {known}")
    data = path.read_bytes()
    if not data.strip():
        raise MeshError(f"{path}: the file is empty")
    vertices, faces = _parse(path, kind, data)
    check_triangles(str(path), vertices, faces)
    _refuse_truncated(path, kind, data, vertices, faces)
    return as_trimesh(vertices, faces)


def as_trimesh(vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> trimesh.Trimesh:
    """A trimesh of exactly these vertices and faces."""
    return trimesh.Trimesh(vertices, faces, process=False, validate=False)


def check_triangles(name: str, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> None:
    """Refuse triangles that cannot bound a volume.

    Raises:
        MeshError: There are no or too few faces, coordinates that are not finite, an absurd
            size, or everything lies in one plane.
    """
    if len(faces) == 0:
        raise MeshError(f"{name}: no triangle in it (empty, a point cloud, or not of this format)")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshError(f"{name}: faces refer to vertices that do not exist; the file is damaged")
    used = vertices[used_vertices(faces)]
    bad = int((~np.isfinite(used)).any(axis=1).sum())
    if bad:
        raise MeshError(f"{name}: {bad} of {len(used)} vertices are NaN or infinite")
    if len(faces) < 4:
        raise MeshError(f"{name}: {len(faces)} triangles cannot enclose a volume; 4 are the least")
    size = float(np.ptp(used, axis=0).max())
    if not _SMALLEST < size < _LARGEST or np.abs(used).max() > 1e6 * size:
        raise MeshError(
            f"{name}: longest side {size:.3g}, farthest coordinate {np.abs(used).max():.3g}: "
            "too small, too large or too far from the origin to compute with; rescale it"
        )
    spread = np.linalg.svd((used - used.mean(axis=0)) / size, compute_uv=False)
    if spread[2] < _FLAT * spread[0]:
        raise MeshError(f"{name}: all vertices lie in one plane, so it has no volume")


def used_vertices(faces: Int[Array, "f 3"]) -> Int[Array, "u"]:
    """Indices of the vertices that belong to a face, ascending."""
    return np.flatnonzero(np.bincount(faces.ravel()))


def merge_vertices(
    vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"], *, tolerance: float
) -> tuple[Float[Array, "w 3"], Int[Array, "f 3"]]:
    """One vertex for all that lie within `tolerance` of each other; unused ones are dropped.

    Exporters split vertices along texture seams and between smoothing groups.
    """
    used = used_vertices(faces)
    corner = np.searchsorted(used, faces)
    points, same = np.unique(vertices[used], axis=0, return_inverse=True)
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(len(points), len(points)))
    _, label = connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    return points[first], label[same.ravel()][corner].astype(np.int64)


def edge_counts(faces: Int[Array, "f 3"]) -> Int[Array, "f 3"]:
    """For the edges (01, 12, 20) of each face, how many faces share them."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    key = edges[:, 0] * (int(faces.max(initial=0)) + 1) + edges[:, 1]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    return count[inverse].reshape(-1, 3)


def is_closed(faces: Int[Array, "f 3"]) -> bool:
    """Whether every edge joins exactly two faces."""
    return len(faces) > 0 and bool((edge_counts(faces) == 2).all())


def is_consistent(faces: Int[Array, "f 3"]) -> bool:
    """Whether every edge of a closed surface is run through once in each direction."""
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    key = np.sort(edges[:, 0] * (int(faces.max()) + 1) + edges[:, 1])
    return bool((key[1:] != key[:-1]).all())


def neighbours(faces: Int[Array, "f 3"]) -> tuple[Int[Array, "e 2"], Bool[Array, "e"]]:
    """Pairs of faces that meet at an edge of theirs alone, and whether their windings agree."""
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward = edges[:, 0] < edges[:, 1]
    low, high = edges.min(axis=1), edges.max(axis=1)
    key = low * (int(faces.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    _, start, count = np.unique(key[order], return_index=True, return_counts=True)
    start = start[count == 2]
    a, b = order[start], order[start + 1]
    return np.stack([a // 3, b // 3], axis=1), forward[a] != forward[b]


def patches(faces: Int[Array, "f 3"]) -> Int[Array, "f"]:
    """Label of the patch of each face: faces connected through edges of just two faces."""
    pairs, _ = neighbours(faces)
    graph = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(len(faces), len(faces)))
    label: Array = connected_components(graph, directed=False)[1]
    return label.astype(np.int64)


def _parse(path: Path, kind: str, data: bytes) -> tuple[Array, Array]:
    """Vertices and faces of all parts of a file."""
    if kind in _TEXT_FORMATS:
        if b"\0" in data:
            raise MeshError(f"{path}: binary data, not the text of an {kind} file")
        try:
            data.decode("utf-8")
        except UnicodeDecodeError:
            data = data.decode("latin-1").encode("utf-8")  # names and comments of old exporters
    if kind == "stl":
        _refuse_damaged_stl(path, data)
    try:
        if kind == "gltf":  # refers to files beside it
            scene = trimesh.load_scene(path, process=False, skip_materials=True)
        else:
            scene = trimesh.load_scene(
                io.BytesIO(data), file_type=kind, process=False, skip_materials=True
            )
        parts = [p for p in scene.dump() if isinstance(p, trimesh.Trimesh) and len(p.faces)]
    except Exception as error:  # a parser given garbage may raise anything
        raise MeshError(
            f"{path}: cannot be read as {kind}: truncated, damaged or of another format ({error})"
        ) from error
    if not parts:
        raise MeshError(f"{path}: no triangle in it (empty, a point cloud, or not {kind} at all)")
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    vertices = np.concatenate([np.asarray(p.vertices, float) for p in parts])
    faces = np.concatenate(
        [np.asarray(p.faces, np.int64) + o for p, o in zip(parts, offsets, strict=True)]
    )
    return vertices, faces


def _refuse_damaged_stl(path: Path, data: bytes) -> None:
    """Refuse a binary stl of another length than its header says; parsers take it for text."""
    if b"\0" not in data:
        return
    count = int.from_bytes(data[80:84], "little")
    whole = 84 + 50 * count
    if len(data) != whole:
        raise MeshError(
            f"{path}: {len(data)} bytes where a binary stl of {count} triangles, as its header "
            f"says, has {whole}: truncated, damaged or of another format"
        )


def _refuse_truncated(path: Path, kind: str, data: bytes, vertices: Array, faces: Array) -> None:
    """Refuse text files that end too early; binary ones carry their length and fail to parse."""
    if kind == "obj" and not data.endswith(b"\n"):
        lines = data.splitlines()
        written = {tuple(line.split()[1:4]) for line in lines if line[:2] in (b"v ", b"v\t")}
        used = len(np.unique(vertices[used_vertices(faces)], axis=0))
        if used < 0.99 * len(written):
            raise MeshError(
                f"{path}: ends in the middle of a line, and only {used} of {len(written)} vertices "
                "belong to a face: the file is truncated"
            )
    if kind == "off":
        numbers = [n for line in data.splitlines() for n in line.split(b"#")[0].split()[:4]]
        header = [n for n in numbers[:5] if n.upper() != b"OFF"]
        if len(header) > 1 and len(faces) < int(header[1]):
            raise MeshError(
                f"{path}: {len(faces)} faces where the header says {int(header[1])}: truncated"
            )
