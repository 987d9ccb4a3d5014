"""Where objects come from: what a user names, resolved to mesh files with stable ids."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from gmdx.errors import CatalogError
from gmdx.objects.sources import bundled, files, pybullet
from gmdx.objects.sources.source import ObjectSource

_NAMED = (bundled, pybullet)  # a module a kind of source; what none of them names is a file


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


def _expand(spec: str | Path, leave_out: Path | None) -> Iterator[ObjectSource]:
    text = str(spec)
    for source in _NAMED:
        if text == source.NAME or text.startswith(f"{source.NAME}:"):
            yield from source.expand(text)
            return
    known = [source.KNOWN_AS for source in _NAMED]
    yield from files.expand(text, leave_out=leave_out, known_names=known)
