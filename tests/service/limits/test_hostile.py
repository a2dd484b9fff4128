"""Clients that mean harm, against the running server: each is turned away, and everybody else is served."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor

import pytest
from PIL import Image

from tests.harness.attacks import crowded_bitstream, png_chunk, png_that_claims
from tests.harness.data import PICTURE
from tests.harness.pictures import SMALL
from tests.harness.service import Service, StartService, assert_problem

SOME_ID = "0123456789abcdef" * 2


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
def test_a_host_of_the_clients_choice_is_never_repeated(web: Service) -> None:
    for path in ("/jobs/", "/static", "/livez/"):
        request = f"GET {path} HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n"
        assert b"evil.example" not in web.raw(request.encode())


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


@pytest.mark.thorough
def test_simultaneous_requests_for_a_picture_make_it_once(start_service: StartService) -> None:
    web = start_service("web", max_decodes=1)
    url = f"/decode/{web.published(PICTURE)}.png?scale=40"
    with ThreadPoolExecutor(50) as clients:
        answers = list(clients.map(lambda _: web.client.get(url), range(50)))
    assert {(answer.status_code, answer.content) for answer in answers} == {(200, answers[0].content)}
    assert web.figures()["sgmethod_decode_seconds_count"] == 1


def animation(format_: str) -> bytes:
    file = io.BytesIO()
    frames = [Image.new("RGB", (8, 8), colour) for colour in ("red", "blue")]
    frames[0].save(file, format_, save_all=True, append_images=frames[1:])
    return file.getvalue()


def wide_tiff() -> bytes:
    file = io.BytesIO()
    Image.new("1", (65_536, 10)).save(file, "TIFF", compression="group4")
    return file.getvalue()


@pytest.mark.parametrize(
    ("image", "status", "words"),
    [
        (b"", 422, "empty"),
        (SMALL[:20], 422, ""),
        (png_that_claims(0, 10), 422, ""),
        *((png_that_claims(*size), 422, "too large") for size in ((2**31 - 1,) * 2, (20_000,) * 2, (65_536, 1))),
        (png_that_claims(1001, 1000), 422, "too large"),
        (wide_tiff(), 422, "too large"),
        *((animation(kind), 422, "contains more than one picture") for kind in ("PNG", "WebP", "TIFF", "GIF")),
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


def test_a_bomb_costs_nobody_anything_before_the_encoder(web: Service) -> None:
    """Which reads as many pixels as there are."""
    assert web.post(png_that_claims(16, 16, bytes(30_000_000))).status_code == 202


IDS = (SOME_ID, SOME_ID.upper(), SOME_ID[:-1], f"{SOME_ID}0", f"{SOME_ID}%0A", "..%2F..%2Fetc%2Fpasswd", "%00", "%FF")
KINDS = {"jobs": "", "decode": ".png", "bitstreams": ".sg"}
NOWHERE = [
    *(f"/{kind}/{job_id}{end}" for kind, end in KINDS.items() for job_id in IDS),
    *(f"/decode/DONE{end}" for end in (".gif", ".", ".png.jpg", ".PNG", ".svg", ".png/", ".png%00")),
    *("/jobs/../../etc/passwd", "/decode/..%2f..%2fjobs.sqlite3.png", "/bitstreams/../jobs.sqlite3"),
    *("/bitstreams/....//jobs.sg", "/bitstreams/%2e%2e%2fsources.sg", "/static//etc/passwd", "/static/..\\app.py"),
    *("/static/../app.py", "/static/..%2fapp.py", "/static/%2e%2e/settings.py", "/static/main.js%00.png"),
    "/static/" + "a" * 3000,
]


@pytest.mark.parametrize("path", NOWHERE)
def test_paths_that_lead_nowhere(web: Service, done: str, path: str) -> None:
    """As they stand, which no client of HTTP would send."""
    for method in ("GET", "DELETE") if path.startswith("/jobs/") else ("GET",):
        request = f"{method} {path.replace('DONE', done)} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        answer = web.raw(request.encode())
        assert answer.startswith(b"HTTP/1.1 404 ")
        assert b"application/problem+json" in answer
