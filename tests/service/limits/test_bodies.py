"""Bodies that are too large or end early, byte by byte over real sockets."""

from __future__ import annotations

import json
import signal
import socket
from collections.abc import Iterator

import pytest

from tests.harness.pictures import SMALL
from tests.harness.service import SMALL_QUEUE, Service, StartService, assert_problem

BOUNDARY = "frontier"
HEAD = (
    f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="bpp"\r\n\r\n1\r\n'
    f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
).encode()
TAIL = f"\r\n--{BOUNDARY}--\r\n".encode()
FORM = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
LIMIT = 200_000  # the fixture's


def connect(web: Service, *headers: str) -> socket.socket:
    """A connection that has sent the head of POST /encode."""
    connection = web.connect()
    lines = ["POST /encode HTTP/1.1", "Host: localhost", f"Content-Type: {FORM['Content-Type']}", *headers]
    connection.sendall("\r\n".join([*lines, "", ""]).encode())
    return connection


def problem_from(connection: socket.socket, status: int) -> dict[str, object]:
    """The problem document that the server answers."""
    with connection.makefile("rb") as response:
        assert response.readline().startswith(f"HTTP/1.1 {status} ".encode())
        headers = dict(line.lower().split(b": ", 1) for line in iter(response.readline, b"\r\n"))
        assert headers[b"content-type"].strip() == b"application/problem+json"
        problem: dict[str, object] = json.loads(response.read(int(headers[b"content-length"])))
    assert problem["status"] == status
    return problem


def test_a_chunked_body_is_as_good_as_any(web: Service) -> None:
    def chunks() -> Iterator[bytes]:
        yield HEAD
        for start in range(0, len(SMALL), 1000):
            yield SMALL[start : start + 1000]
        yield TAIL

    answer = web.client.post("/encode", content=chunks(), headers=FORM)
    assert answer.status_code == 202, answer.text


@pytest.mark.parametrize(
    ("headers", "sent"),
    [
        ([f"Content-Length: {LIMIT + 1}"], b""),
        (["Content-Length: 999999999999", "Expect: 100-continue"], b""),  # and not "100 Continue" first
        ([f"Content-Length: {len(HEAD) + 20 * LIMIT}"], HEAD + bytes(20 * LIMIT)),  # who sends on can read the answer
    ],
    ids=["silent", "expects", "sends on"],
)
def test_a_declared_length_beyond_the_limit_is_refused_unread(web: Service, headers: list[str], sent: bytes) -> None:
    with connect(web, *headers) as connection:
        connection.sendall(sent)
        assert problem_from(connection, 413)["max_bytes"] == LIMIT


def test_a_form_that_ends_early(web: Service) -> None:
    before = web.files()
    assert_problem(web.client.post("/encode", content=HEAD + SMALL[:1000], headers=FORM), 422, "image")
    assert web.files() == before


@pytest.mark.parametrize("piece", [1000, 100_000])
def test_a_chunked_body_beyond_the_limit(web: Service, piece: int) -> None:
    def endless() -> Iterator[bytes]:
        yield HEAD
        for _ in range(3 * LIMIT // piece):
            yield bytes(piece)

    answer = web.client.post("/encode", content=endless(), headers=FORM)
    assert_problem(answer, 413, str(LIMIT))


def test_a_part_with_endless_headers(web: Service) -> None:
    """They would be held in memory, and copied for each piece that comes."""
    for flood in (b"X-Long: " + b"x" * 100_000, b"X-Short: x\r\n" * 10_000):
        head = f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n'.encode()
        answer = web.client.post("/encode", content=head + flood + b"\r\n\r\n" + SMALL + TAIL, headers=FORM)
        assert_problem(answer, 400)


def test_a_full_queue_refuses_a_body_unread(empty: Service) -> None:
    for _ in range(SMALL_QUEUE):
        empty.accepted()
    with connect(empty, "Content-Length: 5000") as connection:
        problem_from(connection, 429)


def test_a_body_where_none_belongs(web: Service) -> None:
    answer = web.client.request("GET", "/livez", content=b"x" * 10_000)
    assert answer.status_code == 200
    assert web.client.get("/livez").status_code == 200


@pytest.mark.thorough
def test_the_end_does_not_wait_for_ever(start_service: StartService) -> None:
    service = start_service(stop_grace_s=2)
    service.client.get("/livez")
    with connect(service, "Content-Length: 5000") as connection:
        connection.sendall(HEAD)
        service.process.send_signal(signal.SIGTERM)
        assert service.stop() == 0
    assert service.files() == []
