"""Parts of files, conditions on requests, and headers in several lines, as RFC 9110 has them."""

from __future__ import annotations

import re

import pytest

from service.keys import digest
from tests.harness.data import golden_path
from tests.harness.pictures import SMALL
from tests.harness.service import Service, StartService, assert_problem

pytestmark = pytest.mark.thorough

PICTURE = golden_path("v2-color.sg").read_bytes()


@pytest.fixture(scope="module")
def done(web: Service) -> str:
    """The id of a job that is done."""
    return web.published(PICTURE)


@pytest.mark.parametrize(
    ("asked", "part"),
    [
        ("bytes=0-3", slice(0, 4)),
        ("bytes=4-", slice(4, None)),
        ("bytes=-5", slice(-5, None)),
        ("bytes=-99999", slice(None)),
        ("bytes=10-99999", slice(10, None)),
        ("bytes = 1 - 2", slice(1, 3)),
        ("Bytes=0-3", slice(0, 4)),
    ],
)
@pytest.mark.parametrize("path", ["/bitstreams/{}.sg", "/decode/{}.png"])
def test_parts_of_files(web: Service, done: str, path: str, asked: str, part: slice) -> None:
    url = path.format(done)
    whole = web.client.get(url)
    assert whole.headers["accept-ranges"] == "bytes"
    answer = web.client.get(url, headers={"Range": asked})
    assert answer.status_code == 206
    assert answer.content == whole.content[part]
    first, last, size = map(int, re.fullmatch(r"bytes (\d+)-(\d+)/(\d+)", answer.headers["content-range"]).groups())  # type: ignore[union-attr]
    assert whole.content[first : last + 1] == answer.content
    assert size == len(whole.content)
    assert answer.headers["etag"] == whole.headers["etag"]


@pytest.mark.parametrize("asked", ["bytes=5-2", "bytes=-", "bytes=a-b", "lines=1-2", "bytes=0-1,3-4", "bytes=²-3"])
def test_ranges_that_are_none_are_ignored(web: Service, done: str, asked: str) -> None:
    answer = web.client.get(f"/bitstreams/{done}.sg", headers={"Range": asked.encode()})
    assert (answer.status_code, answer.content) == (200, PICTURE)


def test_ranges_beyond_the_file_or_of_another_version(web: Service, done: str) -> None:
    url = f"/bitstreams/{done}.sg"
    for asked in (f"bytes={len(PICTURE)}-", "bytes=-0"):
        answer = web.client.get(url, headers={"Range": asked})
        assert_problem(answer, 416)
        assert answer.headers["content-range"] == f"bytes */{len(PICTURE)}"
    assert web.client.get(url, headers={"Range": "bytes=0-3", "If-Range": '"other"'}).status_code == 200
    etag = web.client.head(url).headers["etag"]
    assert web.client.get(url, headers={"Range": "bytes=0-3", "If-Range": etag}).status_code == 206


@pytest.mark.parametrize("path", ["/bitstreams/{}.sg", "/decode/{}.png", "/", "/static/page/main.js"])
def test_a_range_is_of_get_alone(web: Service, done: str, path: str) -> None:
    """RFC 9110, 14.2."""
    url = path.format(done)
    head = web.client.head(url, headers={"Range": "bytes=0-9"})
    assert (head.status_code, head.headers["content-length"]) == (200, str(len(web.client.get(url).content)))
    assert "content-range" not in head.headers
    assert web.client.get(url, headers={"Range": "bytes=0-9"}).status_code == 206


def test_conditions(web: Service, done: str) -> None:
    """RFC 9110, 13.1: If-Match compares strongly, If-None-Match weakly; a range counts where conditions hold."""
    for url in (f"/bitstreams/{done}.sg", f"/decode/{done}.png"):
        etag = web.client.head(url).headers["etag"]
        for name, text, status in (
            ("If-Match", etag, 200),
            ("If-Match", f'"other", {etag}', 200),
            ("If-Match", "*", 200),
            ("If-Match", '"other"', 412),
            ("If-Match", f"W/{etag}", 412),
            ("If-None-Match", f"W/{etag}", 304),
            ("If-None-Match", ",", 200),
            ("If-Modified-Since", "Sat, 01 Jan 2050 00:00:00 GMT", 200),
            ("If-Unmodified-Since", "Sat, 01 Jan 2000 00:00:00 GMT", 200),
        ):
            for method in ("GET", "HEAD"):
                answer = web.client.request(method, url, headers={name: text})
                assert answer.status_code == status, (method, name, text)
        part = {"Range": "bytes=0-3"}
        assert web.client.get(url, headers={**part, "If-Match": '"other"'}).status_code == 412
        assert web.client.get(url, headers={**part, "If-None-Match": etag}).status_code == 304
        assert web.client.get(url, headers={**part, "If-Match": etag}).status_code == 206
        assert web.client.get(url, headers={**part, "If-Range": f"W/{etag}"}).status_code == 200
        assert web.client.get(url, headers={**part, "If-Range": "Sat, 01 Jan 2050 00:00:00 GMT"}).status_code == 200
        assert web.client.get(url, headers={"If-Range": '"other"'}).status_code == 200


def test_a_condition_keeps_a_job(web: Service) -> None:
    job = f"/jobs/{web.accepted()}"
    for name, text in (("If-Match", '"other"'), ("If-None-Match", "*")):
        assert_problem(web.client.delete(job, headers={name: text}), 412, "condition")
    assert web.client.delete(job, headers={"If-Match": "*"}).status_code == 204
    assert_problem(web.client.delete(job, headers={"If-Match": '"other"'}), 404)


def test_lines_of_one_header_are_one_list(web: Service, done: str) -> None:
    """RFC 9110, 5.3: several lines are one with commas, and where one value alone is allowed they are none."""
    url = f"/bitstreams/{done}.sg"
    etag = web.client.head(url).headers["etag"]

    def status(*lines: tuple[str, str], path: str = url) -> int:
        return web.client.get(path, headers=list(lines)).status_code

    assert status(("If-None-Match", '"other"'), ("If-None-Match", etag)) == 304
    assert status(("If-Match", '"other"'), ("If-Match", etag)) == 200
    assert status(("Range", "bytes=0-1"), ("Range", "bytes=2-3")) == 200
    assert status(("Range", "bytes=0-1"), ("If-Range", etag), ("If-Range", etag)) == 200
    picture = web.client.get(f"/decode/{done}", headers=[("Accept", "text/html"), ("Accept", "image/webp")])
    assert picture.headers["content-type"] == "image/webp"
    assert status(("Accept", ""), path=f"/decode/{done}") == 200
    keys = [("Content-Type", "image/png"), ("Idempotency-Key", "one"), ("Idempotency-Key", "two")]
    assert_problem(web.client.post("/encode", content=SMALL, headers=keys), 400, "Idempotency-Key")
    types = [("Content-Type", "image/png"), ("Content-Type", "multipart/form-data; boundary=B")]
    assert_problem(web.client.post("/encode", content=SMALL, headers=types), 415, "one Content-Type")


def test_two_keys_are_none(start_service: StartService) -> None:
    web = start_service("web", api_keys=f"ann:{digest('k')}")
    key = ("Authorization", "Bearer k")
    assert web.client.get("/jobs", headers=[key]).status_code == 200
    for other in (key, ("Authorization", "Basic eDp5")):
        assert_problem(web.client.get("/jobs", headers=[key, other]), 401)
