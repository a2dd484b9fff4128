"""Disk space for the bodies of requests, reserved for each before it is read."""

from __future__ import annotations

import asyncio
import shutil
import tempfile

from anyio import to_thread

from service.api.problems import RETRY_AFTER, ProblemError

IN_MEMORY_BYTES = 1 << 20  # of a body; larger ones go to a temporary file
COPIES = 2  # of an upload: the temporary file, and what the storage keeps


class DiskRoom:
    """The free space of the disk with temporary files. Use it in the event loop only.

    kept_bytes: what bodies leave free, for the job table and for jobs that have been accepted.
    """

    def __init__(self, kept_bytes: int) -> None:
        self.kept_bytes = kept_bytes
        self.reserved = 0  # bytes that are still to be written
        self.looking = asyncio.Lock()  # one at a time, so that none is refused for one that is refused itself


class Reservation:
    """The room of one body. size: its bytes, as far as they are known before it is read."""

    def __init__(self, room: DiskRoom, size: int) -> None:
        self._room = room
        self._wanted = COPIES * size if size > IN_MEMORY_BYTES else 0
        self._left = 0

    async def begin(self) -> None:
        """Reserve the room, unless that is done. Raises ProblemError 503 if there is too little."""
        if not self._wanted:
            return
        async with self._room.looking:
            usage = await to_thread.run_sync(shutil.disk_usage, tempfile.gettempdir())
            if usage.free - self._room.reserved - self._wanted < self._room.kept_bytes:
                detail = "the disk has no room for this upload, with those that are on their way"
                raise ProblemError(503, detail, reason="disk", headers=RETRY_AFTER)
            self._left, self._wanted = self._wanted, 0
            self._room.reserved += self._left

    def written(self, size: int) -> None:
        """Count a part of the body, for which free space is now missing."""
        size = min(size, self._left)
        self._left -= size
        self._room.reserved -= size

    def end(self) -> None:
        """Give back what was not written."""
        self.written(self._left)
