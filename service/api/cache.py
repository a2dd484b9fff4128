"""A cache of the most recently requested pictures."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from typing import Any

from service.api.problems import ProblemError

DELETED = 410  # applies to every client; other refusals may be for one client, or for one of two jobs with equal files


class _Making:
    """A file that is being made, and the number of requests that wait for it."""

    def __init__(self, making: Coroutine[Any, Any, bytes]) -> None:
        self.task = asyncio.create_task(making)
        self.waiting = 0


class PictureCache:
    """The most recently requested picture files by entity tag, up to max_bytes. Use it in the event loop only."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self._making: dict[str, _Making] = {}
        self.bytes = 0

    def __contains__(self, etag: str) -> bool:
        return etag in self._files

    async def get_or_make(self, etag: str, make: Callable[[], Coroutine[Any, Any, bytes]]) -> bytes:
        """Return the file from memory, or from `make`.

        Concurrent requests for one file share one call of `make`, which is cancelled when none of them waits any more.
        If it refuses the request that started it, the others try again in their own names.
        """
        while True:
            if etag in self._files:
                self._files.move_to_end(etag)
                return self._files[etag]
            is_mine = etag not in self._making
            if is_mine:
                self._making[etag] = _Making(make())
            making = self._making[etag]
            making.waiting += 1
            try:
                file = await asyncio.shield(making.task)
            except ProblemError as refusal:
                if is_mine or refusal.status == DELETED:
                    raise
            else:
                self._put(etag, file)
                return file
            finally:
                making.waiting -= 1
                if making.task.done() or not making.waiting:
                    making.task.cancel()
                    if self._making.get(etag) is making:
                        del self._making[etag]

    def _put(self, etag: str, file: bytes) -> None:
        """Store the file if it fits at all, and evict the oldest files to make space."""
        if etag in self._files or len(file) > self._max_bytes:
            return
        self._files[etag] = file
        self.bytes += len(file)
        while self.bytes > self._max_bytes:
            _, oldest = self._files.popitem(last=False)
            self.bytes -= len(oldest)
