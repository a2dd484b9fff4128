"""A function over many items in several processes, some of which are killed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest

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
    """And the processes end with the loop."""
    taken = []

    def items() -> Iterator[int]:
        for item in range(1_000_000):
            taken.append(item)
            yield item

    with closing(in_processes(doubled, items(), 2)) as results:
        assert [next(results)[1] is not None for _ in range(5)] == [True] * 5
    assert len(taken) <= 10
    for child in active_children():
        child.join(10)
    assert active_children() == []


def test_errors_are_raised() -> None:
    with pytest.raises(TypeError, match="'<' not supported"):
        list(in_processes(doubled, ["text"], 2))  # type: ignore[list-item]
