"""Processes that work, fail, crash and are left behind."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gmdx.machine.cores import THREAD_VARIABLES
from gmdx.machine.executor import Crash
from gmdx.machine.processes import WorkerError
from gmdx.machine.tasks import run_tasks
from tests.machine.work import die, own_pid, send_much, sleep_or_double, threads, unsendable, warn
from tests.runs import interrupts_heard


@pytest.mark.parametrize("workers", [1, 2])
def test_what_workers_log_is_logged_by_the_caller(
    workers: int, caplog: pytest.LogCaptureFixture
) -> None:
    assert len(list(run_tasks(warn, range(3), workers=workers))) == 3
    assert sorted(caplog.messages) == [f"task {k} is odd, here" for k in range(3)]


def test_one_worker_can_be_a_process_of_its_own() -> None:
    (item,) = run_tasks(own_pid, [0], workers=1, executor="processes")
    assert item.result != os.getpid()


def test_a_crash_costs_one_task() -> None:
    found = {item.task: item.result for item in run_tasks(die, range(8), workers=2)}
    assert {task: found[task] for task in (0, 2, 4, 6, 7)} == {0: 0, 2: 4, 4: 8, 6: 12, 7: 14}
    crashes = {task: found[task] for task in (1, 3, 5)}
    assert {
        task: crash.exit_code for task, crash in crashes.items() if isinstance(crash, Crash)
    } == {1: -signal.SIGKILL, 3: 7, 5: -signal.SIGSEGV}
    assert "SIGKILL" in str(found[1])
    assert "memory" in str(found[1])
    assert "code 7" in str(found[3])
    assert "SIGSEGV" in str(found[5])


def test_a_worker_that_dies_while_it_sends_its_result_costs_one_task(tmp_path: Path) -> None:
    """Nobody listens while we have the first result, so it is in the middle of sending."""
    note = tmp_path / "pid"
    with contextlib.closing(run_tasks(send_much, [None, note, None], workers=2)) as running:
        assert next(running).task is None
        end = time.monotonic() + 60
        while not (note.exists() and note.read_text().endswith(".")):
            assert time.monotonic() < end
            time.sleep(0.02)
        time.sleep(0.5)
        os.kill(int(note.read_text()[:-1]), signal.SIGKILL)
        rest = {item.task: item.result for item in running}
    crash = rest[note]
    assert isinstance(crash, Crash)
    assert crash.exit_code == -signal.SIGKILL
    assert rest[None] == b""


def test_what_cannot_be_handed_over_is_an_error_that_says_so() -> None:
    with pytest.raises(Exception, match=r"(?i)pickle"):
        list(run_tasks(unsendable, [0], workers=1, executor="processes"))
    with pytest.raises(WorkerError, match=r"ValueError: .*bad.* cannot be handed over"):
        list(run_tasks(unsendable, [1], workers=1, executor="processes"))


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


@pytest.mark.skipif(not Path("/proc").exists(), reason="reads /proc")
def test_workers_do_not_outlive_a_killed_caller(tmp_path: Path) -> None:
    """Nor do the processes that they have started."""
    (tmp_path / "orphans.py").write_text(
        "import os, subprocess, sys, time\n"
        "from gmdx.machine.tasks import run_tasks\n"
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
    (tmp_path / "interrupted.py").write_text(
        "import os, sys, time\n"
        "from gmdx.machine.tasks import run_tasks\n"
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


def test_a_run_that_nobody_closed_does_not_keep_python_from_ending(tmp_path: Path) -> None:
    (tmp_path / "left.py").write_text(
        "from gmdx.machine.tasks import run_tasks\n"
        "if __name__ == '__main__':\n"
        "    running = run_tasks(abs, [-1, -2, -3], workers=2)\n"
        "    assert next(running).result in (1, 2)\n"
    )
    subprocess.run([sys.executable, "left.py"], cwd=tmp_path, check=True, timeout=60)


def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(
        "import math\nfrom gmdx.machine.tasks import run_tasks\n"
        "print(list(run_tasks(math.sqrt, [1.0, 4.0], workers=2)))\n"
    )
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "WorkerError" in done.stderr
    assert "if __name__ == '__main__':" in done.stderr.splitlines()[-1]
