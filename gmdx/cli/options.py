"""What the arguments of commands have in common: their kinds, and lists in one word."""

from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import FlagCreatePairsOff, Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from gmdx.errors import UsageError

T = TypeVar("T")

Objects = Annotated[
    tuple[str, ...],
    Positional,
    arg(
        metavar="OBJECTS...",
        help="any mix of: bundled, bundled:NAME, mesh files, folders, globs, "
        "pybullet:random_urdfs[:N]",
        help_behavior_hint="",
    ),
]
DatasetFolder = Annotated[Path, Positional, arg(metavar="DIR", help="folder of the dataset")]
BenchObjects = Annotated[tuple[str, ...], Positional, arg(metavar="OBJECTS...")]
Folder = Annotated[Path, arg(metavar="DIR")]
File = Annotated[Path, arg(metavar="FILE")]
GripperName = Annotated[str, arg(metavar="NAME|FILE")]
NameList = Annotated[str, arg(metavar="NAME,NAME,...")]
NumberList = Annotated[str, arg(metavar="N,N,...")]
Json = Annotated[FlagCreatePairsOff[bool], arg(help="print JSON instead of a table")]
ConfigFile = Annotated[
    Path | None,
    arg(
        metavar="FILE",
        help="TOML file with settings; flags win over it",
        help_behavior_hint="(default: none)",
    ),
]
CountOrAll = Annotated[
    int | None,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="{None}|INT",
        instance_from_str=lambda words: None if words[0] in ("0", "None") else int(words[0]),
        is_instance=lambda value: value is None or isinstance(value, int),
        str_from_instance=lambda value: [str(value)],
    ),
]  # 0: all
Settings = Annotated[T, arg(name="")]  # its fields are flags of the command itself


def number_list(text: str, *, option: str) -> list[int]:
    """`1,2` as numbers from 1 on; an empty text is none.

    Raises:
        UsageError: Naming the option.
    """
    try:
        found = [int(word) for word in name_list(text)] if text else []
    except ValueError as error:
        raise UsageError(f"{option} takes numbers such as 1,2, not {text!r}") from error
    if found and min(found) < 1:
        raise UsageError(f"{option} takes numbers from 1 on, not {text!r}")
    return found


def name_list(text: str) -> list[str]:
    """`a, b` as names."""
    return [word.strip() for word in text.split(",")]
