"""Clients that mean harm, against the running server: each is turned away, and everybody else is served."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from PIL import Image

from tests.harness.attacks import crowded_bitstream
from tests.harness.data import golden_path
from tests.harness.pictures import SMALL
from tests.harness.service import Service, StartService, assert_problem

pytestmark = pytest.mark.thorough

PICTURE = golden_path("v2-color.sg").read_bytes()


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A web process with small limits."""
    service = Service(
        tmp_path_factory.mktemp("strict") / "data",
        "web",
        max_pixels=1_000_000,
        queue_length=10_000,
    )
    yield service
    assert service.client.get("/livez").status_code == 200
    assert service.stop() == 0


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
            "/static/main.js%00.png",
            "/bitstreams/%2e%2e%2fsources.sg",
            "/static/..\\app.py",
        ),
        "/static/" + "a" * 3000,
    ],
)
def test_path_tricks(strict: Service, path: str) -> None:
    request = f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    assert strict.raw(request.encode()).startswith(b"HTTP/1.1 404 ")


def test_a_host_of_the_clients_choice_is_never_repeated(strict: Service) -> None:
    for path in ("/jobs/", "/static", "/livez/"):
        request = f"GET {path} HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
        assert b"evil.example" not in strict.raw(request.encode())


def test_a_bitstream_of_too_many_gaussians(strict: Service) -> None:
    """Millions of equal ones take a few bytes each thousand, and minutes to draw."""
    bitstream = crowded_bitstream(1_000_001, 1001)
    assert_problem(strict.client.post("/decode", content=bitstream), 422, "limit of 1000000")


def test_many_decodes_at_once_are_refused_and_not_piled_up(start_service: StartService) -> None:
    """One client has half of the 64 places in line."""
    web = start_service("web", max_decodes=1)
    done = web.published(PICTURE)
    with ThreadPoolExecutor(50) as clients:
        urls = [f"/decode/{done}.png?width={2500 + number}" for number in range(50)]
        statuses = set(clients.map(lambda url: web.client.get(url).status_code, urls))
    assert statuses == {200, 429}


def test_simultaneous_requests_for_a_picture_make_it_once(start_service: StartService) -> None:
    web = start_service("web", max_decodes=1)
    url = f"/decode/{web.published(PICTURE)}.png?scale=40"
    with ThreadPoolExecutor(50) as clients:
        answers = list(clients.map(lambda _: web.client.get(url), range(50)))
    assert {(answer.status_code, answer.content) for answer in answers} == {(200, answers[0].content)}
    assert web.figures()["sgmethod_decode_seconds_count"] == 1
