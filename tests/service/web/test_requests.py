"""What may be asked of the web process, and what it answers when it may not. Nothing is encoded here."""

from __future__ import annotations

import io
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from service.api.app import STATIC
from tests.harness.data import JAVASCRIPT
from tests.harness.pictures import SMALL, png
from tests.harness.service import SMALL_QUEUE, Service, assert_problem

GOOD_ID = "0123456789abcdef" * 2


def png_header(width: int, height: int) -> bytes:
    """The start of a PNG that claims a size, and an empty rest."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def test_health(web: Service) -> None:
    answer = web.client.get("/livez")
    assert (answer.status_code, answer.json()["status"]) == (200, "ok")
    assert web.client.head("/livez").status_code == 200


def test_every_answer_has_the_security_headers(web: Service) -> None:
    for path in ("/", "/docs", "/livez", "/nowhere", f"/jobs/{GOOD_ID}", "/static/main.js"):
        headers = web.client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["content-security-policy"].startswith("default-src 'none'")


def test_page_names_nothing_elsewhere(web: Service) -> None:
    page = web.client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "script-src 'self'" in page.headers["content-security-policy"]
    files = [f"/static/{file.relative_to(STATIC)}" for kind in ("js", "css") for file in STATIC.rglob(f"*.{kind}")]
    files += [f"/static/sgmethod/{file.name}" for file in JAVASCRIPT.iterdir()]
    assert len(files) > 20
    for path in ("/", "/docs", *files):
        answer = web.client.get(path)
        assert answer.status_code == 200
        assert "://" not in answer.text.replace("http://www.w3.org", "").replace("http://127.0.0.1:8000", "")


def test_openapi_lists_the_routes(web: Service) -> None:
    document = web.client.get("/openapi.json").json()
    assert set(document["paths"]) == {
        "/encode",
        "/jobs",
        "/jobs/{job_id}",
        "/jobs/{job_id}/encode",
        "/decode",
        "/decode.{kind}",
        "/decode/{job_id}",
        "/decode/{job_id}.{kind}",
        "/bitstreams/{job_id}.sg",
        "/jobs/{job_id}/events",
        "/jobs/{job_id}/links",
        "/jobs/{job_id}/preview.sg",
        "/jobs/{job_id}/rival.{kind}",
        "/jobs/{job_id}/stop",
        "/preview",
        "/livez",
        "/readyz",
        "/metrics",
    }


def test_unknown_paths_and_methods_are_problems(web: Service) -> None:
    assert_problem(web.client.get("/nowhere"), 404)
    assert_problem(web.client.get("/static/nothing.js"), 404)
    answer = web.client.put(f"/jobs/{GOOD_ID}")
    assert_problem(answer, 405)
    assert answer.headers["allow"] == "DELETE, GET, HEAD"
    assert web.client.put(f"/decode/{GOOD_ID}.png").headers["allow"] == "GET, HEAD"
    assert_problem(web.client.get("/encode"), 405)


@pytest.mark.parametrize(
    "job_id",
    [
        GOOD_ID,
        GOOD_ID.upper(),
        GOOD_ID[:-1],
        GOOD_ID + "0",
        GOOD_ID + "%0A",
        "..%2F..%2Fetc%2Fpasswd",
        "%00",
        "%FF",
    ],
)
def test_ids_that_lead_nowhere(web: Service, job_id: str) -> None:
    for path in (f"/jobs/{job_id}", f"/decode/{job_id}.png", f"/bitstreams/{job_id}.sg"):
        assert_problem(web.client.get(path), 404)
    assert_problem(web.client.delete(f"/jobs/{job_id}"), 404)


def test_a_waiting_job_has_a_place_and_no_picture_yet(empty: Service) -> None:
    web = empty
    first, second = web.accepted(), web.accepted()
    assert (web.job(first)["position"], web.job(second)["position"]) == (1, 2)
    job = web.job(second)
    assert (job["state"], job["progress"], job["trace"], job["attempt"]) == ("queued", 0, [], 0)
    for url in ("decode_url", "bitstream_url"):
        assert assert_problem(web.client.get(job[url]), 409)["state"] == "queued"
    assert web.client.delete(f"/jobs/{first}").status_code == 204
    assert web.job(second)["position"] == 1
    assert web.files() == [f"sources/{second}"]


def test_jobs_are_listed_newest_first_in_pages(empty: Service) -> None:
    web = empty
    assert web.client.get("/jobs").json() == {"jobs": [], "next": None}
    ids = [web.accepted() for _ in range(5)]
    seen, url = [], "/jobs?limit=2"
    while url:
        page = web.client.get(url).json()
        assert len(page["jobs"]) <= 2
        seen += [job["id"] for job in page["jobs"]]
        url = page["next"]
    assert seen == ids[::-1]
    for query in ("limit=0", "limit=201", "limit=x", "before=0", "before=" + "9" * 30):
        assert assert_problem(web.client.get(f"/jobs?{query}"), 422)["errors"]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"bpp": "1", "psnr": "30"}, "give one"),
        ({"bpp": "0"}, "positive"),
        ({"bpp": "-1"}, "positive"),
        ({"bpp": "nan"}, "must be a number"),
        ({"bpp": "inf"}, "must be a number"),
        ({"bpp": "1e999"}, "positive"),
        ({"bpp": "1_0"}, "must be a number"),
        ({"bpp": ""}, "must be a number"),
        ({"bpp": "٣"}, "must be a number"),
        ({"bytes": "10.5"}, "whole"),
        ({"gaussians": "0"}, "positive"),
        ({"psnr": "99"}, "at most 60"),
        ({"bpp": "1", "profile": "best"}, "unknown profile"),
        ({"bpp": "1", "tune": "best"}, "unknown tune"),
        ({"psnr": "30", "tune": "visual"}, "can only be tuned for psnr"),
        ({"bpp": "1", "profile": "paper", "tune": "visual"}, "can only be tuned for psnr"),
        ({"bpp": "1", "effort": "10"}, "effort must be a whole number from 1 to 9"),
        ({"bpp": "1", "effort": "5.5"}, "effort must be a whole number from 1 to 9"),
        ({"bpp": "1", "effort": "all"}, "effort must be a number"),
        ({"bpp": "1", "profile": "paper", "effort": "9"}, "only profile rd has an effort"),
        ({"bpp": "1", "time_limit_s": "0"}, "time_limit_s"),
        ({"bpp": "1", "time_limit_s": "1e9"}, "time_limit_s"),
        ({"bpp": "1", "time_limit_s": "soon"}, "time_limit_s"),
        ({"bpp": "1", "quality": "9"}, "give one"),
        ({"quality": "101"}, "at most 100"),
        ({"bpp": "1", "fineness": "9"}, "unknown field"),
        ({"bpp": "1", "priority": "first"}, "priority"),
    ],
)
def test_fields_that_are_refused(web: Service, fields: dict[str, str], words: str) -> None:
    before = web.files()
    assert_problem(web.post(SMALL, **fields), 422, words)
    assert web.files() == before


def test_a_tiny_image_without_a_budget_is_accepted(web: Service) -> None:
    """0.3 bits per pixel of it are fewer bytes than the smallest file has; asked for, they are refused."""
    tiny = png(16, 16)
    assert web.post(tiny).status_code == 202
    assert_problem(web.post(tiny, bpp="0.3"), 422, "at least 12 bytes")


def test_forms_that_are_refused(web: Service) -> None:
    post = web.client.post
    image = {"image": ("a.png", SMALL)}
    assert_problem(post("/encode?bpp=1", json={"bpp": 1}), 415, "multipart")
    assert_problem(post("/encode", content=b""), 415)
    assert_problem(post("/encode", data={"bpp": "1"}), 415)
    assert_problem(post("/encode", content=b"x", headers={"Content-Type": "multipart/form-data"}), 400)
    other = {"Content-Type": "multipart/form-data; boundary=b"}
    assert_problem(post("/encode", content=b"--c\r\n", headers=other), 400)
    assert_problem(post("/encode", files={"bpp": (None, "1")}), 422, "image is missing")
    assert_problem(post("/encode", files={"image": (None, "text"), "bpp": (None, "1")}), 422, "not a file")
    assert_problem(post("/encode", files={"image": ("a.png", SMALL), "bpp": ("b.txt", b"1")}), 400)
    assert_problem(post("/encode", files={"bpp": ("b.txt", b"1")}), 422, "image is missing")
    assert_problem(post("/encode", files=image, data={"bpp": ["1", "1"]}), 422, "twice")
    assert_problem(post("/encode", files=image, data={"bpp": "1" * 1000}), 400)
    key = {"Idempotency-Key": "with space"}
    assert_problem(post("/encode", files=image, data={"bpp": "1"}, headers=key), 400, "Idempotency-Key")


def test_an_image_as_the_body(web: Service) -> None:
    def post(query: str, **more: Any) -> httpx.Response:
        options = {"content": SMALL, "headers": {"Content-Type": "image/png"}, **more}
        return web.client.post(f"/encode{query}", **options)

    answer = post("?psnr=30&profile=paper&time_limit_s=2&priority=bulk")
    assert answer.status_code == 202, answer.text
    job = web.job(answer.json()["id"])
    assert (job["budget"], job["profile"]) == ({"kind": "psnr", "value": 30}, "paper")
    assert (job["time_limit_s"], job["priority"], job["tune"], job["effort"]) == (2, "bulk", "psnr", 5)
    unasked = web.job(post("?bpp=1").json()["id"])
    assert (unasked["tune"], unasked["effort"]) == ("visual", 5)
    assert web.job(post("?bpp=1&effort=7").json()["id"])["effort"] == 7
    assert web.job(post("?bpp=1&tune=psnr").json()["id"])["tune"] == "psnr"
    assert (web.data_dir / "sources" / job["id"]).read_bytes() == SMALL
    form = post("?bpp=1", content=None, headers={}, files={"image": ("a.png", SMALL)})
    assert web.job(form.json()["id"])["budget"] == {"kind": "bpp", "value": 1}

    before = web.files()
    assert_problem(post("?bpp=1&psnr=30"), 422, "give one")
    assert_problem(post("?bpp=1&bpp=1"), 422, "twice")
    assert_problem(post("?bpp=1", content=b""), 422, "empty")
    assert_problem(post("?bpp=1", content=SMALL[:30]), 422)
    assert_problem(post("?bpp=1", content=b"%PDF-1.7"), 415)
    assert_problem(post("?bpp=1", headers={"Content-Type": "text/plain"}), 415)
    assert_problem(post("?bpp=1", content=bytes(200_001)), 413)
    assert_problem(post("?bpp=1", content=iter([bytes(100_000)] * 3)), 413)
    form = post("?bpp=1", content=None, headers={}, files={"image": ("a.png", SMALL)}, data={"bpp": "1"})
    assert_problem(form, 422, "twice")
    assert web.files() == before


def test_priority(web: Service) -> None:
    assert web.job(web.accepted(SMALL, bpp=1))["priority"] == "interactive"
    assert web.job(web.accepted(SMALL, bpp=1, priority="bulk"))["priority"] == "bulk"


@pytest.mark.parametrize("image", [b"hello", b"GIF88a" + b"0" * 40, b"%PDF-1.7", b"<svg/>"])
def test_what_is_no_image_of_ours(web: Service, image: bytes) -> None:
    assert_problem(web.post(image), 415, "PNG")


def test_images_that_are_refused(web: Service) -> None:
    assert_problem(web.post(b""), 422, "empty")
    assert_problem(web.post(SMALL[:20]), 422)
    assert_problem(web.post(png_header(0, 10)), 422)
    assert_problem(web.post(png_header(2**31 - 1, 2**31 - 1)), 422, "too large")
    assert_problem(web.post(png_header(65_536, 1)), 422, "too large")
    assert_problem(web.post(png_header(1001, 1000)), 422, "too large")
    animation = io.BytesIO()
    frames = [Image.new("RGB", (8, 8), colour) for colour in ("red", "blue")]
    frames[0].save(animation, "PNG", save_all=True, append_images=frames[1:])
    assert_problem(web.post(animation.getvalue()), 422, "more than one")


@pytest.mark.parametrize("format_", ["PNG", "JPEG", "WebP", "TIFF", "BMP"])
def test_every_format_is_accepted(web: Service, format_: str) -> None:
    file = io.BytesIO()
    Image.open(io.BytesIO(SMALL)).save(file, format_)
    assert web.job(web.accepted(file.getvalue()))["image"]["format"] == format_


def test_an_encode_without_a_time_limit_gets_the_longest(web: Service) -> None:
    answer = web.client.post("/encode", files={"image": ("a.png", SMALL)}, data={"psnr": "30"})
    assert web.job(answer.json()["id"])["time_limit_s"] == 300


def test_the_users_file_name_goes_nowhere(web: Service) -> None:
    files = {"image": ("../../../escape.png", SMALL)}
    answer = web.client.post("/encode", files=files, data={"bpp": "1"})
    assert answer.status_code == 202
    assert f"sources/{answer.json()['id']}" in web.files()
    assert "escape" not in web.client.get(answer.json()["status_url"]).text


def test_image_larger_than_the_limit(web: Service) -> None:
    image = {"Content-Type": "image/png"}
    for size, status in ((200_000, 202), (200_001, 413)):
        answer = web.client.post("/encode?bpp=1", content=SMALL.ljust(size, b"\0"), headers=image)
        assert answer.status_code == status
    assert assert_problem(answer, 413)["max_bytes"] == 200_000
    assert_problem(web.post(SMALL.ljust(200_000, b"\0")), 413)


@given(
    name=st.sampled_from(
        ["bpp", "bytes", "looks", "psnr", "quality", "gaussians", "profile", "tune", "effort", "time_limit_s", "x"]
    ),
    value=st.text(max_size=20) | st.floats().map(str) | st.integers().map(str),
    image=st.binary(max_size=60) | st.binary(max_size=20).map(lambda junk: SMALL[:60] + junk),
)
def test_whatever_is_posted_gets_a_proper_answer(web: Service, name: str, value: str, image: bytes) -> None:
    try:
        answer = web.post(image, **{name: value})
    except UnicodeEncodeError:  # the client cannot send lone surrogates
        return
    if answer.status_code != 202:
        assert answer.status_code in (400, 415, 422)
        assert_problem(answer, answer.status_code)


def test_one_key_makes_one_job(web: Service) -> None:
    first = web.post(SMALL, key="once", bpp=1)
    again = web.post(SMALL, key="once", bpp=1)
    assert (first.status_code, again.status_code) == (202, 202)
    assert again.json() == first.json()
    assert again.headers["location"] == first.headers["location"]
    files = web.files()
    assert_problem(web.post(SMALL, key="once", bpp=2), 422, "Idempotency-Key")
    assert_problem(web.post(png(64, 48, seed=1), key="once", bpp=1), 422, "Idempotency-Key")
    assert web.files() == files


def test_full_queue(empty: Service) -> None:
    web = empty
    first = web.post(key="first")
    for _ in range(SMALL_QUEUE - 1):
        web.accepted()
    answer = web.post()
    assert_problem(answer, 429, "full")
    assert int(answer.headers["retry-after"]) > 0
    assert len(web.files()) == SMALL_QUEUE
    assert web.post(key="first").json() == first.json()
    assert_problem(web.post(key="new"), 429)
    assert web.client.delete(first.json()["status_url"]).status_code == 204
    assert web.post(key="new").status_code == 202


def test_full_queue_holds_when_many_post_at_once(empty: Service) -> None:
    web = empty
    with ThreadPoolExecutor(10) as clients:
        statuses = sorted(clients.map(lambda _: web.post().status_code, range(10)))
    assert statuses == [202] * SMALL_QUEUE + [429] * (10 - SMALL_QUEUE)
    assert len(web.files()) == SMALL_QUEUE
