"""The command: exit codes, one-line errors, interruption."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gmdx.cli.commands import COMMANDS, Entry, Group
from gmdx.cli.main import main
from gmdx.cli.terminal import interrupts_kept
from gmdx.files.folder import PARTIAL
from gmdx.metrics.table import METRICS
from tests.runs import (
    FLAGS,
    Command,
    assert_whole,
    contents,
    interrupts_heard,
    needs_proc,
    write_meshes,
)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def root(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three boxes, in `out`; the meshes beside it."""
    folder = tmp_path_factory.mktemp("run")
    write_meshes(folder / "meshes")
    words = ["generate", str(folder / "meshes"), "--out", str(folder / "out"), "--workers", "1"]
    assert main([*words, "--cache", str(cache), *FLAGS]) == 0
    return folder


def run(words: list[str | Path], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    """Exit code, output and errors of a command in this process."""
    try:
        code = main([str(word) for word in words])
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_the_last_line_counts(
    root: Path, cache: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "bad.obj").write_text("no mesh")
    words = ["generate", root / "meshes", tmp_path / "bad.obj", "--out", root / "out"]
    code, out, err = run([*words, "--workers", "1", "--cache", cache, *FLAGS], capsys)
    assert code == 0
    assert out.splitlines()[-1].endswith(
        "3 objects, 6 scenes, 36 grasps (0 objects new, 3 already there); "
        "1 of 4 objects failed, 1 lines in failures.jsonl"
    )
    assert "[1/1] bad-" in err
    assert "prepare failed" in err


def test_nothing_produced_is_1(
    cache: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "bad.obj").write_text("no mesh")
    words = ["generate", tmp_path / "bad.obj", "--out", tmp_path / "out", "--cache", cache]
    code, out, err = run([*words, "--workers", "1"], capsys)
    assert code == 1
    assert "1 of 1 objects failed" in out
    assert "Traceback" not in err


WRONG = {
    "no command": [],
    "unknown command": ["genrate"],
    "no objects": ["generate", "--out", "OUT"],
    "no output": ["generate", "bundled"],
    "not a number": ["generate", "bundled", "--out", "OUT", "--grasps", "many"],
    "no grasps": ["generate", "bundled", "--out", "OUT", "--grasps", "0"],
    "no workers": ["generate", "bundled", "--out", "OUT", "--workers", "0"],
    "negative scenes": ["generate", "bundled", "--out", "OUT", "--scenes", "-1"],
    "no such file": ["generate", "nowhere.obj", "--out", "OUT"],
    "no mesh in folder": ["generate", "EMPTY", "--out", "OUT"],
    "nothing matches": ["generate", "EMPTY/*.stl", "--out", "OUT"],
    "unknown gripper": ["generate", "bundled", "--out", "OUT", "--gripper", "tentacle"],
    "bad gripper file": ["generate", "bundled", "--out", "OUT", "--gripper", "BAD"],
    "no config": ["generate", "bundled", "--out", "OUT", "--config", "none.toml"],
    "bad config": ["generate", "bundled", "--out", "OUT", "--config", "BAD"],
    "foreign folder": ["generate", "bundled", "--out", "FOREIGN"],
    "output is a file": ["generate", "bundled", "--out", "BAD"],
    "output in a file": ["generate", "bundled", "--out", "BAD/below"],
    "inspect nothing": ["inspect", "EMPTY"],
    "show nothing": ["show", "EMPTY", "--object", "mug", "-o", "OUT.png"],
    "prepare nothing": ["prepare", "nowhere.obj"],
    "bench what": ["bench", "patience"],
    "bench workers": ["bench", "pipeline", "--workers", "1,two"],
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_usage_is_2(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "EMPTY").mkdir()
    (tmp_path / "FOREIGN").mkdir()
    (tmp_path / "FOREIGN" / "thesis.tex").write_text("years of work")
    (tmp_path / "BAD").write_text("not = [valid")
    words: list[str | Path] = [
        tmp_path / word if word.split("/")[0].isupper() and word[0] != "-" else word
        for word in WRONG[name]
    ]
    code, out, err = run(words, capsys)
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert err.strip()
    assert (tmp_path / "FOREIGN" / "thesis.tex").read_text() == "years of work"
    assert not (tmp_path / "OUT").exists()


def test_another_seed_for_the_same_folder_is_2(
    root: Path, cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(root / "out")
    flags = [*FLAGS[:-1], "6"]
    words = ["generate", root / "meshes", "--out", root / "out", "--cache", cache, *flags]
    code, _, err = run(words, capsys)
    assert code == 2
    assert "seed: 5 -> 6" in err
    assert len(err.splitlines()) == 1
    assert contents(root / "out") == before


@pytest.mark.parametrize("command", ["genrate", ""])
@pytest.mark.parametrize("group", [(), ("bench",)])
def test_unknown_commands_are_answered_with_the_known_ones(
    group: tuple[str, ...], command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run([*group, *([command] if command else [])], capsys)
    assert code == 2
    for name in COMMANDS.entries["bench"].entries if group else COMMANDS.entries:
        assert name in err


def entries(group: Group = COMMANDS) -> Iterator[Entry]:
    for entry in group.entries.values():
        yield from entries(entry) if isinstance(entry, Group) else [entry]


@pytest.mark.parametrize("entry", [*entries()], ids=lambda entry: entry.load.__name__)
def test_the_summary_of_a_command_is_its_own(entry: Entry) -> None:
    first = (entry.load().__doc__ or "").split("\n\n")[0]
    assert entry.summary == " ".join(first.split())


def test_metrics_prints_all_36(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(["metrics"], capsys)
    assert code == 0
    words = set(out.replace("│", " ").split())
    assert len(METRICS) == 36
    assert {metric.name for metric in METRICS} <= words


def test_inspect_shows_counts_outcomes_and_cost(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(["inspect", root / "out"], capsys)
    assert code == 0
    for word in ("box0-", "success", "knocked_away", "trials", "parallel_jaw", "s/grasp"):
        assert word in out


def test_show_writes_pictures(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from gmdx.dataset.read import read_dataset

    dataset = read_dataset(root / "out")
    object_id = dataset.objects[0]
    grasp = dataset.grasps(object_id, 1)["grasp_id"][0].as_py()
    words = ["show", root / "out", "--object", object_id, "--scene", "1"]
    for name, more in (("scene", ["--metric", "force"]), ("grasp", ["--grasp", str(grasp)])):
        path = tmp_path / f"{name}.png"
        code, _, err = run([*words, *more, "-o", path], capsys)
        assert code == 0, err
        assert path.read_bytes()[:4] == b"\x89PNG"
    code, _, err = run(["show", root / "out", "--gripper", "franka_hand"], capsys)
    assert code == 2  # the dataset knows its own
    for more, message in (
        (["--metric", "beauty"], "no metric 'beauty'"),
        (["--grasp", "-1"], "no grasp -1"),
        (["--scene", "9"], "no scene 9"),
        (["--view", "3"], "no view 3"),
        (["--object", "teapot"], "no object 'teapot'"),
    ):
        code, _, err = run([*words, *more, "-o", tmp_path / "x.png"], capsys)
        assert code == 2
        assert message in err


def test_prepare_reports_and_counts(
    root: Path, cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.obj").write_text("no mesh")
    words = ["prepare", "--workers", "1", "--cache", cache]
    code, out, _ = run([*words, tmp_path / "bad.obj", root / "meshes"], capsys)
    assert code == 0
    assert out.splitlines()[-1] == "3 objects prepared, 1 failed"
    assert "bad-" in out
    assert run([*words, tmp_path / "bad.obj"], capsys)[0] == 1


def test_help_is_fast() -> None:
    """Start to end, in processor time: under a second."""
    before = os.times()
    command = Command("--help", cache=Path()).finish()
    after = os.times()
    assert command.code == 0
    assert "gmdx generate bundled --out" in command.out
    assert after.children_user - before.children_user < 1.0


@pytest.mark.parametrize("words", [("metrics",), ("config",), ("inspect",)])
def test_a_reader_that_has_seen_enough_is_no_failure(
    words: tuple[str, ...], root: Path, cache: Path
) -> None:
    command = Command(*words, *([root / "out"] if words == ("inspect",) else []), cache=cache)
    assert command.process.stdout is not None
    command.process.stdout.close()
    assert command.process.stderr is not None
    assert command.process.stderr.read() == ""
    assert command.process.wait(60) == 0


@pytest.fixture
def interrupts() -> Iterator[None]:
    """Ctrl-C as in a terminal, even where the suite runs in a script's background."""
    with interrupts_heard():
        yield


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_that_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interrupts_kept():
        signal.raise_signal(signal.SIGINT)


@pytest.mark.usefixtures("interrupts")
def test_an_interrupt_among_imports_is_not_swallowed() -> None:
    """Some packages catch everything that comes while they look for another package."""
    after = []

    def look_for_packages() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException:
            after.append("swallowed")
        after.append("imported")

    with pytest.raises(KeyboardInterrupt), interrupts_kept():
        look_for_packages()
    assert after == ["imported"]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_stops_cleanly_and_the_same_command_continues(
    workers: str, root: Path, cache: Path, tmp_path: Path
) -> None:
    words = ("generate", root / "meshes", "--out", tmp_path, "--workers", workers, *FLAGS)
    command = Command(*words, cache=cache)
    command.wait_for(f"{PARTIAL}/run-*/*", tmp_path)  # an attempt at an object
    time.sleep(0.1)
    os.killpg(command.process.pid, signal.SIGINT)  # as a terminal does: workers, too
    command.finish()
    assert command.code == 130
    assert "Traceback" not in command.err
    assert command.err.splitlines()[-1].startswith("interrupted; the same command continues")
    command.assert_no_orphans()
    assert not (tmp_path / PARTIAL).exists()
    assert_whole(tmp_path)
    again = Command(*words, cache=cache).finish()
    assert again.code == 0, again.err
    assert contents(tmp_path).keys() == contents(root / "out").keys()


@pytest.mark.slow
def test_a_limit_on_file_sizes_is_a_named_error(root: Path, cache: Path, tmp_path: Path) -> None:
    """The operating system itself refuses to write more than 8 KiB into a file."""
    words = ("generate", root / "meshes", "--out", tmp_path, "--workers", "1", *FLAGS)
    command = Command(*words, cache=cache, setup="ulimit -f 8").finish()
    assert command.code == 1
    assert "Traceback" not in command.err
    last = command.err.splitlines()[-1]
    assert last.startswith("gmdx: cannot write to ")
    assert "run the same command again" in last
    assert not (tmp_path / PARTIAL).exists()
    assert not list((tmp_path / "objects").iterdir())
    assert Command(*words, cache=cache).finish().code == 0
