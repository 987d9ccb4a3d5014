"""Executors behind one protocol: attempts with numbers, one place to wait, and nothing polls."""

import contextlib
import multiprocessing
import resource
import signal
import threading
import time
from pathlib import Path

import pytest

from gmdx.errors import DatasetError, UsageError
from gmdx.machine.executor import Crash, Finished, Inbox, ThreadExecutor
from gmdx.machine.tasks import open_executor, run_tasks
from tests.machine.work import die_once, double, refuse


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


@pytest.mark.skipif(not hasattr(resource, "RUSAGE_THREAD"), reason="counts of one thread")
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
