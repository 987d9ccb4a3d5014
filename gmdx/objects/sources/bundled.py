"""The objects that come with gmdx: `bundled` for all of them, `bundled:NAME` for one."""

import importlib.resources
from collections.abc import Iterator
from pathlib import Path

from gmdx.errors import CatalogError
from gmdx.objects.sources.source import ObjectSource

NAME, KNOWN_AS = "bundled", "bundled, bundled:NAME"


def bundled_names() -> tuple[str, ...]:
    """Names of the objects that come with gmdx."""
    return tuple(sorted(p.stem for p in _folder().glob("*.obj")))


def expand(text: str) -> Iterator[ObjectSource]:
    """The objects that `bundled` or `bundled:NAME` stands for.

    Raises:
        CatalogError: There is no such object.
    """
    names = bundled_names()
    if not names:
        raise CatalogError(f"{text}: no bundled object in {_folder()}; reinstall gmdx")
    wanted = names
    if text != NAME:
        name = text.split(":", 1)[1]
        if name not in names:
            raise CatalogError(f"{text}: no such bundled object; known: {', '.join(names)}")
        wanted = (name,)
    for name in wanted:
        path = _folder() / f"{name}.obj"
        yield ObjectSource(name, path, name, origin=NAME)


def _folder() -> Path:
    return Path(str(importlib.resources.files("gmdx_assets") / "objects"))
