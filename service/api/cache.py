"""A cache of the most recently requested pictures."""

from __future__ import annotations

from collections import OrderedDict


class PictureCache:
    """The most recently requested picture files by entity tag, up to max_bytes. Use it in the event loop only."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self.bytes = 0

    def get(self, etag: str) -> bytes | None:
        """Return the file if it is in memory."""
        if etag in self._files:
            self._files.move_to_end(etag)
        return self._files.get(etag)

    def put(self, etag: str, file: bytes) -> None:
        """Store the file if it fits at all, and evict the oldest files to make space."""
        if etag in self._files or len(file) > self._max_bytes:
            return
        self._files[etag] = file
        self.bytes += len(file)
        while self.bytes > self._max_bytes:
            _, oldest = self._files.popitem(last=False)
            self.bytes -= len(oldest)
