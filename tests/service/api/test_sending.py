"""Files that clients read slowly, or not at all: how many of their bytes the service holds."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest
from starlette.types import Message, Receive

from service.api.context import Call
from service.api.problems import ProblemError
from service.api.sending import PART_BYTES, FileResponse
from service.api.turns import Shares

FILE = bytes(range(256)) * (8 * PART_BYTES // 256) + b"end"
NOTHING = cast(Receive, None)


def answer(unread: Shares, client: str, file: bytes = FILE) -> FileResponse:
    call = SimpleNamespace(context=SimpleNamespace(unread=unread), caller=SimpleNamespace(client=client))
    return FileResponse(cast(Call, call), file, {"ETag": '"x"'}, "image/png")


def refused(unread: Shares, client: str) -> int:
    with pytest.raises(ProblemError, match="files are waiting to be read") as error:
        answer(unread, client)
    assert error.value.headers["Retry-After"]
    return error.value.status


class Client:
    """Reads messages until it has read `parts` of a file, and then waits until it is told to go on."""

    def __init__(self, parts: int) -> None:
        self.messages: list[Message] = []
        self._left = parts
        self.goes_on = asyncio.Event()

    async def take(self, message: Message) -> None:
        self.messages.append(message)
        self._left -= message["type"] == "http.response.body"
        if self._left <= 0:
            await self.goes_on.wait()

    def body(self) -> bytes:
        return b"".join(message["body"] for message in self.messages[1:])


@pytest.mark.parametrize("size", [0, 5, PART_BYTES, PART_BYTES + 1, len(FILE)])
def test_a_file_arrives_whole(size: int) -> None:
    async def scenario() -> None:
        client, unread = Client(1000), Shares(1, 1)
        await answer(unread, "ann", FILE[:size])({}, NOTHING, client.take)
        first, *parts = client.messages
        assert (b"content-length", str(size).encode()) in first["headers"]
        assert client.body() == FILE[:size]
        assert [part.get("more_body", False) for part in parts] == [True] * (len(parts) - 1) + [False]
        assert max(len(part["body"]) for part in parts) <= PART_BYTES
        assert unread.total == 0

    asyncio.run(scenario())


def test_what_is_not_read_is_bounded() -> None:
    """A file is sent in parts, as its client reads. If too much is unread, large files are refused: first those of the
    same client, then all.
    """

    async def scenario() -> None:
        unread = Shares(3 * len(FILE), len(FILE))
        clients: dict[str, Client] = {}
        tasks: list[asyncio.Task[Any]] = []
        for name in ("ann", "bob", "cat"):
            clients[name] = Client(2)
            tasks.append(asyncio.create_task(answer(unread, name)({}, NOTHING, clients[name].take)))
            await asyncio.sleep(0)
            if name != "cat":
                assert refused(unread, name) == 429
        assert {len(one.body()) for one in clients.values()} == {2 * PART_BYTES}
        assert refused(unread, "dan") == 503
        answer(unread, "ann", b"small")
        clients["ann"].goes_on.set()
        tasks[1].cancel()  # the service ends
        await asyncio.gather(*tasks[:2], return_exceptions=True)
        assert clients["ann"].body() == FILE
        assert unread.total == len(FILE)
        answer(unread, "bob")
        assert refused(unread, "cat") == 429
        tasks[2].cancel()

    asyncio.run(scenario())
