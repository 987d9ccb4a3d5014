"""Configuration files: TOML in, frozen dataclasses out, unknown keys refused by name.

cattrs structures and refuses, tomlkit writes. What is here: how strict they are, the words of a
refusal, and the comments of the fields.
"""

import ast
import contextlib
import dataclasses
import inspect
import io
import json
import re
import textwrap
import tokenize
import tomllib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import cattrs
import tomlkit
from cattrs.cols import homogenous_tuple_structure_factory
from cattrs.errors import (
    ClassValidationError,
    ForbiddenExtraKeysError,
    IterableValidationError,
    IterableValidationNote,
)
from cattrs.gen import make_hetero_tuple_structure_fn

from gmdx.errors import ConfigError, GmdxError

T = TypeVar("T")
_NONE = "None"  # in a file
_WIDTH = 99  # of a line in a printed file


def load_toml(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ConfigError: There is no such file, or it is not valid TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read configuration {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not valid TOML: {error}") from error


def merge(config: T, values: Mapping[str, Any], *, where: str = "") -> T:
    """A copy of `config` (a dataclass) with `values` in place, tables into nested dataclasses.

    Args:
        config: The defaults.
        values: Keys are field names; a nested mapping goes into a nested dataclass. The text
            "None" is None for a field that may be that.
        where: Dotted path of `config` in the file, for messages.

    Raises:
        ConfigError: A key is unknown, a value has the wrong type, or a dataclass refuses it. All
            that is wrong is named, each with its dotted path.
    """
    merged = _over(_CONVERTER.unstructure(config), values)
    try:
        return _CONVERTER.structure(merged, type(config))
    except ClassValidationError as error:
        raise ConfigError("; ".join(_mistakes(error, where))) from error


def as_dict(config: Any, *, leave_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """The fields of a dataclass as JSON values, without the top-level names in `leave_out`."""
    known = dataclasses.asdict(config)
    plain = {key: value for key, value in known.items() if key not in leave_out}
    restored: dict[str, Any] = json.loads(json.dumps(plain, default=str))
    return restored


def as_toml(config: Any) -> str:
    """A dataclass as a TOML file that a person can edit: each line with its field's comment.

    TOML has no null: a value that is None is written as a comment where that is its default, and
    else as the text "None", which `merge` takes for it.
    """
    document = tomlkit.document()
    _write(document, config)
    return re.sub(r"\n{3,}", "\n\n", tomlkit.dumps(document)).strip() + "\n"


def differences(before: Mapping[str, Any], now: Mapping[str, Any], *, where: str = "") -> list[str]:
    """What differs between two nested mappings, as lines `key: before -> now`."""
    lines: list[str] = []
    for key in sorted({*before, *now}):
        path = f"{where}.{key}" if where else key
        old, new = before.get(key), now.get(key)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            lines += differences(old, new, where=path)
        elif old != new:
            lines.append(f"{path}: {json.dumps(old)} -> {json.dumps(new)}")
    return lines


def comments(cls: type) -> dict[str, str]:
    """What stands behind, within or below each field in a dataclass's source: its meaning."""
    source = textwrap.dedent(inspect.getsource(cls))
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    notes = {token.start[0]: token.string[1:] for token in tokens if token.type == tokenize.COMMENT}
    found: dict[str, str] = {}
    body = ast.parse(source).body[0].body  # type: ignore[attr-defined]
    for statement, following in zip(body, [*body[1:], None], strict=True):
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            continue
        lines = range(statement.lineno, 1 + (statement.end_lineno or statement.lineno))
        behind = [notes[line].split("#")[0].strip() for line in lines if line in notes]
        below = getattr(getattr(following, "value", None), "value", None)
        if behind:
            found[statement.target.id] = " ".join(behind)
        elif isinstance(following, ast.Expr) and isinstance(below, str):
            found[statement.target.id] = " ".join(below.split())
    return found


def _over(base: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `values` in place, tables within tables."""
    tables = {
        key: _over(base[key], value)
        for key, value in values.items()
        if isinstance(base.get(key), Mapping) and isinstance(value, Mapping)
    }
    return {**base, **values, **tables}


def _mistakes(error: ClassValidationError | IterableValidationError, path: str) -> list[str]:
    """What cattrs found wrong at `path` and below it, each with its own dotted path."""
    section = f"[{path}]" if path else "the top level"
    placed, own = error.group_exceptions()
    found = []
    for one in own:  # of the dataclass as a whole
        if isinstance(one, ForbiddenExtraKeysError):
            known = ", ".join(sorted(field.name for field in dataclasses.fields(one.cl)))
            keys = [f"{path}.{key}".lstrip(".") for key in sorted(one.extra_fields)]
            found += [f"unknown key {key!r}; {section} knows: {known}" for key in keys]
        elif isinstance(one, GmdxError | ValueError):
            found.append(f"{section if path else 'the configuration'}: {one}")
        else:
            raise one
    for one, note in placed:  # of one of its values
        key = f"[{note.index}]" if isinstance(note, IterableValidationNote) else f".{note.name}"
        place = f"{path}{key}".lstrip(".")
        if isinstance(one, ClassValidationError | IterableValidationError):
            found += _mistakes(one, place)
        elif isinstance(one, KeyError):
            known = ", ".join(field.name for field in dataclasses.fields(error.cl))
            found.append(f"{place} is missing; {section} has the keys {known}")
        elif dataclasses.is_dataclass(note.type):
            found.append(f"{place} is a table ([{place}]), not a value")
        else:
            found.append(f"{place} {one}")
    return found


def _misfit(value: Any, hint: Any) -> TypeError:
    """That a value is not what its annotation says."""
    words = hint.__name__ if isinstance(hint, type) and get_origin(hint) is None else str(hint)
    if _is_a(Literal, hint):
        words = "one of " + ", ".join(map(repr, get_args(hint)))
    return TypeError(f"must be {words}, not {value!r}")


def _exact(*kinds: type) -> Callable[[Any, Any], Any]:
    """A hook that takes instances of `kinds` only, and no truth value for a number."""

    def take(value: Any, hint: Any) -> Any:
        if not isinstance(value, kinds) or isinstance(value, bool) != (hint is bool):
            raise _misfit(value, hint)
        return hint(value)

    return take


def _literal(value: Any, hint: Any) -> Any:
    """A hook that takes the values of a Literal."""
    if value not in get_args(hint):
        raise _misfit(value, hint)
    return value


def _union(hint: Any, converter: cattrs.Converter) -> Callable[[Any, Any], Any]:
    """A hook that takes the first member that fits: None and names before types."""
    members = [member for member in get_args(hint) if member is not NoneType]
    members.sort(key=lambda member: not _is_a(Literal, member))
    hooks = [(converter.get_structure_hook(member), member) for member in members]

    def take(value: Any, _: Any) -> Any:
        if NoneType in get_args(hint) and value in (None, _NONE):
            return None
        for hook, member in hooks:
            with contextlib.suppress(Exception):
                return hook(value, member)
        raise _misfit(value, hint)

    return take


def _tuple(hint: Any, converter: cattrs.Converter) -> Callable[[Any, Any], Any]:
    """A hook that takes arrays of the right length; a text is none."""
    items = get_args(hint)
    even = Ellipsis in items  # all of one kind, as many as there are
    make = homogenous_tuple_structure_factory if even else make_hetero_tuple_structure_fn
    structure = make(hint, converter)

    def take(value: Any, _: Any) -> Any:
        if not isinstance(value, list | tuple) or not (even or len(value) == len(items)):
            raise _misfit(value, hint)
        return structure(value, hint)

    return take


def _is_a(origin: Any, hint: Any) -> bool:
    return get_origin(hint) is origin


def _converter() -> cattrs.Converter:
    """cattrs, made strict: nothing is converted but a whole number to a float, a text to a path."""
    converter = cattrs.Converter(forbid_extra_keys=True)
    for kind in (bool, int, str):
        converter.register_structure_hook(kind, _exact(kind))
    converter.register_structure_hook(float, _exact(int, float))
    converter.register_structure_hook(Path, _exact(str, Path))
    converter.register_unstructure_hook(Path, lambda path: path)
    origins = (
        (Literal, lambda *_: _literal),
        (tuple, _tuple),
        (Union, _union),
        (UnionType, _union),
    )
    for origin, factory in origins:
        converter.register_structure_hook_factory(partial(_is_a, origin), factory)
    return converter


def _write(container: Any, config: Any) -> None:
    """The fields of a dataclass into a TOML document or table, those that are tables last."""
    meanings = comments(type(config))
    tables = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            tables[field.name] = value
        else:
            value = _NONE if value is None and field.default is not None else value
            _write_line(container, field.name, value, meanings.get(field.name, ""))
    for name, value in tables.items():
        table = tomlkit.table()
        _write(table, value)
        container.add(tomlkit.nl())
        container.add(name, table)


def _write_line(container: Any, name: str, value: Any, meaning: str) -> None:
    """One setting, its meaning behind it or, where that is long, above it."""
    plain = _CONVERTER.unstructure(value)
    if isinstance(plain, list | tuple):
        item: Any = tomlkit.array()
        item.extend(_inline(one) if isinstance(one, dict) else one for one in plain)
    else:
        item = tomlkit.item(
            "" if plain is None else str(plain) if isinstance(plain, Path) else plain
        )
    if len(f"{name} = {item.as_string()}  # {meaning}") > _WIDTH:
        for line in textwrap.wrap(meaning, _WIDTH - 2):
            container.add(tomlkit.comment(line))
        meaning = ""
    if value is None:
        container.add(tomlkit.comment(f"{name} =  # {meaning}" if meaning else f"{name} ="))
        return
    if meaning:
        item.comment(meaning)
        item.trivia.comment_ws = "  "
    container.add(name, item)


def _inline(values: Mapping[str, Any]) -> Any:
    """A table within a line."""
    table = tomlkit.inline_table()
    table.update(values)
    return table


_CONVERTER = _converter()
