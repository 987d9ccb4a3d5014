"""Processes that work, fail, crash and are left behind."""

import contextlib
import logging
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from gmdx.errors import DatasetError, UsageError
from gmdx.machine.cores import THREAD_VARIABLES
from gmdx.machine.executor import Crash, Finished, Inbox, ThreadExecutor
from gmdx.machine.processes import WorkerError
from gmdx.machine.tasks import open_executor, run_tasks
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


def die_once(marker: Path) -> str:
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def send_much(note: Path | None) -> bytes:
    """A result that no pipe holds, after a note of who sends it."""
    if note is None:
        return b""
    result = bytes(50_000_000)
    note.write_text(f"{os.getpid()}.")
    return result


def unsendable(x: int) -> object:
    if x:
        raise ValueError("bad", lambda: None)
    return lambda: None


def own_pid(_: int) -> int:
    return os.getpid()


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
    """Every number begets its half."""
    inbox, known, seen = Inbox(), [40, 7], []
    given: dict[int, int] = {}
    with contextlib.closing(open_executor(inbox, workers=workers)) as executor:
        while known or given:
            while known and len(given) < executor.places:
                task = known.pop()
                given[executor.give(double, task)] = task
            done = inbox.take()
            assert done.task == given.pop(done.attempt)
            assert done.result == 2 * done.task
            seen.append(done.task)
            if done.task > 1:
                known.append(done.task // 2)
    assert sorted(seen) == sorted([40, 20, 10, 5, 2, 1, 7, 3, 1])
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("workers", [1, 2])
def test_attempts_are_numbered_also_those_at_one_task(workers: int) -> None:
    done = list(run_tasks(double, [5] * 6, workers=workers))
    assert sorted(item.attempt for item in done) == [1, 2, 3, 4, 5, 6]


def test_an_attempt_that_died_is_named_and_the_next_one_can_succeed(tmp_path: Path) -> None:
    marker, inbox = tmp_path / "tried", Inbox()
    with contextlib.closing(open_executor(inbox, workers=2)) as executor:
        first = executor.give(die_once, marker)
        died = inbox.take()
        second = executor.give(die_once, marker)
        done = inbox.take()
    assert (died.attempt, done.attempt) == (first, second)
    assert isinstance(died.result, Crash)
    assert (died.result.exit_code, done.result) == (-signal.SIGKILL, "done")
    assert second > first


def test_results_of_a_thread_arrive_at_the_same_wait() -> None:
    inbox, free = Inbox(), threading.Event()
    with (
        contextlib.closing(ThreadExecutor(inbox, name="device", cancel=free.set)) as thread,
        contextlib.closing(open_executor(inbox, workers=2)) as processes,
    ):
        waiting = thread.give(free.wait, None)
        doubled = processes.give(double, 4)
        assert inbox.take() == Finished(4, doubled, 8)
        threading.Timer(0.2, free.set).start()
        assert inbox.take() == Finished(None, waiting, True)
        thread.give(refuse, 3)
        with pytest.raises(DatasetError, match="task 3 is refused"):
            inbox.take()


def test_many_results_can_wait_to_be_taken() -> None:
    inbox = Inbox()
    executor = open_executor(inbox, workers=1)
    numbers = [executor.give(double, k) for k in range(2000)]
    assert [inbox.take().attempt for _ in numbers] == numbers


def test_waiting_costs_nothing() -> None:
    """Processor time and wake-ups of the caller, while two workers sleep for two seconds.

    A look every 20 ms would be 100 wake-ups.
    """
    with contextlib.closing(run_tasks(time.sleep, [0.0, 0.0, 2.0, 2.0], workers=2)) as running:
        next(running), next(running)  # they have started
        before = resource.getrusage(resource.RUSAGE_THREAD)
        next(running)
        after = resource.getrusage(resource.RUSAGE_THREAD)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    assert spent < 0.2
    assert after.ru_nvcsw - before.ru_nvcsw < 50


def test_an_unknown_executor_is_refused() -> None:
    with pytest.raises(UsageError, match="unknown executor 'ray'; give one of serial, processes"):
        open_executor(Inbox(), workers=2, name="ray")


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
