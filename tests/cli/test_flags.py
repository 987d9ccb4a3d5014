"""Flags made from configuration classes: every setting has one, and it means what a file means."""

import dataclasses
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from gmdx.cli.bias import Bias
from gmdx.cli.config import Config
from gmdx.cli.flags import Command, parse
from gmdx.cli.generate import Generate
from gmdx.cli.main import main
from gmdx.cli.sensitivity import Sensitivity
from gmdx.config import as_toml, comments, load_toml, merge
from gmdx.errors import ConfigError
from gmdx.machine.cores import available_cores
from gmdx.pipeline.config import GenerateConfig
from gmdx.studies.bias import BiasConfig
from gmdx.studies.sensitivity import SensitivityConfig

CONFIGURATIONS = {Generate: GenerateConfig, Bias: BiasConfig, Sensitivity: SensitivityConfig}
OTHER: dict[str, Any] = {  # values that fit, where another number or another word does not
    "gripper": "some/hand.toml", "sampler": "antipodal", "engine": "warp", "method": "oat",
    "implementation": "numpy", "parallel_trials": 64, "cache": Path("prepared"),
    "push_direction": (0.0, 0.0, 1.0), "parameters": ("mass", "friction"), "objects": 3,
    "runs": 7, "cone": "elliptic",
}  # fmt: skip
ONLY_VALUE = {"cone"}


def leaves(config: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths and values; rows of tables by their places."""
    for field in dataclasses.fields(config):
        value, path = getattr(config, field.name), f"{where}{field.name}"
        rows = {path: value}
        if isinstance(value, tuple):
            rows = {f"{path}.{k}": item for k, item in enumerate(value)}
        if all(map(dataclasses.is_dataclass, rows.values())):
            for below, item in rows.items():
                yield from leaves(item, f"{below}.")
        else:
            yield path, value


def other(path: str, value: Any) -> Any:
    """Another value for a setting; all of them fit together."""
    name = path.rsplit(".", 1)[-1]
    if name in OTHER:
        return OTHER[name]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return 0.99 * value
    if isinstance(value, tuple):
        return tuple(other(path, item) for item in value)
    raise AssertionError(f"{path} needs another value than {value!r} in OTHER")


def flag(path: str, value: Any) -> list[str]:
    """The words that give a setting its value."""
    name = path.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{name}" if value else f"--no-{name}"]
    if not isinstance(value, tuple):
        return [f"--{name}", str(value)]
    words = [str(item) for item in value]
    any_length = path in ("parameters", "thresholds") or path.endswith("simplify_tolerances")
    return [f"--{name}", *([",".join(words)] if any_length else words)]


def plain(value: Any) -> Any:
    """A configuration as a TOML file would give it."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)
        }
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def parsed(command: type[Command], *words: str) -> Any:
    """The command that a command line asks for."""
    needed = () if command is Config else ("x", "--out", "y")
    return parse(command, [*needed, *words], prog="gmdx")


def defaults(command: type[Command]) -> Any:
    return CONFIGURATIONS[command](workers=available_cores())


@cache
def by_flags(command: type[Command]) -> Any:
    """The settings after a command line that changes all of them."""
    words = [
        word for path, value in leaves(defaults(command)) for word in flag(path, other(path, value))
    ]
    return parsed(command, *words).settings


@cache
def by_tables(command: type[Command]) -> Any:
    """The settings after tables that change all of them."""
    tables = plain(defaults(command))
    for path, value in leaves(defaults(command)):
        *above, name = path.split(".")
        place = tables
        for step in above:
            place = place[int(step) if isinstance(place, list) else step]
        place[name] = plain(other(path, value))
    return merge(defaults(command), tables)


SETTINGS = [
    (command, path, value)
    for command in CONFIGURATIONS
    for path, value in leaves(defaults(command))
]


@pytest.mark.parametrize(
    ("command", "path", "value"), SETTINGS, ids=[f"{c.__name__}-{p}" for c, p, _ in SETTINGS]
)
def test_every_setting_is_a_flag_and_a_line_of_a_file(
    command: type[Command], path: str, value: Any
) -> None:
    wanted = other(path, value)
    assert dict(leaves(by_flags(command)))[path] == wanted
    assert dict(leaves(by_tables(command)))[path] == wanted
    assert wanted != value or path.rsplit(".", 1)[-1] in ONLY_VALUE


@pytest.mark.parametrize("command", CONFIGURATIONS)
def test_a_file_with_every_setting_changed_is_read_back(
    command: type[Command], tmp_path: Path
) -> None:
    (tmp_path / "all.toml").write_text(as_toml(by_flags(command)))
    assert parsed(command, "--config", str(tmp_path / "all.toml")).settings == by_flags(command)


@pytest.mark.parametrize("command", CONFIGURATIONS)
def test_without_flags_the_defaults_are_those_of_the_class(command: type[Command]) -> None:
    assert parsed(command).settings == defaults(command)


def test_flags_win_over_the_file_and_the_file_over_defaults(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("grasps = 7\nscenes = 3\n[trial]\nlift_height = 0.1\nlift_time = 0.5\n")
    words = ("--grasps", "9", "--trial.lift-time", "0.4")
    for flags in ((*words, "--config", str(path)), (f"--config={path}", *words)):
        settings = parsed(Generate, *flags).settings
        assert (settings.grasps, settings.scenes) == (9, 3)
        assert settings.trials == GenerateConfig().trials
        assert (settings.trial.lift_height, settings.trial.lift_time) == (0.1, 0.4)


def test_words_for_none_and_for_all() -> None:
    assert parsed(Bias, "--grasps", "0").settings.grasps is None
    assert parsed(Bias, "--grasps", "None").settings.grasps is None
    assert parsed(Generate, "--cache", "None").settings.cache is None
    assert parsed(Generate, "--cache", "user").settings.cache == "user"
    assert parsed(Generate, "--cache", "./user").settings.cache == Path("user")


def test_numbers_may_be_negative() -> None:
    words = ("--trial.push-direction", "-1", "0", "0")
    assert parsed(Generate, *words).settings.trial.push_direction == (-1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("command", "words", "message"),
    [
        (Generate, ["--trial.lift-time", "-1"], "lift_time must be positive"),
        (Generate, ["--prepare.mass", "nan"], "mass must be positive"),
        (Bias, ["--thresholds", "0.5,2"], "thresholds must be some in"),
        (Sensitivity, ["--parameters", "mass,mas"], "unknown parameter 'mas'"),
    ],
)
def test_the_ranges_are_those_of_the_classes(
    command: type[Command], words: list[str], message: str
) -> None:
    with pytest.raises(Exception, match=message):
        parsed(command, *words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--trial.noise.positoin", "0.1"], "--trial.noise.position"),
        (["--trial.lift-time", "long"], "--trial.lift-time"),
        (["--sample.clearance", "0.1"], "--sample.clearance"),
        (["--config"], "--config"),
    ],
)
def test_words_that_are_no_settings_are_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        parsed(Generate, *words)
    assert stop.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err


def test_a_file_with_a_mistake_is_refused_by_the_place_of_the_mistake(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text("[trial.noise]\npositoin = 0.1\n")
    with pytest.raises(ConfigError, match=r"unknown key 'trial\.noise\.positoin'"):
        parsed(Generate, "--config", str(tmp_path / "bad.toml"))


def help_of(*words: str, capsys: pytest.CaptureFixture[str]) -> tuple[list[str], str]:
    """The lines of a help, and its words without lines and frames."""
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 0
    out = capsys.readouterr().out
    return out.splitlines(), " ".join(out.replace("│", " ").split())


@pytest.mark.parametrize("command", CONFIGURATIONS)
def test_help_states_the_defaults_and_the_comments_of_the_class(
    command: type[Command], capsys: pytest.CaptureFixture[str]
) -> None:
    configuration = CONFIGURATIONS[command]
    lines, words = help_of(command.__name__.lower(), "--help", capsys=capsys)
    meanings = comments(configuration)
    for path, value in leaves(configuration()):
        name = path.replace("_", "-")
        if "." in path:
            assert f"--{name} " not in words  # few settings first; --help-all has the rest
        elif not isinstance(value, tuple) and path != "workers":
            last = f"--no-{name} " if isinstance(value, bool) else f"--{name} "
            after = words.split(last)[1].split(" --")[0]
            assert f"{meanings[path]} (default: {value})" in after
    assert len(lines) < 50


def settings_of(cls: type) -> Iterator[tuple[type, dataclasses.Field[Any]]]:
    """The fields of a configuration and of those within it that are no configurations."""
    for field in dataclasses.fields(cls):
        value = getattr(cls(), field.name)
        if dataclasses.is_dataclass(value) and field.default is dataclasses.MISSING:
            yield from settings_of(type(value))
        else:
            yield cls, field


@pytest.mark.parametrize("cls", CONFIGURATIONS.values(), ids=lambda cls: cls.__name__)
def test_every_setting_says_what_it_means(cls: type) -> None:
    silent = [f"{c.__name__}.{f.name}" for c, f in settings_of(cls) if f.name not in comments(c)]
    assert silent == []


def test_the_whole_help_has_every_flag(capsys: pytest.CaptureFixture[str]) -> None:
    _, words = help_of("generate", "--help-all", capsys=capsys)
    for path, _ in leaves(GenerateConfig()):
        assert f"--{path.replace('_', '-')} " in words
    assert "--trial.lift-time FLOAT s (default: 0.3)" in words


def test_config_prints_a_file_that_can_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "all.toml"
    assert main(["config"]) == 0
    path.write_text(capsys.readouterr().out)
    assert parsed(Generate, "--config", str(path)).settings == defaults(Generate)
    path.write_text("grasps = 7\n[trial.noise]\nangle = 0.1\n")
    assert main(["config", "--config", str(path), "--trial.lift-time", "0.4"]) == 0
    path.write_text(capsys.readouterr().out)
    wanted = {"grasps": 7, "trial": {"noise": {"angle": 0.1}, "lift_time": 0.4}}
    assert merge(GenerateConfig(), load_toml(path)) == merge(defaults(Generate), wanted)
