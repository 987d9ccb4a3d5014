"""Processes that work, fail, crash and are left behind."""

import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest

from gmdx.errors import DatasetError
from gmdx.machine.processes import LATER, THREAD_VARIABLES, Crash, Finished, run_tasks
from tests.runs import interrupts_heard


def double(x: int) -> int:
    return 2 * x


def die(x: int) -> int:
    """Odd tasks end their process, each in another way."""
    if x == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if x == 3:
        os._exit(7)
    if x == 5:
        os.kill(os.getpid(), signal.SIGSEGV)
    return 2 * x


def refuse(x: int) -> int:
    raise DatasetError(f"task {x} is refused")


def threads(_: int) -> list[str | None]:
    return [os.environ.get(name) for name in THREAD_VARIABLES]


def sleep_long(_: int) -> int:
    time.sleep(600)
    return 0


def warn(x: int) -> int:
    logging.getLogger("gmdx").warning("task %d is odd, %s", x, Path("here"))
    return x


@pytest.mark.parametrize("workers", [1, 2])
def test_what_workers_log_is_logged_by_the_caller(
    workers: int, caplog: pytest.LogCaptureFixture
) -> None:
    assert len(list(run_tasks(warn, range(3), workers=workers))) == 3
    assert sorted(caplog.messages) == [f"task {k} is odd, here" for k in range(3)]


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_every_task_is_done_once(workers: int) -> None:
    results = list(run_tasks(double, range(7), workers=workers))
    assert sorted(item.task for item in results) == list(range(7))
    assert all(item.result == 2 * item.task for item in results)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_tasks_can_follow_from_results(workers: int) -> None:
    """Every number begets its half, which the stream of tasks learns from the results."""
    known, open_tasks, seen = [40, 7], 0, []

    def tasks() -> Iterator[int]:
        nonlocal open_tasks
        while known or open_tasks:
            if not known:
                yield cast(int, LATER)
                continue
            open_tasks += 1
            yield known.pop()

    for item in run_tasks(double, tasks(), workers=workers):
        open_tasks -= 1
        assert item.result == 2 * item.task
        seen.append(item.task)
        if item.task > 1:
            known.append(item.task // 2)
    assert sorted(seen) == sorted([40, 20, 10, 5, 2, 1, 7, 3, 1])
    assert not multiprocessing.active_children()


def test_a_crash_costs_one_task() -> None:
    found = {item.task: item.result for item in run_tasks(die, range(8), workers=2)}
    assert {task: found[task] for task in (0, 2, 4, 6, 7)} == {0: 0, 2: 4, 4: 8, 6: 12, 7: 14}
    assert found[1] == Crash(-signal.SIGKILL)
    assert "SIGKILL" in str(found[1])
    assert "memory" in str(found[1])
    assert found[3] == Crash(7)
    assert "code 7" in str(found[3])
    assert found[5] == Crash(-signal.SIGSEGV)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_ends_the_run(workers: int) -> None:
    with pytest.raises(DatasetError, match="is refused"):
        list(run_tasks(refuse, range(4), workers=workers))
    assert not multiprocessing.active_children()


def test_tasks_are_drawn_as_they_are_needed() -> None:
    drawn = []

    def tasks():  # type: ignore[no-untyped-def]
        for k in range(100):
            drawn.append(k)
            yield k

    running = run_tasks(double, tasks(), workers=2)
    first: Finished[int, int] = next(running)
    assert first.task in (0, 1)
    assert len(drawn) <= 4
    running.close()
    assert not multiprocessing.active_children()


def test_workers_compute_with_one_thread_and_the_caller_is_left_as_it_was() -> None:
    before = threads(0)
    (item,) = run_tasks(threads, [0], workers=2)
    assert item.result == ["1"] * len(THREAD_VARIABLES)
    assert threads(0) == before


def test_closing_ends_workers_that_are_busy() -> None:
    running = run_tasks(sleep_or_double, [0, 1], workers=2)
    assert next(running).task == 0
    start = time.monotonic()
    running.close()
    assert time.monotonic() - start < 10
    assert not multiprocessing.active_children()


def sleep_or_double(x: int) -> int:
    return sleep_long(x) if x else double(x)


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
def test_workers_do_not_outlive_a_killed_caller(tmp_path: Path) -> None:
    """Nor do the processes that they have started."""
    import subprocess

    (tmp_path / "orphans.py").write_text(
        "import os, subprocess, sys, time\n"
        "from gmdx.machine.processes import run_tasks\n"
        "def work(x):\n"
        "    child = subprocess.Popen(['sleep', '600'])\n"
        "    open(f'{x}.pid', 'w').write(f'{os.getpid()} {child.pid}')\n"
        "    time.sleep(600)\n"
        "if __name__ == '__main__':\n"
        "    list(run_tasks(work, [0, 1], workers=2))\n"
    )
    caller = subprocess.Popen([sys.executable, "orphans.py"], cwd=tmp_path)
    files = [tmp_path / "0.pid", tmp_path / "1.pid"]
    end = time.monotonic() + 60
    while not all(file.exists() and file.read_text().count(" ") for file in files):
        assert time.monotonic() < end
        time.sleep(0.05)
    pids = [int(pid) for file in files for pid in file.read_text().split()]
    assert all(alive(pid) for pid in pids)
    caller.kill()
    caller.wait()
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_workers_that_are_still_starting_take_ctrl_c_in_silence(tmp_path: Path) -> None:
    """A terminal sends it to all of them."""
    import subprocess

    (tmp_path / "interrupted.py").write_text(
        "import os, sys, time\n"
        "from gmdx.machine.processes import run_tasks\n"
        "open(f'{os.getpid()}.pid', 'w').close()\n"
        "if __name__ == '__main__':\n"
        "    try:\n"
        "        list(run_tasks(abs, [0, 1], workers=2))\n"
        "    except KeyboardInterrupt:\n"
        "        sys.exit(7)\n"
        "else:\n"
        "    time.sleep(600)  # a slow import\n"
    )
    with interrupts_heard():
        caller = subprocess.Popen(
            [sys.executable, "interrupted.py"],
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    end = time.monotonic() + 60
    while len(list(tmp_path.glob("*.pid"))) < 3:
        assert time.monotonic() < end
        time.sleep(0.05)
    os.killpg(caller.pid, signal.SIGINT)
    _, errors = caller.communicate(timeout=60)
    assert (caller.returncode, errors) == (7, "")


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    import subprocess

    (tmp_path / "script.py").write_text(
        "import math\nfrom gmdx.machine.processes import run_tasks\n"
        "print(list(run_tasks(math.sqrt, [1.0, 4.0], workers=2)))\n"
    )
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "WorkerError" in done.stderr
    assert "if __name__ == '__main__':" in done.stderr.splitlines()[-1]
