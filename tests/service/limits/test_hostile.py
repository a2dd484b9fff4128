"""Clients that mean harm, against the running server: each is turned away, and everybody else is served."""

from __future__ import annotations

import contextlib
import io
import json
import re
import resource
import select
import socket
import struct
import time
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from PIL import Image

from service.jobs.job import SourceImage
from service.web.server import MAX_HEAD_BYTES
from tests.harness.data import golden_path
from tests.harness.pictures import SMALL
from tests.harness.processes import PATIENCE_S, wait_until
from tests.harness.service import Service, StartService, assert_problem

pytestmark = pytest.mark.thorough

PICTURE = golden_path("v2-color.sg").read_bytes()
HEADER_LIMIT = MAX_HEAD_BYTES
HEADER_TIMEOUT_S = 0.5


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A web process with small limits."""
    service = Service(
        tmp_path_factory.mktemp("strict") / "data",
        "web",
        send_timeout_s=1,
        max_pixels=1_000_000,
        max_decode_gaussians=10,
        queue_length=10_000,
    )
    yield service
    assert service.client.get("/livez").status_code == 200
    assert service.stop() == 0


@pytest.fixture(scope="module")
def hasty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A web process that does not wait long for headers."""
    service = Service(tmp_path_factory.mktemp("hasty") / "data", "web", header_timeout_s=HEADER_TIMEOUT_S)
    yield service
    assert service.stop() == 0


def status_of(answer: bytes) -> int:
    """The status of an answer that closes the connection, a problem document if it is none of success."""
    head, _, body = answer.partition(b"\r\n\r\n")
    status = int(head.split()[1])
    if status >= 400:
        assert b"connection: close" in head.lower()
        assert json.loads(body)["status"] == status
    return status


def closes(connection: socket.socket) -> bytes:
    """What still comes until the server closes the connection."""
    answer = b""
    try:
        while data := connection.recv(65536):
            answer += data
    except ConnectionError:
        pass
    return answer


def answered(web: Service, request: str) -> socket.socket:
    """A connection whose first request is answered with success: where a head has little time, the test that sends it
    may have to wait for a core just then, so another connection is tried.
    """

    def attempt() -> socket.socket | None:
        connection = web.connect()
        with contextlib.suppress(ConnectionError):
            connection.sendall(f"{request} HTTP/1.1\r\nHost: test\r\n\r\n".encode())
            if connection.recv(65536).startswith(b"HTTP/1.1 2"):
                return connection
        connection.close()
        return None

    connection = wait_until(attempt)
    assert connection is not None
    return connection


def test_a_connection_that_says_nothing(hasty: Service) -> None:
    with hasty.connect() as connection:
        assert closes(connection) == b""


@pytest.mark.parametrize("drip", [b"X-A: b\r\n", b"x", b"\r\n"])
def test_headers_that_trickle(hasty: Service, drip: bytes) -> None:
    with hasty.connect() as connection:
        if drip != b"\r\n":
            connection.sendall(b"GET /livez HTTP/1.1\r\nHost: test\r\n")
        connection.settimeout(0.05)
        answer = b""
        for _ in range(1000):
            try:
                connection.sendall(drip)
                answer += (data := connection.recv(65536))
                if not data:
                    break
            except TimeoutError:
                continue
            except ConnectionError:
                break
        else:
            raise AssertionError("the connection was never closed")
        assert answer == b"" or status_of(answer) == 408


def test_a_second_request_that_trickles(hasty: Service) -> None:
    def refusal() -> bytes:  # nothing where the second one came so late that the connection had been idle for too long
        with answered(hasty, "GET /livez") as connection, contextlib.suppress(ConnectionError):
            connection.sendall(b"GET /livez HTTP/1.1\r\n")
            return closes(connection)
        return b""

    assert status_of(wait_until(refusal)) == 408


def test_a_slow_answer_is_not_cut_off_by_the_time_for_headers(hasty: Service) -> None:
    job_id = hasty.submitted(SourceImage("PNG", 64, 48, 10))
    with answered(hasty, f"GET /jobs/{job_id}/events") as connection:
        time.sleep(3 * HEADER_TIMEOUT_S)
        answered(hasty, f"DELETE /jobs/{job_id}").close()
        text = b""
        while b"event: removed" not in text:
            data = connection.recv(65536)
            assert data
            text += data


def test_headers_that_just_fit(strict: Service) -> None:
    answer = strict.client.get("/livez", headers={"X-Long": "x" * (HEADER_LIMIT - 300)})
    assert answer.status_code == 200


@pytest.mark.parametrize(
    "flood",
    [
        b"GET /livez HTTP/1.1\r\nHost: test\r\nX-Long: " + b"x" * HEADER_LIMIT + b"\r\n\r\n",
        b"GET /livez HTTP/1.1\r\nHost: test\r\nX-Endless: " + b"x" * 5_000_000,
        b"GET /livez HTTP/1.1\r\nHost: test\r\n" + b"X-A: b\r\n" * 20_000 + b"\r\n",
        b"GET /livez HTTP/1.1\r\n" + b"X-A: b\r\n" * 500_000,
        b"GET /livez?" + b"x" * HEADER_LIMIT + b" HTTP/1.1\r\nHost: test\r\n\r\n",
        b"GET /" + b"x" * 5_000_000,
    ],
)
def test_header_floods(strict: Service, flood: bytes) -> None:
    answer = strict.raw(flood)
    assert answer == b"" or status_of(answer) == 431  # nothing where it went under in a reset


@pytest.mark.parametrize(
    "request_",
    [
        b"hello\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(100),  # TLS
        b"GET /livez HTTP/1.1\nHost test\n\n",
        b"GET /livez HTTP/9.9\r\n\r\n",
        b"GET /livez HTTP/1.1\r\nHost: test\r\nBad Name: x\r\n\r\n",
        b"GET /livez HTTP/1.1\r\nHost: test\r\nX: a\x00b\r\n\r\n",
        b"POST /encode HTTP/1.1\r\nHost: test\r\nContent-Length: -1\r\n\r\n",
        b"POST /encode HTTP/1.1\r\nHost: test\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nx",
        b"POST /encode HTTP/1.1\r\nHost: test\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
        b"POST /encode HTTP/1.1\r\nHost: test\r\nContent-Length: 99999999999999999999999\r\n\r\n",
        b"GET \xff\xfe HTTP/1.1\r\nHost: test\r\n\r\n",
    ],
)
def test_what_is_no_http(strict: Service, request_: bytes) -> None:
    assert status_of(strict.raw(request_)) == 400


@pytest.mark.parametrize(
    "body", [b"zz\r\nx\r\n", b"-5\r\nhello\r\n", b"ffffffffffffffffff\r\nx", b"1\r\nxx\r\n0\r\n\r\n"]
)
def test_chunks_that_are_none(strict: Service, body: bytes) -> None:
    head = b"POST /encode?bpp=1 HTTP/1.1\r\nHost: test\r\nContent-Type: image/png\r\nTransfer-Encoding: chunked\r\n\r\n"
    answer = strict.raw(head + body)
    assert answer == b"" or status_of(answer) in (400, 408)


def test_there_are_no_websockets_anywhere(strict: Service) -> None:
    """The server by itself would answer the handshake like any request, and log two lines of advice."""
    websocket = {"Connection": "Upgrade", "Upgrade": "WebSocket", "Sec-WebSocket-Key": "x"}
    document = strict.client.get("/openapi.json").json()
    for path in (*document["paths"], "/", "/openapi.json", "/static/page/main.js", "/no/such/path"):
        answer = strict.client.get(path.format(job_id="0" * 32, kind="png"), headers=websocket)
        assert_problem(answer, 404, "no WebSockets")
        assert answer.headers["connection"] == "close"
    assert_problem(strict.client.post("/encode?bpp=1", content=SMALL, headers=websocket), 404, "no WebSockets")
    frame = b"\x81\x85\0\0\0\0hello"
    head = "".join(f"{name}: {value}\r\n" for name, value in websocket.items())
    assert status_of(strict.raw(f"GET /jobs HTTP/1.1\r\nHost: test\r\n{head}\r\n".encode() + frame)) == 404


def test_another_protocol_is_an_offer_that_is_left(strict: Service) -> None:
    """As `curl --http2` and Java's client make it with every request. The parser takes what follows for the other
    protocol: a body was lost, or taken for a request of its own."""
    offer = {"Connection": "Upgrade, HTTP2-Settings", "Upgrade": "h2c", "HTTP2-Settings": "AAMAAABkAAQCAAAAAAIAAAAA"}
    assert strict.client.get("/livez", headers=offer).status_code == 200
    image = {"Content-Type": "image/png", **offer}
    for content in (SMALL, iter([SMALL[:100], SMALL[100:]])):  # with its length, and in chunks
        assert strict.client.post("/encode?bpp=1", content=content, headers=image).status_code == 202
    assert strict.client.get("/livez").status_code == 200
    assert "pgrade" not in strict.log.read_text()


@pytest.mark.parametrize("pause_s", [0, 0.1])
def test_no_body_is_taken_for_a_request(strict: Service, pause_s: float) -> None:
    offer = b"Host: test\r\nConnection: Upgrade\r\nUpgrade: h2c\r\n"
    hidden = b"GET /hidden HTTP/1.1\r\nHost: test\r\n\r\n"
    head = b"POST /decode HTTP/1.1\r\n" + offer + b"Content-Length: %d\r\n\r\n" % len(hidden)
    last = b"GET /jobs HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n"
    with strict.connect() as connection:
        for part in (head, hidden, b"GET /livez HTTP/1.1\r\n" + offer + b"\r\n" + last):
            connection.sendall(part)
            time.sleep(pause_s)
        answer = closes(connection)
    assert re.findall(rb"HTTP/1.1 (\d+)", answer) == [b"422", b"200", b"200"]
    assert b"/hidden" not in strict.log.read_bytes()


def test_very_many_offers_at_once(web: Service) -> None:
    """Of a service that does not cut off slow readers: all requests are sent before one is read."""
    offer = b"GET /livez HTTP/1.1\r\nHost: test\r\nConnection: Upgrade\r\nUpgrade: h2c\r\n\r\n"
    answer = web.raw(2000 * offer + b"GET /livez HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n")
    assert answer.count(b"HTTP/1.1 200 OK") == 2001


def test_refused_connections_have_ids_and_lines_too(strict: Service) -> None:
    for request, status, reason in (
        (b"nonsense\r\n\r\n", 400, "malformed"),
        (b"GET /livez HTTP/1.1\r\nX: " + b"x" * HEADER_LIMIT, 431, "head"),
    ):
        answer = strict.raw(request)
        assert status_of(answer) == status
        (name,) = re.findall(rb"X-Request-Id: ([0-9a-f]{16})\r\n", answer)
        line = f"access: - {status}, 127.0.0.1 {reason} [{name.decode()}]"
        assert wait_until(lambda: line in strict.log.read_text())  # noqa: B023


def test_a_client_that_never_reads(strict: Service) -> None:
    done = strict.published(PICTURE)
    with strict.connect() as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        request = f"GET /decode/{done}.png?width=1000 HTTP/1.1\r\nHost: test\r\n\r\n"
        connection.sendall(3 * request.encode())  # more than buffers hold

        def cut_off() -> bool:
            try:
                connection.sendall(b"x")
            except ConnectionError:
                return True
            return False

        assert wait_until(cut_off)


def test_what_slow_readers_hold_in_memory_is_limited(start_service: StartService) -> None:
    """A client that takes its answer by the spoonful keeps others waiting for a while, and is cut off."""
    web = start_service("web", max_answer_bytes=1000, send_timeout_s=1, decode_cache_bytes=0)
    done = web.published(PICTURE)
    picture = f"/decode/{done}.png?scale=64"
    slow: list[socket.socket] = []

    def after_one_more() -> httpx.Response | None:  # those before it may have been cut off already
        slow.append(web.connect())
        slow[-1].setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow[-1].sendall(8 * f"GET {picture} HTTP/1.1\r\nHost: test\r\n\r\n".encode())  # more than buffers hold
        answer = web.client.get(picture)
        return answer if answer.status_code == 503 else None

    def served_again() -> bool:
        for connection in select.select(slow, [], [], 0)[0]:
            with contextlib.suppress(ConnectionError):
                connection.recv(1000)
        return web.client.get(picture).status_code == 200

    try:
        answer = wait_until(after_one_more)
        assert answer is not None
        assert_problem(answer, 503, "on their way")
        assert answer.headers["retry-after"]
        assert web.client.get(f"/bitstreams/{done}.sg").status_code == 200
        assert wait_until(served_again)
    finally:
        for connection in slow:
            connection.close()


def test_few_descriptors_are_no_limit(start_service: StartService) -> None:
    """The system's soft limit is raised: it is often lower than the number of connections that are allowed."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (64, hard))
    try:
        web = start_service("web")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    crowd = [web.connect() for _ in range(200)]
    try:
        assert web.post().status_code == 202
    finally:
        for connection in crowd:
            connection.close()


def test_connections_are_limited_and_made_free(start_service: StartService) -> None:
    web = start_service("web", max_connections=5, header_timeout_s=PATIENCE_S)
    job_id = web.accepted()
    web.client.close()
    crowd = [web.connect() for _ in range(8)]
    try:
        assert [closes(connection) for connection in crowd[:3]] == [b"", b"", b""]  # the slowest
        for connection in crowd[3:]:
            connection.sendall(f"GET /jobs/{job_id}/events HTTP/1.1\r\nHost: test\r\n\r\n".encode())
            assert connection.recv(15) == b"HTTP/1.1 200 OK"
        with web.connect() as one_too_many:
            assert status_of(closes(one_too_many)) == 503
    finally:
        for connection in crowd:
            connection.close()
    with httpx.Client(base_url=web.url, timeout=PATIENCE_S) as client:
        assert wait_until(lambda: client.get("/livez").status_code == 200)


def png(width: int, height: int, data: bytes) -> bytes:
    """A PNG of 8-bit grey with these filtered rows."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    packed = zlib.compress(data, 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


def test_bombs(strict: Service) -> None:
    assert_problem(strict.post(png(20_000, 20_000, bytes(1000))), 422, "too large")
    tiff = io.BytesIO()
    Image.new("1", (65_536, 10)).save(tiff, "TIFF", compression="group4")
    assert_problem(strict.post(tiff.getvalue()), 422, "too large")
    # What unpacks to far more than the header says is accepted, and costs nobody anything before the encoder,
    # which reads as many pixels as there are.
    answer = strict.post(png(16, 16, bytes(30_000_000)))
    assert answer.status_code == 202


def test_a_bomb_in_the_encoder_ends_as_a_failed_job(service: Service) -> None:
    job = service.wait(service.accepted(png(16, 16, bytes(30_000_000)), bpp=1))
    assert job["state"] in ("done", "failed")
    assert job["attempt"] == 1


@pytest.mark.parametrize("format_", ["PNG", "WebP", "TIFF", "GIF"])
def test_animations(strict: Service, format_: str) -> None:
    file = io.BytesIO()
    frames = [Image.new("RGB", (8, 8), colour) for colour in ("red", "blue")]
    frames[0].save(file, format_, save_all=True, append_images=frames[1:])
    answer = strict.post(file.getvalue())
    assert_problem(answer, 422, "contains more than one picture")


def test_polyglots_come_back_as_pixels_alone(service: Service) -> None:
    script = b"<script>alert(1)</script>"
    comment = b"tEXtComment\0" + script
    chunk = struct.pack(">I", len(comment) - 4) + comment + struct.pack(">I", zlib.crc32(comment))
    polyglot = SMALL[:33] + chunk + SMALL[33:] + b"%PDF-1.7" + script
    job = service.wait(service.accepted(polyglot, bpp=2, time_limit_s=0.5))
    assert job["state"] == "done"
    for url in (job["decode_url"], job["bitstream_url"]):
        answer = service.client.get(url)
        assert script not in answer.content
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["content-type"] in ("image/png", "application/octet-stream")
    page = b"GIF89a/*" + script
    assert_problem(service.post(page), 422)


@pytest.mark.parametrize(
    "path",
    [
        *("/jobs/../../etc/passwd", "/decode/..%2f..%2fjobs.sqlite3.png", "/bitstreams/../jobs.sqlite3"),
        *("/bitstreams/....//jobs.sg", "/static/../app.py", "/static/..%2fapp.py", "/static/%2e%2e/settings.py"),
        *(
            "/static//etc/passwd",
            "/static/page/main.js%00.png",
            "/bitstreams/%2e%2e%2fsources.sg",
            "/static/..\\app.py",
        ),
        "/static/" + "a" * 3000,
    ],
)
def test_path_tricks(strict: Service, path: str) -> None:
    request = f"GET {path} HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n"
    assert status_of(strict.raw(request.encode())) == 404


def test_a_host_of_the_clients_choice_is_never_repeated(strict: Service) -> None:
    for path in ("/jobs/", "/static", "/livez/"):
        request = f"GET {path} HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
        assert b"evil.example" not in strict.raw(request.encode())


def test_everybody_else_is_served_meanwhile(strict: Service) -> None:
    crowd = [strict.connect() for _ in range(40)]
    try:
        for number, connection in enumerate(crowd):
            connection.sendall(b"GET /livez HTTP/1.1\r\n" if number % 2 else b"POST /decode HTTP/1.1\r\nX: ")
        assert wait_until(lambda: strict.client.get("/livez").status_code == 200)
        assert strict.post().status_code == 202
    finally:
        for connection in crowd:
            connection.close()


def test_a_bitstream_of_too_many_gaussians(strict: Service) -> None:
    """Millions of equal ones take a few bytes each thousand, and minutes to draw. Our own results are not limited."""
    assert_problem(strict.client.post("/decode", content=PICTURE), 422, "limit of 10")
    assert strict.client.get(f"/decode/{strict.published(PICTURE)}.png").status_code == 200


def test_many_decodes_at_once_are_refused_and_not_piled_up(start_service: StartService) -> None:
    web = start_service("web", max_decodes=1, max_waiting_decodes=0, decode_cache_bytes=0)
    done = web.published(PICTURE)
    with ThreadPoolExecutor(16) as clients:
        url = f"/decode/{done}.png?scale=40"
        statuses = set(clients.map(lambda _: web.client.get(url).status_code, range(16)))
    assert statuses == {200, 503}
