"""Decoding beside the event loop, and never too many at once."""

from __future__ import annotations

import asyncio
import threading

import pytest

from service import decoding
from service.decoding import PictureDecoder
from service.problems import ProblemError
from sgmethod.errors import BitstreamError


def test_decodes_are_bounded_and_leave_the_loop_free(monkeypatch: pytest.MonkeyPatch) -> None:
    go_on = threading.Event()
    running: list[bytes] = []

    def slow(bitstream: bytes) -> bytes:
        running.append(bitstream)
        assert go_on.wait(30)
        return b"png of " + bitstream

    async def scenario() -> list[bytes]:
        decoder = PictureDecoder(max_running=2, max_waiting=1)
        tasks = [asyncio.create_task(decoder.png(b"%d" % number)) for number in range(3)]
        while len(running) < 2:
            await asyncio.sleep(0.01)  # the loop runs while decodes block their threads
        with pytest.raises(ProblemError) as refusal:
            await decoder.png(b"one too many")
        assert refusal.value.status == 503
        assert refusal.value.headers["Retry-After"]
        assert len(running) == 2
        go_on.set()
        return await asyncio.gather(*tasks)

    monkeypatch.setattr(decoding, "_decode_to_png", slow)
    assert asyncio.run(scenario()) == [b"png of 0", b"png of 1", b"png of 2"]


def test_what_is_no_bitstream() -> None:
    async def scenario() -> None:
        await PictureDecoder(1, 1).png(b"not a bitstream")

    with pytest.raises(BitstreamError):
        asyncio.run(scenario())
