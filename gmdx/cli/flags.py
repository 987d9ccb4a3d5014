"""Flags made from the classes of commands and configurations.

A command is a dataclass: its fields are its arguments, its docstring the help. Where it has a field
`settings`, every field of that configuration, however deep, is a flag too: `--trial.lift-time 0.4`.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Literal,
    Protocol,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    runtime_checkable,
)

import tyro
from tyro.conf import Positional, Suppress
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from gmdx.cli.options import name_list

_HELP, _HELP_ALL = ("-h", "--help"), "--help-all"


@runtime_checkable
class Command(Protocol):
    """What `gmdx` can be asked for."""

    def run(self) -> int:
        """Do it; the exit code."""
        ...


CommandT = TypeVar("CommandT", bound=Command)


def parse(command: type[CommandT], words: Sequence[str], *, prog: str) -> CommandT:
    """The command that the words of a command line ask for; ends the process after a `--help`.

    `--help` leaves out the settings of nested configurations; `--help-all` shows them as well.

    Args:
        command: Its class.
        words: What follows its name.
        prog: Its name, for the help.

    Raises:
        ConfigError: The file given with `--config` is not usable, or a configuration refuses its
            values.
    """
    whole = _HELP_ALL in words
    helping = whole or any(word in words for word in _HELP)
    registry = ConstructorRegistry()
    registry.primitive_rule(_names_first)
    registry.primitive_rule(_with_commas)
    settings = _before_flags(command, words, prog=prog)
    if settings is not None:
        registry.struct_rule(partial(_fields, command, settings, brief=helping and not whole))
    args = ["--help"] if helping else words
    asked: CommandT = tyro.cli(command, prog=prog, args=args, registry=registry)
    return asked


def _before_flags(command: Any, words: Sequence[str], *, prog: str) -> Any:
    """The settings of a command, if it has any: the defaults, and those of its file over them."""
    fields = {field.name: field for field in dataclasses.fields(command)}
    if "settings" not in fields:
        return None
    from gmdx.config import load_toml, merge  # what needs no settings starts without it

    finder = argparse.ArgumentParser(prog=prog, add_help=False, allow_abbrev=False)
    finder.add_argument("--config")
    file = finder.parse_known_args(words)[0].config
    settings = _default(fields["settings"])
    return settings if file is None else merge(settings, load_toml(file))


def _fields(
    command: Any, settings: Any, info: StructTypeInfo, *, brief: bool
) -> StructConstructorSpec | None:
    """The flags of a command and of its settings; the help is what is behind or below the fields.

    Args:
        command: Its class.
        settings: What they are without flags.
        info: The class that tyro asks about, and its instance without flags.
        brief: Leave out what is nested. It is then no flag either, so this is for the help alone.
    """
    from gmdx.config import comments

    if info.type is command:
        defaults = {f.name: _default(f) for f in dataclasses.fields(command)}
        defaults["settings"] = settings
    elif dataclasses.is_dataclass(info.type) and isinstance(info.default, info.type):
        defaults = {f.name: getattr(info.default, f.name) for f in dataclasses.fields(info.type)}
    else:
        return None
    hints, meanings = get_type_hints(info.type, include_extras=True), comments(info.type)
    special = getattr(command, "FLAGS", {})  # by class and name of a setting: the type of its flag
    flags = []
    for name, default in defaults.items():
        kind = special.get((info.type, name), hints[name])
        if brief and info.type is not command and _is_nested(default):
            kind = Annotated[kind, Suppress]
        flags.append(StructFieldSpec(name, kind, default, meanings.get(name, "")))
    return StructConstructorSpec(info.type, tuple(flags))


def _default(field: dataclasses.Field[Any]) -> Any:
    """What a field is where nothing is given; tyro's word for what must be given."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return tyro.MISSING_NONPROP if field.default is dataclasses.MISSING else field.default


def _is_nested(value: Any) -> bool:
    """Whether a setting is settings again, or some of them in a row."""
    items = value if isinstance(value, tuple) else (value,)
    return any(dataclasses.is_dataclass(item) for item in items)


def _names_first(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Of several types, names come before paths, which would take every word for one."""
    members = get_args(info.type)
    names = [member for member in members if _is_literal(member)]
    if info.type_origin is tuple or not names:
        return None
    wanted = names + [m for m in members if m not in names and not (m is str and Path in members)]
    if wanted == [*members]:
        return None
    return _spec(Union[tuple(wanted)], info)  # noqa: UP007


def _is_literal(hint: Any) -> bool:
    origin: Any = get_origin(hint)
    return origin is Literal


def _with_commas(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """A row of any length is one word, `a,b,c`, so that what follows is not taken into it."""
    members = get_args(info.type)
    if info.type_origin is not tuple or Ellipsis not in members or Positional in info.markers:
        return None
    item = _spec(members[0], info)
    if item is None:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{item.metavar},...",
        instance_from_str=lambda words: tuple(
            item.instance_from_str([word]) for word in name_list(words[0]) if word
        ),
        is_instance=lambda value: isinstance(value, tuple) and all(map(item.is_instance, value)),
        str_from_instance=lambda value: [",".join(item.str_from_instance(v)[0] for v in value)],
    )


def _spec(hint: Any, info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """How tyro reads a type, if from a word."""
    made = PrimitiveTypeInfo.make(hint, set(info.markers))
    spec = ConstructorRegistry.get_primitive_spec(made)
    return spec if isinstance(spec, PrimitiveConstructorSpec) else None
