"""The page, in a real browser, against a real service: giving pictures, watching, taking away, trouble."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest

import sgmethod
from service.keys import digest
from tests.harness.browser import Chromium
from tests.harness.data import DATA, golden_path
from tests.harness.pictures import SLOW, SMALL
from tests.harness.processes import encoder_of, wait_until
from tests.harness.service import Service, StartService
from tests.service.page.steps import COFFEE, COFFEE_SAYS, OTHER, complaints, give, hold_back, open_page, says

SNIPPET_BYTES = 200_000
AXE = (DATA / "axe.min.js").read_text()


def test_a_photograph_that_is_dropped(page: Chromium, service: Service) -> None:
    open_page(page, service)
    page.run("document.getElementById('effort').value = '1'")
    give(page, "drop", SMALL, "my disc.png")
    says(page, "Gaussians", "#right-label")
    assert page.text("#left-label").startswith("Original")
    wait_until(lambda: "WebP" in page.text("#rivals"))
    (job,) = service.client.get("/jobs").json()["jobs"]
    assert f"{job['result']['gaussians']} Gaussians" in page.text("#figures")
    assert (job["tune"], job["effort"]) == ("visual", 1)
    assert page.run("return location.hash") == f"#{job['id']}"
    assert not page.is_seen("#work")
    lines = page.run("return [...document.querySelectorAll('pre')].map((one) => one.textContent)")
    assert "-F image=@my_disc.png -F bpp=0.3" in lines[0]
    assert "-F effort=1" in lines[0]
    assert 'sgmethod.encode("my_disc.png", bpp=0.3' in lines[1]
    page.open("about:blank")
    page.open(f"{service.url}/#{job['id']}")  # as it stands in the address when the page is loaded again
    says(page, "Gaussians", "#right-label")
    says(page, "Original", "#left-label")  # the browser has kept it
    assert complaints(page) == []


@pytest.mark.thorough
@pytest.mark.parametrize("way", ["paste", "sample"])
def test_one_that_is_pasted_and_a_sample(page: Chromium, service: Service, way: str) -> None:
    open_page(page, service)
    if way == "paste":
        give(page, "paste", SMALL, "pasted.png")
    else:
        assert page.text("#again") == "Encode this one"
        page.click("#again")
    wait_until(lambda: len(page.run("return location.hash")) == len("#") + 32)
    place = page.run("return `/jobs/${location.hash.slice(1)}`")
    wait_until(lambda: service.client.get(place).json()["state"] == "done")
    says(page, f"{service.client.get(place).json()['result']['gaussians']:,} Gaussians", "#figures")
    assert page.text("#left-label").startswith("Original")
    assert complaints(page) == []


@pytest.mark.thorough
def test_one_that_is_loaded_again_stopped_and_kept(page: Chromium, service: Service) -> None:
    """Loaded again in the middle: the address has the job, the browser its original."""
    open_page(page, service)
    give(page, "drop", SLOW, "slow.png")
    wait_until(lambda: page.is_seen("#stop"))
    address = page.run("return location.href")
    place = f"/jobs/{address.rpartition('#')[2]}"
    encoder = encoder_of(place.rpartition("/")[2])
    assert encoder
    os.kill(encoder, signal.SIGSTOP)  # so that it is not done before the page is back
    try:
        page.open("about:blank")
        page.open(address)
        wait_until(lambda: page.is_seen("#stop"))
        says(page, "Original", "#left-label")
        page.click("#stop")
    finally:
        os.kill(encoder, signal.SIGCONT)
    says(page, "Gaussians", "#right-label")
    assert not page.is_seen("#work")
    job = service.client.get(place).json()
    assert job["state"] == "done"
    assert f"{job['result']['gaussians']:,} Gaussians" in page.text("#figures")
    assert complaints(page) == []


@pytest.mark.thorough
def test_going_back(page: Chromium, web: Service) -> None:
    open_page(page, web)
    page.click("#sample-cat")
    says(page, "5.4 kB", "#right-label")
    give(page, "drop", OTHER, "other.sg")
    says(page, "40 × 56 pixels", "#figures")
    page.run("history.back()")
    says(page, "5.4 kB", "#right-label")
    page.run("history.back()")
    says(page, "4.7 kB", "#right-label")
    page.run("history.go(2)")
    says(page, "40 × 56 pixels", "#figures")


@pytest.mark.thorough
def test_going_back_while_what_is_shown_still_changes(page: Chromium, web: Service) -> None:
    """The address is another one before the page is told of it. What then becomes new must not take it back."""
    open_page(page, web)
    first = page.run("return location.hash")
    page.click("#sample-cat")
    says(page, "5.4 kB", "#right-label")
    page.run(f"location.hash = '{first}'; document.querySelector('#rows [aria-pressed=true]').click()")
    says(page, "4.7 kB", "#right-label")
    assert page.run("return location.hash") == first


@pytest.mark.thorough
def test_one_that_is_given_while_a_sample_still_loads(page: Chromium, web: Service) -> None:
    """What comes last is shown, not what ends last."""
    open_page(page, web)
    hold_back(page, "cat.webp")
    page.click("#sample-cat")
    says(page, "5.4 kB", "#right-label")
    give(page, "drop", OTHER, "other.sg")
    says(page, "40 × 56 pixels", "#figures")
    page.run("window.goOn()")
    original = f"{web.url}/static/samples/cat.webp"
    wait_until(lambda: page.run(f"return performance.getEntriesByName('{original}').length"))
    page.run("return new Promise((done) => setTimeout(done, 300))")
    assert "40 × 56 pixels" in page.text("#figures")


@pytest.mark.thorough
def test_files_are_known_by_their_first_bytes(page: Chromium, web: Service) -> None:
    open_page(page, web)
    beginnings = {
        **{
            "PNG": "\x89PNG\r\n",
            "JPEG": "\xff\xd8\xff\xe0",
            "GIF": "GIF89a",
            "WebP": "RIFF....WEBPVP8 ",
            "BMP": "BM..",
        },
        **{"AVIF": "\0\0\0\x1cftypavif....", "HEIC": "\0\0\0\x18ftypmif1....heic", "QOI": "qoif", "PPM": "P6\n1 1"},
        **{"JPEG XL": "\xff\n....", "TIFF": "II*\0....", "": "something else"},
    }
    found = page.run(f"""
        return (async () => {{
            const {{ kindOf }} = await import("/static/kinds.js");
            const bytes = (text) => Uint8Array.from(text, (letter) => letter.charCodeAt(0));
            const kinds = {json.dumps(list(beginnings.values()))}.map((text) => kindOf(new File([bytes(text)], "a.b")));
            return (await Promise.all(kinds)).map(({{ kind, format }}) => [kind, format ?? ""]);
        }})();
    """)
    assert found == [["image", name] for name in beginnings]


@pytest.mark.thorough
def test_one_that_is_pasted_and_cancelled(page: Chromium, web: Service) -> None:
    open_page(page, web)
    give(page, "paste", SMALL, "pasted.png")
    says(page, "in the queue")
    place = page.run("return `/jobs/${location.hash.slice(1)}`")
    assert web.client.get(place).json()["state"] == "queued"
    page.click("#cancel")
    says(page, "Cancelled", "#work")
    assert page.run("return document.getElementById('work').className") == "card"
    assert not page.is_seen("#cancel")
    wait_until(lambda: web.client.get(place).status_code == 404)  # it is said before the service knows


@pytest.mark.thorough
def test_two_tabs(page: Chromium, web: Service) -> None:
    """Each has its own picture and its own job; what one removes the other learns of."""
    open_page(page, web)
    give(page, "drop", SMALL, "one.png")
    says(page, "in the queue")
    first, address = page.tab(), page.run("return location.href")
    second = page.new_tab()
    page.switch_to(second)
    try:
        open_page(page, web)
        page.run("document.getElementById('tune').value = 'psnr'")
        page.run("document.getElementById('tune').dispatchEvent(new Event('change', { bubbles: true }))")
        give(page, "drop", SMALL, "two.png")
        says(page, " before it")
        assert page.run("return location.href") != address
        page.switch_to(first)
        assert page.run("return [location.href, document.getElementById('tune').value]") == [address, "visual"]
        assert [job["tune"] for job in web.client.get("/jobs").json()["jobs"]] == ["psnr", "visual"]
        page.switch_to(second)
        page.open("about:blank")
        page.open(address)  # the same job in both
        says(page, "in the queue")
        says(page, "Original", "#left-label")
        page.click("#cancel")
        says(page, "Cancelled", "#work")
        page.switch_to(first)
        says(page, "has deleted it")
        assert len(web.client.get("/jobs").json()["jobs"]) == 1
    finally:
        page.switch_to(second)
        page.run("localStorage.clear()")
        page.close_tab()
        page.switch_to(first)


def test_files_of_gaussians_are_opened(page: Chromium, web: Service) -> None:
    open_page(page, web)
    give(page, "drop", COFFEE, "my coffee.sg")
    says(page, COFFEE_SAYS, "#figures")
    assert page.run("return performance.getEntriesByName(location.origin + '/decode.png?').length") == 0
    give(page, "drop", OTHER, "other.sg")
    says(page, "Drawn by the service", "#note")
    says(page, "40 × 56 pixels", "#figures")
    page.click("#rows li:first-child .pick")
    says(page, COFFEE_SAYS, "#figures")
    give(page, "drop", COFFEE[:-1], "cut.sg")
    says(page, "the file is damaged")
    assert complaints(page) == []


@pytest.mark.thorough
def test_what_is_refused(page: Chromium, web: Service) -> None:
    open_page(page, web)
    give(page, "drop", b"%PDF-1.7", "text.pdf")
    says(page, "text.pdf is a PDF", "#trouble")
    assert complaints(page) == []
    give(page, "drop", b"this is no picture", "words.png")
    says(page, "not a PNG")
    assert [page.is_seen(part) for part in ("#progress", "#chart", "#cancel")] == [False] * 3
    (complaint,) = complaints(page)
    assert "415" in complaint
    page.type("#file", str(golden_path("v1-paper.png")))
    says(page, "in the queue")


@pytest.mark.thorough
def test_with_a_key(page: Chromium, start_service: StartService) -> None:
    web = start_service("web", api_keys=f"ann:{digest('secret')}")
    open_page(page, web)
    give(page, "drop", SMALL, "disc.png")
    says(page, "needs an API key")
    page.type("#key", "wrong")
    page.click("#again")
    says(page, "Unknown API key")
    assert all("401" in complaint for complaint in complaints(page))
    page.run("document.getElementById('key').value = ''")
    page.type("#key", "secret")
    page.click("#again")
    says(page, "in the queue")
    page.open("about:blank")
    page.open(f"{web.url}/#{web.published(COFFEE, 'ann')}")  # the key is remembered until the window is closed
    says(page, COFFEE_SAYS, "#figures")


@pytest.mark.thorough
def test_a_service_that_restarts_meanwhile(page: Chromium, start_service: StartService) -> None:
    service = start_service("web")
    open_page(page, service)
    give(page, "drop", SMALL, "disc.png")
    says(page, "in the queue")
    service.environment["SG_PORT"] = service.url.rpartition(":")[2]
    assert service.stop() == 0
    says(page, "trying again")
    service.start()
    says(page, "in the queue")
    assert all("ERR_" in complaint or "Failed to load" in complaint for complaint in complaints(page))


def test_nobody_is_left_out(page: Chromium, web: Service) -> None:
    open_page(page, web)
    says(page, "AVIF", "#verdict")
    page.run("for (const one of document.querySelectorAll('details')) one.open = true")
    page.run(AXE)
    for scheme in ("light", "dark"):
        page.prefer(scheme)
        passed, findings = page.run("""
            return axe.run().then(({ passes, violations }) => [
                passes.length, violations.map(({ id, nodes }) => [id, ...nodes.map(({ target }) => target.join(" "))])
            ]);
        """)
        assert passed > 20
        assert findings == []


@pytest.mark.thorough
def test_requests_for_people(page: Chromium, web: Service) -> None:
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
    assert f"'{web.url}/encode?wait=50'" in page.text(f"#{first} pre")
    assert "202" in page.text(f"#{first} table:last-of-type")
    assert page.complaints() == []


@pytest.mark.thorough
def test_html_that_shows_a_picture(page: Chromium, web: Service, tmp_path: Path) -> None:
    open_page(page, web)
    html = page.run("""
        return (async () => {
            const { snippetOf } = await import("/static/snippet.js");
            const sg = new Uint8Array(await (await fetch("/static/samples/coffee.sg")).arrayBuffer());
            return snippetOf({ sg, size: [432, 288], name: 'my "cup" & <b>.webp' });
        })();
    """)
    assert len(html) < SNIPPET_BYTES
    alone = tmp_path / "alone.html"
    alone.write_text(html)
    page.complaints()
    page.tell("Emulation.setDeviceMetricsOverride", width=300, height=600, deviceScaleFactor=1, mobile=False)
    page.open(alone.as_uri())
    pixel = "return [...document.querySelector('canvas').getContext('2d').getImageData(200, 100, 1, 1).data]"
    wait_until(lambda: page.run(pixel)[3] == 255)
    assert np.abs(np.array(page.run(pixel)[:3]) - sgmethod.decode(COFFEE)[100, 200]).max() <= 1
    assert page.run("return document.querySelector('canvas').getAttribute('aria-label')") == 'my "cup" & <b>'
    width, height, scrolled = page.run("""
        const { width, height } = document.querySelector("canvas").getBoundingClientRect();
        return [width, height, document.documentElement.scrollWidth];
    """)
    assert scrolled <= 300
    assert width / height == pytest.approx(1.5, rel=0.01)
    assert complaints(page) == []
