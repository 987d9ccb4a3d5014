"""Configuration files: TOML in, frozen dataclasses out, unknown keys refused by name."""

import ast
import dataclasses
import inspect
import json
import textwrap
import tomllib
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from gmdx.errors import ConfigError, GmdxError

T = TypeVar("T")


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
        values: Keys are field names; a nested mapping goes into a nested dataclass.
        where: Dotted path of `config` in the file, for messages.

    Raises:
        ConfigError: A key is unknown, a value has the wrong type, or the dataclass refuses it.
    """
    fields = {field.name: field for field in dataclasses.fields(config)}  # type: ignore[arg-type]
    hints = get_type_hints(type(config))
    changes = {}
    for key, value in values.items():
        path = f"{where}.{key}" if where else key
        if key not in fields:
            section = f"[{where}]" if where else "the top level"
            raise ConfigError(f"unknown key {path!r}; {section} knows: {', '.join(sorted(fields))}")
        current = getattr(config, key)
        if dataclasses.is_dataclass(current):
            if not isinstance(value, Mapping):
                raise ConfigError(f"{path} is a table ([{path}]), not a value")
            changes[key] = merge(current, value, where=path)
        else:
            changes[key] = _converted(value, hints[key], path)
    try:
        return dataclasses.replace(config, **changes)  # type: ignore[type-var]
    except (GmdxError, ValueError) as error:
        section = f"[{where}]" if where else "the configuration"
        raise ConfigError(f"{section}: {error}") from error


def _converted(value: Any, hint: Any, path: str) -> Any:
    """`value` as the annotation `hint` wants it, or a ConfigError."""
    options = list(_options(hint))
    for option in options:
        if get_origin(option) is Literal and value in get_args(option):
            return value
    for option in options:
        origin = get_origin(option)
        if origin is tuple and isinstance(value, list | tuple):
            items = get_args(option)
            if items[-1] is ...:
                items = (items[0],) * len(value)
            if len(items) == len(value):
                pairs = zip(value, items, strict=True)
                return tuple(_converted(v, i, f"{path}[{k}]") for k, (v, i) in enumerate(pairs))
        if dataclasses.is_dataclass(option) and isinstance(value, Mapping):
            return _record(option, value, path)
        if option is type(None) and value is None:
            return None
        if option is Path and isinstance(value, str | Path):
            return Path(value)
        if option is float and isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        if isinstance(option, type) and type(value) is option:
            return value
    raise ConfigError(f"{path} must be {_named(hint)}, not {value!r}")


def _record(cls: Any, values: Mapping[str, Any], path: str) -> Any:
    """A dataclass inside a list, all of whose fields must be given."""
    hints = get_type_hints(cls)
    if set(values) != set(hints):
        raise ConfigError(f"{path} has the keys {', '.join(hints)}, not {', '.join(values)}")
    return cls(**{key: _converted(values[key], hints[key], f"{path}.{key}") for key in hints})


def _options(hint: Any) -> Iterator[Any]:
    """The members of a union, or the annotation itself."""
    if get_origin(hint) in (Union, types.UnionType):
        yield from get_args(hint)
    else:
        yield hint


def _named(hint: Any) -> str:
    """An annotation in words."""
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(repr, get_args(hint)))
    if isinstance(hint, type) and get_origin(hint) is None:
        return hint.__name__
    return str(hint)


def as_dict(config: Any, *, leave_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """The fields of a dataclass as JSON values, without the top-level names in `leave_out`."""
    known = dataclasses.asdict(config)
    plain = {key: value for key, value in known.items() if key not in leave_out}
    restored: dict[str, Any] = json.loads(json.dumps(plain, default=str))
    return restored


def as_toml(config: Any, *, where: str = "") -> str:
    """A dataclass as a TOML file that a person can edit: each line with its field's comment.

    An unset value (None) is written as a comment, since TOML has no null.
    """
    comments = _comments(type(config))
    lines, tables = [], []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            tables.append(as_toml(value, where=f"{where}.{field.name}" if where else field.name))
            continue
        text = f"# {field.name} =" if value is None else f"{field.name} = {_toml_value(value)}"
        comment = comments.get(field.name, "")
        if len(text) + len(comment) > 95:
            lines += [f"# {line}" for line in textwrap.wrap(comment, 97)]
            comment = ""
        lines.append(f"{text}  # {comment}" if comment else text)
    header = [f"[{where}]"] if where else []
    return "\n\n".join(["\n".join([*header, *lines]), *tables])


def _toml_value(value: Any) -> str:
    """One TOML value; JSON's notation is TOML's for what configurations hold."""
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if dataclasses.is_dataclass(value):
        items = (
            f"{f.name} = {_toml_value(getattr(value, f.name))}" for f in dataclasses.fields(value)
        )
        return "{ " + ", ".join(items) + " }"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, default=str)


def _comments(cls: type) -> dict[str, str]:
    """What stands behind or below each field in the source of a dataclass: its meaning."""
    source = textwrap.dedent(inspect.getsource(cls))
    lines = source.splitlines()
    found: dict[str, str] = {}
    body = ast.parse(source).body[0].body  # type: ignore[attr-defined]
    for statement, following in zip(body, [*body[1:], None], strict=True):
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            continue
        behind = lines[statement.end_lineno - 1].encode()[statement.end_col_offset :].decode()  # type: ignore[operator]
        below = getattr(getattr(following, "value", None), "value", None)
        if "#" in behind:
            found[statement.target.id] = behind.split("#", 1)[1].split("#")[0].strip()
        elif isinstance(following, ast.Expr) and isinstance(below, str):
            found[statement.target.id] = " ".join(below.split())
    return found


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
