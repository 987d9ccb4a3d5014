"""Where objects come from: what a user names, resolved to mesh files with stable ids."""

import glob
import hashlib
import importlib.resources
import importlib.util
import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from gmdx.errors import CatalogError
from gmdx.objects.mesh import FORMATS

_BUNDLED = "bundled"
_PYBULLET = "pybullet:random_urdfs"
_log = logging.getLogger("gmdx")


@dataclass(frozen=True)
class ObjectSource:
    """One mesh file to be prepared."""

    object_id: str  # unique in a run, the same in every run, safe as a folder name
    path: Path
    name: str  # the file's name without its extension
    scale: float = 1.0  # metres / unit of the file
    origin: str = "file"  # "bundled", "file" or "pybullet:random_urdfs"


def resolve(
    specs: Sequence[str | Path], *, leave_out: Path | None = None
) -> tuple[ObjectSource, ...]:
    """The mesh files that a list of specifications names, each once, in that order.

    A specification is a file, a folder (searched through all its subfolders for known formats),
    a glob pattern, `bundled` (all of them), `bundled:NAME`, or `pybullet:random_urdfs[:N]`.

    Ids do not depend on what else is in the run: a bundled object's is its name, a PyBullet
    object's is `pybullet-NNN`, a file's is its name and eight digits of its content's hash
    (`mug-1f3a9c02`), so two files of one name in different folders differ, and moving a file
    changes nothing. Copies with the same name and content are numbered (`mug-1f3a9c02-2`); they
    are the same object, so it is no matter which copy gets which number.

    Args:
        specs: What the user names.
        leave_out: A folder in which folders and patterns find nothing: a run's own output.

    Raises:
        CatalogError: A specification names nothing, or needs a package that is not installed.
    """
    if not specs:
        raise CatalogError("no objects given; name files, folders, globs or 'bundled'")
    seen: set[Path] = set()
    taken: set[str] = set()
    result: list[ObjectSource] = []
    for spec in specs:
        for source in _expand(spec, None if leave_out is None else leave_out.resolve()):
            real = source.path.resolve()
            if real in seen:
                continue
            seen.add(real)
            object_id, copy = source.object_id, 1
            while object_id.lower() in taken:  # lower case: some file systems ignore case
                copy += 1
                object_id = f"{source.object_id}-{copy}"
            taken.add(object_id.lower())
            result.append(
                ObjectSource(object_id, source.path, source.name, source.scale, source.origin)
            )
    return tuple(result)


def file_source(path: Path, *, scale: float = 1.0) -> ObjectSource:
    """The source for one mesh file that need not exist; reading it tells."""
    try:
        digest = hashlib.sha256(path.read_bytes())
    except OSError as error:
        _log.warning("%s: %s", path, error.strerror)
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


def bundled_names() -> tuple[str, ...]:
    """Names of the objects that come with gmdx."""
    return tuple(sorted(p.stem for p in _bundled_folder().glob("*.obj")))


def _expand(spec: str | Path, leave_out: Path | None) -> Iterator[ObjectSource]:
    text = str(spec)
    if text == _BUNDLED or text.startswith(_BUNDLED + ":"):
        yield from _bundled(text)
    elif text.startswith("pybullet:"):
        yield from _pybullet(text)
    else:
        yield from (file_source(p) for p in _files(text, leave_out))


def _files(text: str, leave_out: Path | None) -> list[Path]:
    """The mesh files that a path or a pattern names."""
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
        f"{text}: no such file or folder, nor a known name; known names: {_BUNDLED}, "
        f"{_BUNDLED}:NAME, {_PYBULLET}[:N]"
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


def _bundled_folder() -> Path:
    return Path(str(importlib.resources.files("gmdx_assets") / "objects"))


def _bundled(text: str) -> Iterator[ObjectSource]:
    names = bundled_names()
    if not names:
        raise CatalogError(f"{text}: no bundled object in {_bundled_folder()}; reinstall gmdx")
    wanted = names
    if text != _BUNDLED:
        name = text.split(":", 1)[1]
        if name not in names:
            raise CatalogError(f"{text}: no such bundled object; known: {', '.join(names)}")
        wanted = (name,)
    for name in wanted:
        path = _bundled_folder() / f"{name}.obj"
        yield ObjectSource(name, path, name, origin=_BUNDLED)


def _pybullet(text: str) -> Iterator[ObjectSource]:
    """Meshes inside the pybullet wheel, found without importing it."""
    kind, _, limit = text.removeprefix("pybullet:").partition(":")
    if kind != "random_urdfs" or (limit and not (limit.isascii() and limit.isdigit())):
        raise CatalogError(f"{text}: not understood; write {_PYBULLET} or {_PYBULLET}:N")
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or not spec.submodule_search_locations:
        raise CatalogError(
            f"{text}: pybullet is not installed; install it with: pip install 'gmdx[bullet]'"
        )
    folder = Path(next(iter(spec.submodule_search_locations))) / "random_urdfs"
    urdfs = sorted(folder.glob("*/*.urdf"))
    count = int(limit) if limit else len(urdfs)
    if not 1 <= count <= len(urdfs):
        raise CatalogError(f"{text}: pybullet has {len(urdfs)} such objects; ask for 1 to that")
    for urdf in urdfs[:count]:
        mesh = ElementTree.parse(urdf).getroot().find("./link/visual/geometry/mesh")
        if mesh is None or "filename" not in mesh.attrib:
            raise CatalogError(f"{urdf}: names no mesh")
        scales = {float(s) for s in mesh.get("scale", "1").split()}
        if len(scales) != 1:
            raise CatalogError(f"{urdf}: scales {sorted(scales)} differ by axis")
        yield ObjectSource(
            object_id=f"pybullet-{urdf.stem}",
            path=urdf.parent / mesh.attrib["filename"],
            name=urdf.stem,
            scale=scales.pop(),
            origin=_PYBULLET,
        )
