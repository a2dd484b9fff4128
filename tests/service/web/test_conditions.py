"""What a client has already, and headers in several lines, as RFC 9110 has them."""

from __future__ import annotations

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
    ("known", "status"),
    [("{}", 304), ("W/{}", 304), ('"other", {}', 304), ("*", 304), ('"other"', 200), (",", 200)],
)
def test_what_a_client_has_already(web: Service, done: str, known: str, status: int) -> None:
    """RFC 9110, 13.1.2: tags compare weakly."""
    for url in (f"/bitstreams/{done}.sg", f"/decode/{done}.png"):
        etag = web.client.head(url).headers["etag"]
        for method in ("GET", "HEAD"):
            answer = web.client.request(method, url, headers={"If-None-Match": known.format(etag)})
            assert answer.status_code == status
            assert answer.headers["etag"] == etag


def test_lines_of_one_header_are_one_list(web: Service, done: str) -> None:
    """RFC 9110, 5.3: several lines are one with commas, and where one value alone is allowed they are none."""
    url = f"/bitstreams/{done}.sg"
    etag = web.client.head(url).headers["etag"]

    def status(*lines: tuple[str, str], path: str = url) -> int:
        return web.client.get(path, headers=list(lines)).status_code

    assert status(("If-None-Match", '"other"'), ("If-None-Match", etag)) == 304
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
