"""File formats whose bytes depend on nothing but their content.

What writes a file here does not wait for the disk: `gmdx.files.folder` does, for whatever comes
into place.
"""

import json
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gmdx.arrays import Array, Float, Int
from gmdx.errors import DatasetError

_COMPRESSION_LEVEL = 2  # of zlib: depth images shrink as well as at 6, in a third of the time
_PLY_VERTEX = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
_PLY_FACE = np.dtype([("count", "u1"), ("index", "<i4", (3,))])


def plain(value: Any) -> Any:
    """`value` as JSON knows it: arrays as lists, and NaN and infinity, which it lacks, as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    return str(value)


def json_text(value: Any) -> str:
    """`value` as JSON with sorted keys."""
    return json.dumps(plain(value), indent=1, sort_keys=True, allow_nan=False) + "\n"


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file.

    Raises:
        DatasetError: It cannot be read, is not JSON, or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise DatasetError(f"{path} is not valid JSON ({error}); the dataset is damaged") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path} holds no JSON object; the dataset is damaged")
    return content


def write_text(path: Path, text: str) -> None:
    """Write a text file, with the same ends of lines on every system."""
    path.write_text(text, encoding="utf-8", newline="\n")


def write_npz(path: Path, arrays: Mapping[str, Array], *, append: bool = False) -> None:
    """Write named arrays as a compressed npz file, the same bytes for the same arrays.

    Args:
        path: The file.
        arrays: By name.
        append: Add them to what the file holds; without, it is written anew.
    """
    with (
        path.open("r+b" if append and path.exists() else "w+b") as file,
        zipfile.ZipFile(file, "a") as archive,
    ):
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry._compresslevel = _COMPRESSION_LEVEL  # type: ignore[attr-defined]
            with archive.open(entry, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.ascontiguousarray(array))


def read_npz(path: Path, names: Iterable[str] | None = None) -> dict[str, Array]:
    """The arrays of an npz file; no other than the named ones is decompressed.

    Args:
        path: The file.
        names: Of the arrays to read; all by default.

    Raises:
        DatasetError: It cannot be read, or lacks one of them.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in (archive.files if names is None else names)}
    except KeyError as error:
        raise DatasetError(f"{path} lacks an array: {error}; the dataset is damaged") from error
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise DatasetError(f"cannot read {path}: {error}; the dataset is damaged") from error


def write_parquet(
    path: Path,
    tables: Iterable[pa.Table],
    schema: pa.Schema,
    *,
    row_group: int | None = None,
    compression: str = "zstd",
    reals: Sequence[str] = (),
) -> None:
    """Write tables one after the other as one parquet file.

    Args:
        path: The file.
        tables: With the columns of the schema; drawn one at a time.
        schema: Of the file, metadata included.
        row_group: Rows of each group but a table's last; None: as many as the table has.
        compression: By parquet's name.
        reals: Columns of float64 that hardly repeat: byte plane by byte plane they take a tenth
            less than as a dictionary.
    """
    planes = {
        "use_dictionary": [name for name in schema.names if name not in reals],
        "use_byte_stream_split": list(reals),
    }
    options = {"compression": compression, **(planes if reals else {})}
    with path.open("wb") as file, pq.ParquetWriter(file, schema, **options) as writer:
        for table in tables:
            writer.write_table(table, row_group_size=row_group)


def write_ply(path: Path, vertices: Float[Array, "v 3"], faces: Int[Array, "f 3"]) -> None:
    """Write a triangle mesh as binary PLY in double precision, so that it reads back exactly."""
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    triangles = np.zeros(len(faces), _PLY_FACE)
    triangles["count"], triangles["index"] = 3, faces
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in header).encode("ascii"))
        file.write(np.ascontiguousarray(vertices, "<f8").tobytes())
        file.write(triangles.tobytes())


def read_ply(path: Path) -> tuple[Float[Array, "v 3"], Int[Array, "f 3"]]:
    """Vertices and faces of a mesh that `write_ply` wrote.

    Raises:
        DatasetError: It cannot be read.
    """
    try:
        header, body = path.read_bytes().split(b"end_header\n", 1)
        counts = [int(line.split()[2]) for line in header.splitlines() if line[:7] == b"element"]
        vertices = np.frombuffer(body, _PLY_VERTEX, counts[0])
        faces = np.frombuffer(body, _PLY_FACE, counts[1], offset=vertices.nbytes)
    except (OSError, ValueError, IndexError) as error:
        raise DatasetError(f"cannot read {path}: {error}; the dataset is damaged") from error
    points = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(float)
    return points, faces["index"].astype(np.int64)
