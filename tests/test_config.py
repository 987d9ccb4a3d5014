"""Configuration files: what they may say, and what is said when they are wrong."""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from gmdx.config import as_dict, as_toml, differences, load_toml, merge
from gmdx.errors import ConfigError
from gmdx.pipeline.generate import GenerateConfig


@dataclass(frozen=True)
class Point:
    at: float
    of: str


@dataclass(frozen=True)
class Inner:
    """A stage."""

    speed: float = 0.5  # m/s, "fast" # or slow
    steps: int = 3
    """Steps of the thing,
    written below."""
    flags: tuple[bool, ...] = (True,)
    pair: tuple[float, int] = (0.5, 1)
    points: tuple[Point, ...] = (Point(0.1, "a"),)

    def __post_init__(self) -> None:
        if self.steps < 0:
            raise ValueError("steps must not be negative")


@dataclass(frozen=True)
class Outer:
    name: str = "x"  # a name
    mode: Literal["a", "b"] = "a"
    folder: Path | None = None  # optional
    inner: Inner = field(default_factory=Inner)


def test_values_go_where_their_keys_say() -> None:
    values = tomllib.loads(
        'name = "y"\nmode = "b"\nfolder = "here"\n[inner]\nspeed = 2\nflags = [false, true]\n'
        'points = [{ at = 1, of = "b" }]\npair = [1, 2]\n'
    )
    inner = Inner(2.0, 3, (False, True), (1.0, 2), (Point(1.0, "b"),))
    assert merge(Outer(), values) == Outer("y", "b", Path("here"), inner)
    assert isinstance(merge(Outer(), values).inner.speed, float)


@pytest.mark.parametrize("config", [Outer(), GenerateConfig()])
def test_a_printed_configuration_reads_back(config: object) -> None:
    text = as_toml(config)
    assert merge(config, tomllib.loads(text)) == config


def test_comments_say_what_fields_mean() -> None:
    lines = as_toml(Outer()).splitlines()
    assert 'name = "x"  # a name' in lines
    assert "# folder =  # optional" in lines
    assert 'speed = 0.5  # m/s, "fast"' in lines
    assert "steps = 3  # Steps of the thing, written below." in lines


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nmae = 'y'", r"unknown key 'nmae'; the top level knows: folder, inner, mode, name"),
        ("[inner]\nsped = 1", r"unknown key 'inner\.sped'; \[inner\] knows: flags"),
        ("[inner]\nspeed = 'fast'", r"inner\.speed must be float, not 'fast'"),
        ("[inner]\nspeed = true", r"inner\.speed must be float, not True"),
        ("[inner]\nsteps = 1.5", r"inner\.steps must be int, not 1\.5"),
        ("[inner]\nsteps = true", r"inner\.steps must be int, not True"),
        ("[inner]\nsteps = -1", r"\[inner\]: steps must not be negative"),
        ("[inner]\npair = [1]", r"inner\.pair must be"),
        ("[inner]\npoints = [{ at = 1 }]", r"inner\.points\[0\] has the keys at, of, not at"),
        ("mode = 'c'", r"mode must be one of 'a', 'b', not 'c'"),
        ("inner = 3", r"inner is a table"),
        ("name = 3", r"name must be str, not 3"),
    ],
)
def test_mistakes_are_named(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        merge(Outer(), tomllib.loads(text))


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_toml(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("name = ")
    with pytest.raises(ConfigError, match=r"bad\.toml is not valid TOML"):
        load_toml(tmp_path / "bad.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_toml(tmp_path / "binary.toml")


def test_differences_are_listed_by_path() -> None:
    changed = merge(Outer(), {"name": "z", "inner": {"steps": 4}})
    assert differences(as_dict(Outer()), as_dict(changed)) == [
        "inner.steps: 3 -> 4",
        'name: "x" -> "z"',
    ]
    assert "name" not in as_dict(changed, leave_out=("name",))
