"""A function over many items in several processes, some of which are killed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import closing
from multiprocessing import active_children, current_process
from unittest.mock import Mock

import pytest

from sgmethod import SgError, machine
from sgmethod.many import processes
from sgmethod.many.processes import as_they_finish, in_processes
from sgmethod.native import native
from tests.many.killing import doubled


def test_results_come_as_they_finish() -> None:
    assert sorted(in_processes(doubled, range(12), 2)) == [(item, 2 * item) for item in range(12)]


def test_each_that_finishes_takes_the_same_time() -> None:
    """Of 4,000 at once, the time of each grew with those under way: 6 s of a core, where it now takes 0.02."""
    given: list[Future[int]] = []

    def begin(_: int) -> Future[int]:
        given.append(Future())
        if len(given) == 4000:
            given[0].set_result(0)
        return given[-1]

    began = time.process_time()
    for number, (item, future) in enumerate(as_they_finish(begin, range(4000), 4000), 1):
        assert (item, future) == (number - 1, given[number - 1])
        if number < len(given):
            given[number].set_result(number)
    assert number == 4000
    assert time.process_time() - began < 1


def test_a_killed_process_costs_its_own_item_alone() -> None:
    """One ended the run, and each that resumed."""
    found = dict(in_processes(doubled, [-1, *range(6), -2, -3, *range(6, 12)], 2))
    assert found == {item: 2 * item if item >= 0 else None for item in range(-3, 12)}
    assert active_children() == []


def test_items_are_taken_as_they_are_needed() -> None:
    """The processes end with the loop."""
    taken = []

    def items() -> Iterator[int]:
        for item in range(1_000_000):
            taken.append(item)
            yield item

    with closing(in_processes(doubled, items(), 2)) as results:
        assert len([next(results) for _ in range(5)]) == 5
    assert len(taken) <= 8
    assert active_children() == []


def test_processes_that_end_before_they_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    """A script that is no file, or has no guard, has such processes."""
    monkeypatch.setattr(processes, "_work", os.abort)
    with pytest.raises(SgError, match="ended before it began: stderr has its error"):
        list(in_processes(doubled, [1, 2], 2))


@pytest.mark.parametrize("error", [OSError(38, "Function not implemented"), ImportError("no sem_open")])
def test_a_system_without_semaphores(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """AWS Lambda has no /dev/shm. Nothing here needs any."""
    monkeypatch.setattr("_multiprocessing.SemLock", Mock(side_effect=error))
    assert list(in_processes(doubled, [1], 1)) == [(1, 2)]


def test_a_daemonic_process_begins_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was an AssertionError, in workers of Celery and Airflow."""
    monkeypatch.setitem(current_process()._config, "daemon", True)  # type: ignore[attr-defined]
    with pytest.raises(SgError, match=r"a daemonic process, such as .* begins no other: a single job needs none"):
        list(in_processes(doubled, [1], 2))


def test_errors_are_raised_and_end_no_other_process() -> None:
    other = processes.CONTEXT.Process(target=time.sleep, args=(60,))
    other.start()
    with pytest.raises(TypeError, match="'<' not supported") as raised:
        list(in_processes(doubled, ["text"], 2))  # type: ignore[list-item]
    assert "in doubled\n" in raised.value.__notes__[0]  # where it was raised
    other.join(0.5)
    assert other.is_alive()
    other.kill()
    other.join()


@pytest.mark.parametrize(
    ("cores", "gibibytes", "pictures", "expected"),
    [(16, 64, 1000, 16), (16, 4, 1000, 2), (2, 1, 1000, 1), (16, 64, 12, 3), (16, 64, 1, 1), (16, 64, 0, 1)],
)
def test_jobs_by_cores_memory_and_pictures(
    cores: int, gibibytes: int, pictures: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(native, "thread_count", lambda: cores)
    monkeypatch.setattr(machine, "memory", lambda: gibibytes << 30)
    assert processes.usual_jobs(pictures) == expected
