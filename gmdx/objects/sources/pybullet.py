"""The objects that come with PyBullet: `pybullet:random_urdfs[:N]`."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from gmdx.errors import CatalogError
from gmdx.objects.sources.source import ObjectSource

NAME, KNOWN_AS = "pybullet", "pybullet:random_urdfs[:N]"
_COLLECTION = "random_urdfs"
_ORIGIN = f"{NAME}:{_COLLECTION}"


def expand(text: str) -> Iterator[ObjectSource]:
    """Meshes inside the pybullet wheel, found without importing it.

    Raises:
        CatalogError: The name is not understood, or PyBullet is not installed.
    """
    kind, _, limit = text.removeprefix(f"{NAME}:").partition(":")
    if kind != _COLLECTION or (limit and not (limit.isascii() and limit.isdigit())):
        raise CatalogError(f"{text}: not understood; write {_ORIGIN} or {_ORIGIN}:N")
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or not spec.submodule_search_locations:
        raise CatalogError(
            f"{text}: pybullet is not installed; install it with: pip install 'gmdx[bullet]'"
        )
    folder = Path(next(iter(spec.submodule_search_locations))) / _COLLECTION
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
            origin=_ORIGIN,
        )
