"""A function over any number of items on a Ray cluster, whose machines share the folders that the function uses.

These are tasks of Ray. Ray Data takes no generator, and an item that kills its process each time would end the run, or
hold it up for ever. docs/python.md shows how to encode within Ray Data.
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
    """Each item with its result, as they finish, with at most `ahead` under way, each on one core; None where its
    process was killed three times, by Ray itself too where memory is short. Raises MissingPackageError."""
    with extra("ray"):
        import ray
    killed = ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError
    remote = ray.remote(num_cpus=1, max_retries=0)(_on_one_core)  # Ray itself would retry for ever without memory
    waiting = iter(items)
    running: dict[Any, tuple[Item, int]] = {}  # with the tries that are left
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
