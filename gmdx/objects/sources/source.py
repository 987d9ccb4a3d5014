"""One mesh file to be prepared."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ObjectSource:
    """One mesh file to be prepared."""

    object_id: str  # unique in a run, the same in every run, safe as a folder name
    path: Path
    name: str  # the file's name without its extension
    scale: float = 1.0  # metres / unit of the file
    origin: str = "file"  # "bundled", "file" or "pybullet:random_urdfs"
