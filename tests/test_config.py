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


@dataclass(frozen=True)
class Choices:
    """What may be of several types."""

    cache: Path | Literal["user"] | str | None = "user"
    most: int | None = 2
    rate: float | None = None
    tiny: float = 1e-12  # written within
    inner: Inner = field(default_factory=lambda: Inner(speed=9.0))


@dataclass(frozen=True)
class Wordy:
    size: int = 1
    """word word word word word word word word word word word word word word word
    word word word word word word word word word word word word word word word"""


def test_values_go_where_their_keys_say() -> None:
    values = tomllib.loads(
        'name = "y"\nmode = "b"\nfolder = "here"\n[inner]\nspeed = 2\nflags = [false, true]\n'
        'points = [{ at = 1, of = "b" }]\npair = [1, 2]\n'
    )
    inner = Inner(2.0, 3, (False, True), (1.0, 2), (Point(1.0, "b"),))
    assert merge(Outer(), values) == Outer("y", "b", Path("here"), inner)
    assert isinstance(merge(Outer(), values).inner.speed, float)


@pytest.mark.parametrize(
    "config", [Outer(), Choices(cache=Path("a b\\c"), rate=1e300), GenerateConfig()]
)
def test_a_printed_configuration_reads_back(config: object) -> None:
    text = as_toml(config)
    assert merge(config, tomllib.loads(text)) == config


def test_comments_say_what_fields_mean() -> None:
    lines = as_toml(Outer()).splitlines()
    assert 'name = "x"  # a name' in lines
    assert "# folder =  # optional" in lines
    assert 'speed = 0.5  # m/s, "fast"' in lines
    assert "steps = 3  # Steps of the thing, written below." in lines
    assert 'points = [{at = 0.1, of = "a"}]' in lines
    assert "tiny = 1e-12  # written within" in as_toml(Choices()).splitlines()


def test_a_long_comment_stands_above_its_line() -> None:
    lines = as_toml(Wordy()).splitlines()
    assert max(map(len, lines)) <= 99
    assert lines[-1] == "size = 1"
    assert " ".join(line.removeprefix("# ") for line in lines[:-1]) == " ".join(["word"] * 30)


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
        ("[inner]\npair = 'ab'", r"inner\.pair must be"),
        ("[inner]\nflags = [true, 1]", r"inner\.flags\[1\] must be bool, not 1"),
        ("[inner]\npoints = [{ at = 1 }]", r"inner\.points\[0\]\.of is missing; .* keys at, of$"),
        ("[inner]\npoints = [{ at = 1, on = 'b' }]", r"unknown key 'inner\.points\[0\]\.on'"),
        ("[inner]\npoints = [3]", r"inner\.points\[0\] is a table"),
        ("[inner]\npoints = 'ab'", r"inner\.points must be .*Point"),
        ("folder = 3", r"folder must be .*Path.*, not 3"),
        ("mode = 'c'", r"mode must be one of 'a', 'b', not 'c'"),
        ("inner = 3", r"inner is a table"),
        ("name = 3", r"name must be str, not 3"),
    ],
)
def test_mistakes_are_named(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        merge(Outer(), tomllib.loads(text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cache = 3", r"cache must be .*Path.*'user'.*, not 3"),
        ("most = 1.0", r"most must be int.*, not 1\.0"),
        ("rate = 'quick'", r"rate must be float.*, not 'quick'"),
    ],
)
def test_mistakes_among_several_types_are_named(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        merge(Choices(), tomllib.loads(text))


def test_messages_say_where_a_part_of_a_file_is() -> None:
    with pytest.raises(ConfigError, match=r"unknown key 'run\.nmae'; \[run\] knows") as caught:
        merge(Outer(), {"nmae": "y", "inner": {"steps": -1}}, where="run")
    assert "[run.inner]: steps must not be negative" in str(caught.value)


def test_all_mistakes_are_named_at_once() -> None:
    text = "nmae = 'y'\nmode = 'c'\n[inner]\nsped = 1\nsteps = 1.5\n"
    with pytest.raises(ConfigError) as caught:
        merge(Outer(), tomllib.loads(text))
    for word in ("'nmae'", "mode must be", "'inner.sped'", "inner.steps must be"):
        assert word in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_fault_of_the_dataclass_is_not_taken_for_the_users() -> None:
    @dataclass(frozen=True)
    class Broken:
        size: int = 1

        def __post_init__(self) -> None:
            if self.size != 1:
                raise AssertionError("a fault")

    with pytest.raises(AssertionError, match="a fault"):
        merge(Broken(), {"size": 2})


def test_one_of_several_types_is_taken_as_it_is_given() -> None:
    assert merge(Choices(), {"cache": "user"}).cache == "user"
    assert merge(Choices(), {"cache": "here"}).cache == Path("here")
    assert merge(Choices(), {"cache": None, "most": None}) == Choices(cache=None, most=None)
    assert merge(Choices(), {"most": 3, "rate": 1}) == Choices(most=3, rate=1.0)


def test_what_is_not_given_stays_though_it_is_not_the_default() -> None:
    config = Choices(cache=Path("user"), most=None, rate=2.0)
    changed = merge(config, {"tiny": 1e-9, "inner": {"steps": 4}})
    assert changed == Choices(Path("user"), None, 2.0, 1e-9, Inner(speed=9.0, steps=4))
    assert merge(changed, {}) == changed


def test_none_has_a_word_where_it_is_not_the_default() -> None:
    config = Choices(cache=None, most=None)
    lines = as_toml(config).splitlines()
    assert {'most = "None"', 'cache = "None"', "# rate ="} <= set(lines)
    assert merge(Choices(), tomllib.loads(as_toml(config))) == config
    with pytest.raises(ConfigError, match="steps must be int, not 'None'"):
        merge(Inner(), {"steps": "None"})


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
