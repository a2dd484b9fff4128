"""Clients that mean harm, or send too much or too little: each is turned away, and everybody else is served."""

from __future__ import annotations

import json
import re
import signal
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack

import pytest
from PIL import Image

from service.api.problems import RETRYABLE
from tests.support.attacks import crowded_bitstream, png_chunk, png_that_claims
from tests.support.data import PICTURE
from tests.support.pictures import SMALL, saved
from tests.support.service import SMALL_QUEUE, Service, StartService, assert_problem

SOME_ID = "0123456789abcdef" * 2
BOUNDARY = "frontier"
HEAD = (
    f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="bpp"\r\n\r\n1\r\n'
    f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="image"; filename="a.png"\r\n\r\n'
).encode()
TAIL = f"\r\n--{BOUNDARY}--\r\n".encode()
FORM = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
LIMIT = 200_000  # the fixture's


@pytest.mark.thorough
def test_a_bomb_in_the_encoder_ends_as_a_failed_job(service: Service) -> None:
    job = service.wait(service.accepted(png_that_claims(16, 16, bytes(30_000_000)), bpp=1))
    assert job["state"] in ("done", "failed")
    assert job["attempt"] == 1


@pytest.mark.thorough
def test_polyglots_come_back_as_pixels_alone(service: Service) -> None:
    script = b"<script>alert(1)</script>"
    comment = b"Comment\0" + script
    polyglot = SMALL[:33] + png_chunk(b"tEXt", comment) + SMALL[33:] + b"%PDF-1.7" + script
    job = service.wait(service.accepted(polyglot, bpp=2, time_limit_s=0.5))
    assert job["state"] == "done"
    for url in (job["decode_url"], job["bitstream_url"]):
        answer = service.client.get(url)
        assert script not in answer.content
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["content-type"] in ("image/png", "application/octet-stream")
    page = b"GIF89a/*" + script
    assert_problem(service.post(page), 422)


@pytest.mark.thorough
def test_a_bitstream_of_too_many_gaussians(keeping: Service) -> None:
    """Millions of equal ones take a few bytes each thousand, and minutes to draw."""
    bitstream = crowded_bitstream(1_000_001, 1001)
    assert_problem(keeping.client.post("/decode", content=bitstream), 422, "limit of 1000000")


@pytest.mark.thorough
def test_many_decodes_at_once_are_refused_and_not_piled_up(start_service: StartService) -> None:
    """One client has half of the 64 places in line."""
    web = start_service("web", max_decodes=1)
    done = web.published(PICTURE)
    with ThreadPoolExecutor(50) as clients:
        urls = [f"/decode/{done}.png?width={2500 + number}" for number in range(50)]
        statuses = set(clients.map(lambda url: web.client.get(url).status_code, urls))
    assert statuses == {200, 429}


RED, BLUE = (Image.new("RGB", (8, 8), colour) for colour in ("red", "blue"))
ANIMATIONS = [saved(RED, kind, save_all=True, append_images=[BLUE]) for kind in ("PNG", "WebP", "TIFF", "GIF")]


@pytest.mark.parametrize(
    ("image", "status", "words"),
    [
        (b"", 422, "empty"),
        (SMALL[:20], 422, ""),
        (png_that_claims(0, 10), 422, ""),
        *((png_that_claims(*size), 422, "too large") for size in ((2**31 - 1,) * 2, (20_000,) * 2, (65_536, 1))),
        (png_that_claims(1001, 1000), 422, "too large"),
        (saved(Image.new("1", (65_536, 10)), "TIFF", compression="group4"), 422, "too large"),
        *((animation, 422, "contains more than one picture") for animation in ANIMATIONS),
        (b"hello", 415, "PNG, JPEG"),
        (b"GIF88a" + b"0" * 40, 415, "PNG, JPEG"),
        (b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(100), 415, "JPEG 2000"),
        (b"\0\0\0\x18ftypisom\0\0\0\0mp41isom" + bytes(100), 415, "video"),
        (b"%PDF-1.7" + bytes(100), 415, "PDF"),
        (b"<svg xmlns=" + bytes(100), 415, "SVG"),
        (b"\xd3\xc2" + bytes(100), 415, ".sg"),
    ],
    ids=lambda value: repr(value[:12]) if isinstance(value, bytes) else None,
)
def test_images_that_are_refused(web: Service, image: bytes, status: int, words: str) -> None:
    before = web.files()
    assert_problem(web.post(image), status, words)
    assert web.files() == before


IDS = (SOME_ID, SOME_ID.upper(), SOME_ID[:-1], f"{SOME_ID}0", f"{SOME_ID}%0A", "..%2F..%2Fetc%2Fpasswd", "%00", "%FF")
KINDS = {"jobs": "", "decode": ".png", "bitstreams": ".sg"}
NOWHERE = [
    *(f"/{kind}/{job_id}{end}" for kind, end in KINDS.items() for job_id in IDS),
    *(f"/decode/DONE{end}" for end in (".gif", ".", ".png.jpg", ".PNG", ".svg", ".png/", ".png%00")),
    *("/jobs/../../etc/passwd", "/decode/..%2f..%2fjobs.sqlite3.png", "/bitstreams/../jobs.sqlite3"),
    *("/bitstreams/....//jobs.sg", "/bitstreams/%2e%2e%2fsources.sg", "/static//etc/passwd", "/static/..\\app.py"),
    *("/static/../app.py", "/static/..%2fapp.py", "/static/%2e%2e/settings.py", "/static/main.js%00.png"),
    *("/static/" + "a" * 3000, "/jobs/", "/static", "/livez/"),
]


@pytest.mark.parametrize("path", NOWHERE)
def test_paths_that_lead_nowhere(web: Service, done: str, path: str) -> None:
    """As they stand, which no client of HTTP would send. A host of the client's choice is never repeated."""
    for method in ("GET", "DELETE") if path.startswith("/jobs/") else ("GET",):
        request = f"{method} {path.replace('DONE', done)} HTTP/1.1\r\nHost: localhost:9\r\nConnection: close\r\n\r\n"
        answer = web.raw(request.encode())
        assert answer.startswith(b"HTTP/1.1 404 ")
        assert b"application/problem+json" in answer
        assert b"localhost" not in answer


def connect(web: Service, *headers: str, path: str = "/encode") -> socket.socket:
    """A connection that has sent the head of a POST."""
    connection = web.connect()
    lines = [f"POST {path} HTTP/1.1", "Host: localhost", f"Content-Type: {FORM['Content-Type']}", *headers]
    connection.sendall("\r\n".join([*lines, "", ""]).encode())
    return connection


def problem_from(connection: socket.socket, status: int) -> dict[str, object]:
    """The problem document that the server answers."""
    with connection.makefile("rb") as response:
        assert response.readline().startswith(f"HTTP/1.1 {status} ".encode())
        headers = dict(line.lower().split(b": ", 1) for line in iter(response.readline, b"\r\n"))
        assert headers[b"content-type"].strip() == b"application/problem+json"
        assert status not in RETRYABLE or b"retry-after" in headers
        problem: dict[str, object] = json.loads(response.read(int(headers[b"content-length"])))
    assert problem["status"] == status
    return problem


@pytest.mark.parametrize(
    ("headers", "sent"),
    [
        ([f"Content-Length: {LIMIT + 1}"], b""),
        ([f"Content-Length: {LIMIT + 1:05000}"], b""),
        ([f"Content-Length: {10**18}"], b""),
        (["Content-Length: 999999999999", "Expect: 100-continue"], b""),  # and not "100 Continue" first
        ([f"Content-Length: {len(HEAD) + 20 * LIMIT}"], HEAD + bytes(20 * LIMIT)),  # who sends on can read the answer
    ],
    ids=["silent", "zeros", "19 digits", "expects", "sends on"],
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


@pytest.mark.thorough
def test_the_end_does_not_wait_for_ever(start_service: StartService) -> None:
    """Whoever is not served by then is told to ask again: with an upload on its way, or in line behind other decodes.

    They got 500, which no client repeats, and the log a traceback for each.
    """
    service = start_service(stop_grace_s=2, max_decodes=1)
    service.wait_ready()
    crowded = crowded_bitstream()  # takes seconds to draw
    with ExitStack() as connections:
        sending = connections.enter_context(connect(service, "Content-Length: 5000"))
        sending.sendall(HEAD)
        for _ in range(4):
            waiting = connections.enter_context(connect(service, f"Content-Length: {len(crowded)}", path="/decode"))
            waiting.sendall(crowded)
        service.client.get("/livez")
        service.process.send_signal(signal.SIGTERM)
        assert problem_from(sending, 503)["type"] == "/docs#stop"
        assert service.stop() == 0
    assert service.files() == []
    log = service.log.read_text()
    assert "Traceback" not in log
    assert len(re.findall(r"access: POST '/encode' 503 .* stop ", log)) == 1
    # Where a body was not read yet, the connection may be reset before the client has seen the answer.
    assert len(re.findall(r"access: POST '/decode' 503 .* stop ", log)) >= 2
    assert not re.search(r"access: .* 500 ", log)
