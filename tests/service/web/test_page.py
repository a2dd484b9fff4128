"""The page, in a real browser, against a real service."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.keys import digest
from tests.harness.browser import Browser
from tests.harness.data import golden_path
from tests.harness.pictures import SMALL
from tests.harness.processes import wait_until
from tests.harness.service import Service, StartService

PICTURE = golden_path("v3-color.sg").read_bytes()


@pytest.fixture
def page(browser: Browser) -> Iterator[Browser]:
    """The browser, which has nothing to complain of yet, and is elsewhere afterwards."""
    browser.complaints()
    yield browser
    browser.open("about:blank")


def choose(page: Browser, folder: Path, image: bytes) -> None:
    file = folder / f"picture-of-{len(image)}-bytes.png"
    file.write_bytes(image)
    page.type("#file", str(file))


def width(page: Browser, picture: str) -> int:
    """Of a picture as it was loaded, in pixels; 0 for one that is not to be seen."""
    if not page.is_seen(f"#{picture}"):
        return 0
    return int(page.run(f"return document.getElementById('{picture}').naturalWidth"))


def says(page: Browser, words: str) -> None:
    wait_until(lambda: words in page.text("#status"))


def test_from_a_photograph_to_its_gaussians(page: Browser, service: Service, tmp_path: Path) -> None:
    page.open(f"{service.url}/")
    assert [page.is_seen(part) for part in ("#work", "#key", "#cancel", "#original", "#decoded")] == [False] * 5
    choose(page, tmp_path, SMALL)
    wait_until(lambda: width(page, "original") == 64)
    page.click("#encode")
    says(page, "Gaussians")
    wait_until(lambda: width(page, "decoded") == 64)
    assert page.is_seen("#curve")
    assert not page.is_seen("#cancel")
    (job,) = service.client.get("/jobs").json()["jobs"]
    assert f"{job['result']['gaussians']} Gaussians" in page.text("#status")
    download = page.run("const { href, download } = document.getElementById('download'); return [href, download]")
    assert download == [f"blob:{service.url}/{download[0].rpartition('/')[2]}", f"{job['id']}.sg"]
    page.open("about:blank")
    page.open(f"{service.url}/#{job['id']}")  # as it stands in the address when the page is loaded again
    wait_until(lambda: width(page, "decoded") == 64)
    assert page.complaints() == []


def test_requests_for_people(page: Browser, web: Service) -> None:
    """Under the strict policy, and from nowhere else."""
    document = web.client.get("/openapi.json").json()
    operations = {what["operationId"]: what for methods in document["paths"].values() for what in methods.values()}
    page.open(f"{web.url}/docs")
    shown = "return document.querySelectorAll('#operations details').length"
    wait_until(lambda: page.run(shown) > len(operations))  # and examples after them
    for name, operation in operations.items():
        assert operation["summary"] in page.text(f"#{name} summary")
    first = next(iter(operations))
    assert not page.is_seen(f"#{first} pre")
    page.click(f"#{first} summary")
    assert f"curl {web.url}/livez" in page.text(f"#{first} pre")
    assert "200" in page.text(f"#{first} table")
    assert page.complaints() == []


def test_what_is_refused(page: Browser, web: Service, tmp_path: Path) -> None:
    page.open(f"{web.url}/")
    choose(page, tmp_path, b"this is no picture")
    page.click("#encode")
    says(page, "not a PNG")
    assert [page.is_seen(part) for part in ("#progress", "#curve", "#cancel", "#original")] == [False] * 4
    (complaint,) = page.complaints()
    assert "415" in complaint
    choose(page, tmp_path, SMALL)
    assert not page.is_seen("#status")
    page.click("#encode")
    says(page, "in the queue")


def test_a_job_that_is_cancelled(page: Browser, web: Service, tmp_path: Path) -> None:
    page.open(f"{web.url}/")
    choose(page, tmp_path, SMALL)
    page.click("#encode")
    says(page, "in the queue")
    page.click("#cancel")
    says(page, "removed")
    assert not page.is_seen("#cancel")
    (complaint,) = page.complaints()
    assert "404" in complaint


def test_with_a_key(page: Browser, start_service: StartService, tmp_path: Path) -> None:
    web = start_service("web", api_keys=f"ann:{digest('secret')}")
    page.open(f"{web.url}/")
    choose(page, tmp_path, SMALL)
    page.click("#encode")
    says(page, "needs an API key")
    page.type("#key", "wrong")
    page.click("#encode")
    says(page, "not known")
    assert all("401" in complaint for complaint in page.complaints())
    page.run("document.getElementById('key').value = ''")
    page.type("#key", "secret")
    page.click("#encode")
    says(page, "in the queue")
    page.open("about:blank")
    page.open(f"{web.url}/#{web.published(PICTURE, 'ann')}")  # the key is remembered until the window is closed
    wait_until(lambda: width(page, "decoded") == 48)


def test_a_service_that_restarts_meanwhile(page: Browser, start_service: StartService, tmp_path: Path) -> None:
    service = start_service("web")
    page.open(f"{service.url}/")
    choose(page, tmp_path, SMALL)
    page.click("#encode")
    says(page, "in the queue")
    service.environment["SG_PORT"] = service.url.rpartition(":")[2]
    assert service.stop() == 0
    says(page, "trying again")
    service.start()
    says(page, "in the queue")
    assert all("ERR_" in complaint or "Failed to load" in complaint for complaint in page.complaints())
