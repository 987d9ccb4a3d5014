"""Mesh files, folders and patterns."""

import glob
import hashlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from gmdx.errors import CatalogError
from gmdx.objects.repair import FORMATS
from gmdx.objects.sources.source import ObjectSource


def file_source(path: Path, *, scale: float = 1.0) -> ObjectSource:
    """The source for one mesh file that need not exist; reading it tells."""
    try:
        digest = hashlib.sha256(path.read_bytes())
    except OSError:
        digest = hashlib.sha256(str(path).encode())
    if scale != 1.0:
        digest.update(repr(scale).encode())
    slug = re.sub(r"[^A-Za-z0-9_.-]+", "_", path.stem).strip("._-")[:60]
    return ObjectSource(
        object_id=f"{slug if slug else 'object'}-{digest.hexdigest()[:8]}",
        path=path,
        name=path.stem,
        scale=scale,
    )


def expand(
    text: str, *, leave_out: Path | None, known_names: Sequence[str]
) -> Iterator[ObjectSource]:
    """The mesh files that a path or a pattern names.

    Args:
        text: A file, a folder, or a glob pattern.
        leave_out: A folder in which folders and patterns find nothing.
        known_names: What else could have been given, for the message.

    Raises:
        CatalogError: It names nothing.
    """
    yield from (file_source(path) for path in _files(text, leave_out, known_names))


def _files(text: str, leave_out: Path | None, known_names: Sequence[str]) -> list[Path]:
    if not text.strip():
        raise CatalogError("an empty name among the objects; '.' is the current folder")
    path = Path(text).expanduser()
    known = ", ".join(sorted(FORMATS))
    if path.is_file():
        return [path]  # taken at its word: if it is no mesh, reading it says so
    if path.is_dir():
        found = _in_folder(path, leave_out)
        if not found:
            raise CatalogError(f"{text}: no mesh file in this folder or below (formats: {known})")
        return found
    if glob.has_magic(text):
        found = []
        for match in sorted(glob.glob(str(path), recursive=True)):  # noqa: PTH207  absolute ones too
            if Path(match).is_dir():
                found += _in_folder(Path(match), leave_out)
            elif _is_mesh(Path(match), leave_out):
                found.append(Path(match))
        if not found:
            raise CatalogError(f"{text}: no mesh file matches this pattern (formats: {known})")
        return found
    raise CatalogError(
        f"{text}: no such file or folder, nor a known name; known names: {', '.join(known_names)}"
    )


def _in_folder(folder: Path, leave_out: Path | None) -> list[Path]:
    """Mesh files in a folder and below, hidden ones left out."""
    return sorted(
        p
        for p in folder.rglob("*")
        if _is_mesh(p, leave_out)
        and p.is_file()
        and not any(part.startswith(".") for part in p.relative_to(folder).parts)
    )


def _is_mesh(path: Path, leave_out: Path | None) -> bool:
    """Whether a file that was found, not named, is to be taken."""
    if path.suffix.lower().lstrip(".") not in FORMATS:
        return False
    return leave_out is None or not path.resolve().is_relative_to(leave_out)
