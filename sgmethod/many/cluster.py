"""Applying a function to any number of items on a Ray cluster, whose machines share the folders that it uses.

The items are tasks of Ray: Ray Data takes no generator, and an item that always kills its process would end the run or
block it for ever. docs/python.md shows how to encode within Ray Data.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from itertools import islice
from typing import Any, TypeVar

from sgmethod.errors import extra

TRIES = 3
Item = TypeVar("Item")
Result = TypeVar("Result")


def in_ray(
    function: Callable[[Item], Result], items: Iterable[Item], ahead: int
) -> Generator[tuple[Item, Result | None], None, None]:
    """Yield each item with its result, as they finish, at most `ahead` at a time and each on one core.

    The result is None if the item's process was killed three times, be it by Ray for want of memory. Raises
    MissingPackageError.
    """
    with extra("ray"):
        import ray
    killed = ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError
    remote = ray.remote(num_cpus=1, max_retries=0)(_on_one_core)  # Ray itself would retry for ever without memory
    waiting = iter(items)
    running: dict[Any, tuple[Item, int]] = {}  # items and their tries left
    try:
        while True:
            for item in islice(waiting, ahead - len(running)):
                running[remote.remote(function, item)] = item, TRIES - 1
            if not running:
                return
            for done in ray.wait(list(running))[0]:
                item, left = running.pop(done)
                try:
                    result = ray.get(done)
                except killed:
                    if left:
                        running[remote.remote(function, item)] = item, left - 1
                        continue
                    result = None
                yield item, result
    finally:
        for one in running:
            ray.cancel(one, force=True)


def _on_one_core(function: Callable[[Item], Result], item: Item) -> Result:
    from sgmethod.native import native

    native.set_thread_count(1)
    return function(item)
