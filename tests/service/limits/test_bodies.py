"""Bodies that are too large, too slow or never end, byte by byte over real sockets."""

from __future__ import annotations

import json
import select
import signal
import socket
from collections.abc import Iterator

import httpx
import pytest

from service.keys import digest
from tests.harness.pictures import SMALL
from tests.harness.processes import PATIENCE_S, wait_until
from tests.harness.service import SMALL_QUEUE, Service, StartService, assert_problem

BOUNDARY = "frontier"
HEAD = (
    f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="bpp"\r\n\r\n1\r\n'
    f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
).encode()
TAIL = f"\r\n--{BOUNDARY}--\r\n".encode()
FORM = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
LIMIT = 200_000 + 16 * 1024  # the fixture's, and what multipart may add


@pytest.fixture(scope="module")
def hasty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A web process that does not wait long for bodies; for tests alone in which none arrives."""
    folder = tmp_path_factory.mktemp("hasty") / "data"
    service = Service(folder, "web", body_chunk_timeout_s=0.5, body_timeout_s=2)
    yield service
    assert service.stop() == 0


def connect(web: Service, *headers: str) -> socket.socket:
    """A connection that has sent the head of POST /encode."""
    connection = web.connect()
    lines = ["POST /encode HTTP/1.1", "Host: test", f"Content-Type: {FORM['Content-Type']}", *headers]
    connection.sendall("\r\n".join([*lines, "", ""]).encode())
    return connection


def problem_from(connection: socket.socket, status: int) -> dict[str, object]:
    """The problem document that the server answers, saying also that it will close the connection."""
    with connection.makefile("rb") as response:
        assert response.readline().startswith(f"HTTP/1.1 {status} ".encode())
        headers = dict(line.lower().split(b": ", 1) for line in iter(response.readline, b"\r\n"))
        assert headers[b"connection"].strip() == b"close"
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


def test_a_declared_length_beyond_the_limit_is_refused_unread(web: Service) -> None:
    with connect(web, f"Content-Length: {LIMIT + 1}") as connection:
        assert problem_from(connection, 413)["max_bytes"] == LIMIT


def test_no_continue_for_a_body_beyond_the_limit(web: Service) -> None:
    with connect(web, "Content-Length: 999999999999", "Expect: 100-continue") as connection:
        problem_from(connection, 413)  # and not "100 Continue" first


def test_a_client_that_sends_on_gets_to_read_the_answer(web: Service) -> None:
    body = HEAD + bytes(20 * LIMIT)
    with connect(web, f"Content-Length: {len(body)}") as connection:
        connection.sendall(body)
        problem_from(connection, 413)


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


@pytest.mark.thorough
def test_a_body_that_stops_coming(hasty: Service) -> None:
    with connect(hasty, "Content-Length: 5000") as connection:
        connection.sendall(HEAD + SMALL[:1000])
        problem_from(connection, 408)
    assert hasty.files() == []


def test_a_body_that_never_starts(hasty: Service) -> None:
    with connect(hasty, "Transfer-Encoding: chunked") as connection:
        problem_from(connection, 408)


def answered_meanwhile(connection: socket.socket) -> bool:
    """Whether there is an answer; else one more byte goes out."""
    if select.select([connection], [], [], 0.1)[0]:
        return True
    connection.sendall(b"x")
    return False


def test_a_body_that_trickles(hasty: Service) -> None:
    """Never long without a byte, but in all longer than the 2 s that a body may take."""
    with connect(hasty, "Content-Length: 5000") as connection:
        connection.sendall(HEAD)
        wait_until(lambda: answered_meanwhile(connection))
        problem_from(connection, 408)


@pytest.mark.thorough
def test_a_body_that_comes_too_slowly_for_its_size(start_service: StartService) -> None:
    """Neither a long silence nor long in all, but too few bytes a second."""
    web = start_service("web", body_chunk_timeout_s=1, body_timeout_s=100)
    with connect(web, "Content-Length: 5000") as connection:
        connection.sendall(HEAD)
        wait_until(lambda: answered_meanwhile(connection))
        problem_from(connection, 408)


@pytest.mark.thorough
def test_uploads_at_once_are_limited(start_service: StartService) -> None:
    """One client has half of them: a hundred slow ones of one address kept everybody's out."""
    keys = ",".join(f"{name}:{digest(name)}" for name in ("eve", "ann", "bob"))
    web = start_service("web", max_streams=4, api_keys=keys, body_chunk_timeout_s=1000)
    crowd: list[socket.socket] = []

    def begin(name: str) -> None:
        crowd.append(connect(web, "Content-Length: 5000", f"Authorization: Bearer {name}"))
        crowd[-1].sendall(HEAD)

    def post(name: str) -> httpx.Response:
        web.client.headers["Authorization"] = f"Bearer {name}"
        return web.post()

    def after(one_more: str, name: str, status: int) -> httpx.Response | None:
        begin(one_more)
        answer = post(name)
        return answer if answer.status_code == status else None

    try:
        answer = wait_until(lambda: after("eve", "eve", 429))
        assert answer is not None
        assert_problem(answer, 429, "uploads", "of yours alone")
        assert post("ann").status_code == 202
        answer = wait_until(lambda: after("ann", "bob", 503))
        assert answer is not None
        assert_problem(answer, 503, "uploads")
        assert answer.headers["retry-after"]
        assert web.client.get("/jobs").status_code == 200
    finally:
        for slow in crowd:
            slow.close()
    assert wait_until(lambda: post("bob").status_code == 202)


def test_a_full_queue_refuses_a_body_unread(empty: Service) -> None:
    for _ in range(SMALL_QUEUE):
        empty.accepted()
    with connect(empty, "Content-Length: 5000") as connection:
        problem_from(connection, 429)


def test_a_client_that_hangs_up(web: Service) -> None:
    before = web.files()
    for _ in range(5):
        with connect(web, "Content-Length: 5000") as connection:
            connection.sendall(HEAD + SMALL[:1000])
    assert web.client.get("/livez").status_code == 200
    assert web.files() == before


@pytest.mark.thorough
def test_slow_bodies_keep_nobody_waiting(web: Service) -> None:
    """Their own client has its part of the uploads; somebody else comes from another address."""
    crowd = [connect(web, "Content-Length: 5000") for _ in range(60)]
    try:
        elsewhere = httpx.HTTPTransport(local_address="127.0.0.2")
        with httpx.Client(base_url=web.url, transport=elsewhere, timeout=100) as other:
            assert other.get("/livez").status_code == 200
            assert other.post("/encode?bpp=1", content=SMALL, headers={"Content-Type": "image/*"}).status_code == 202
    finally:
        for connection in crowd:
            connection.close()


def test_a_body_where_none_belongs(web: Service) -> None:
    answer = web.client.request("GET", "/livez", content=b"x" * 10_000)
    assert answer.status_code == 200
    assert web.client.get("/livez").status_code == 200


@pytest.mark.thorough
def test_the_end_waits_for_an_upload_that_comes(start_service: StartService) -> None:
    """SIGTERM: what has begun is accepted, what is new is not, and the exit status is 0."""
    service = start_service(stop_grace_s=2 * PATIENCE_S, body_chunk_timeout_s=PATIENCE_S)
    service.client.get("/livez")
    body = HEAD + SMALL + TAIL
    with connect(service, f"Content-Length: {len(body)}") as connection:
        connection.sendall(body[:1000])
        wait_until(lambda: service.figures()['sgmethod_taken{what="uploads"}'] == 1)
        service.process.send_signal(signal.SIGTERM)
        wait_until(lambda: refuses(service))
        connection.sendall(body[1000:])
        with connection.makefile("rb") as response:
            assert response.readline().startswith(b"HTTP/1.1 202 ")
    assert service.stop() == 0
    service.start()
    assert len(service.client.get("/jobs").json()["jobs"]) == 1


@pytest.mark.thorough
def test_the_end_does_not_wait_for_ever(start_service: StartService) -> None:
    service = start_service(stop_grace_s=2, body_chunk_timeout_s=60)
    service.client.get("/livez")
    with connect(service, "Content-Length: 5000") as connection:
        connection.sendall(HEAD)
        service.process.send_signal(signal.SIGTERM)
        assert service.stop() == 0
    assert service.files() == []


def refuses(service: Service) -> bool:
    """Whether the service takes no new connections."""
    try:
        service.connect().close()
    except ConnectionRefusedError:
        return True
    return False
