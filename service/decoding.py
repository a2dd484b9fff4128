"""Bitstreams to PNG, beside the event loop and never too many at once."""

from __future__ import annotations

import anyio
from anyio import to_thread

import sgmethod
from service.problems import ProblemError
from sgmethod.files import encode_png

RETRY_AFTER_S = "1"


def _decode_to_png(bitstream: bytes) -> bytes:
    return encode_png(sgmethod.decode(bitstream))


class PictureDecoder:
    """Decodes in threads: max_running at a time, with max_waiting callers in line."""

    def __init__(self, max_running: int, max_waiting: int) -> None:
        self._limiter = anyio.CapacityLimiter(max_running)
        self._max_waiting = max_waiting

    async def png(self, bitstream: bytes) -> bytes:
        """The PNG file of a bitstream.

        Raises ProblemError 503 if too many callers wait already, BitstreamError if the bytes are none.
        """
        if self._limiter.statistics().tasks_waiting >= self._max_waiting:
            detail = "too many pictures are being decoded"
            raise ProblemError(503, detail, headers={"Retry-After": RETRY_AFTER_S})
        return await to_thread.run_sync(_decode_to_png, bitstream, limiter=self._limiter)
