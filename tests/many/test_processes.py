"""A function over many items in several processes, some of which are killed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from unittest.mock import Mock

import pytest

from benchmarks.harness.processes import wait_until
from sgmethod import SgError
from sgmethod.many import processes
from sgmethod.many.processes import in_processes
from tests.many.killing import doubled, killed_once


def test_a_killed_process_costs_one_item_alone() -> None:
    """Those that were under way beside it are done all the same."""
    items = [*range(6), -1, *range(6, 12)]
    results = list(in_processes(doubled, items, 2))
    assert sorted(item for item, _ in results) == sorted(items)
    assert {item: result for item, result in results if result != 2 * item} == {-1: None}


def test_an_item_is_tried_again(tmp_path: Path) -> None:
    results = dict(in_processes(partial(killed_once, tmp_path), range(6), 2))
    assert (tmp_path / "killed").exists()
    assert results == {item: 2 * item for item in range(6)}


def test_items_are_taken_as_they_are_needed() -> None:
    """The processes end with the loop."""
    taken = []

    def items() -> Iterator[int]:
        for item in range(1_000_000):
            taken.append(item)
            yield item

    with closing(in_processes(doubled, items(), 2)) as results:
        assert [next(results)[1] is not None for _ in range(5)] == [True] * 5
    assert len(taken) <= 10
    wait_until(lambda: active_children() == [])  # the pool's own thread joins them


def test_processes_that_end_before_they_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    """A script that is no file, or has no guard, has such processes."""
    monkeypatch.setattr(processes, "_begin", os.abort)
    with pytest.raises(SgError, match="run it as a file"):
        list(in_processes(doubled, [1, 2], 2))


@pytest.mark.parametrize("error", [RuntimeError("can't start new thread"), BlockingIOError(11, "unavailable")])
def test_a_system_that_allows_no_more_processes(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(processes.ProcessPoolExecutor, "submit", Mock(side_effect=error))
    with pytest.raises(SgError, match="no further process can begin: "):
        list(in_processes(doubled, [1], 1))


@pytest.mark.parametrize("error", [OSError(38, "Function not implemented"), ImportError("no sem_open")])
def test_a_system_without_semaphores(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """AWS Lambda has no /dev/shm."""
    monkeypatch.setattr(processes.CONTEXT, "Lock", Mock(side_effect=error))
    with pytest.raises(SgError, match=r"no further process can begin: .*; a single job needs none"):
        list(in_processes(doubled, [1, 2], 2))


def test_errors_are_raised_and_end_no_other_process() -> None:
    other = processes.CONTEXT.Process(target=time.sleep, args=(60,))
    other.start()
    with pytest.raises(TypeError, match="'<' not supported"):
        list(in_processes(doubled, ["text"], 2))  # type: ignore[list-item]
    other.join(0.5)
    assert other.is_alive()
    other.kill()
    other.join()
