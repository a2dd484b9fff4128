"""The page, in a real browser, against a real service: uploads, progress, downloads, trouble."""

from __future__ import annotations

import json
import time
from dataclasses import asdict

import numpy as np
import pytest

from service.keys import digest
from sgmethod.budget import DEFAULT_BUDGET
from sgmethod.metrics.visual import quality_word
from tests.javascript.site import served
from tests.service.page.steps import COFFEE, COFFEE_SAYS, OTHER
from tests.support.browser import Chromium, Page, assert_open_to_all
from tests.support.data import PHOTOGRAPHS, STATIC
from tests.support.node import assert_as_python
from tests.support.pictures import SLOW, SMALL
from tests.support.processes import wait_until
from tests.support.service import Service, StartService


@pytest.mark.thorough
def test_the_bar_of_a_waiting_job_is_empty(firefox: Page) -> None:
    """Firefox fills a bar without a value."""
    with served(STATIC) as site:
        colours = firefox.run(f"""
            document.body.innerHTML = "<progress></progress><progress value=0.5></progress>";
            const sheet = document.createElement("link");
            Object.assign(sheet, {{ rel: "stylesheet", href: "{site.url}style.css" }});
            document.head.append(sheet);
            const bar = (one) => getComputedStyle(one, "::-moz-progress-bar").backgroundColor;
            const bars = () => [...document.querySelectorAll("progress")].map(bar);
            return new Promise((done) => sheet.addEventListener("load", () => done(bars())));
        """)
    assert colours[0] == "rgba(0, 0, 0, 0)" != colours[1]


def test_from_picture_to_file_and_back(each_browser: Page, service: Service) -> None:
    """A picture dropped, encoded, compared, enlarged, loaded again; a file opened and decoded; and back."""
    page = each_browser
    page.open_page(service)
    page.run("document.getElementById('effort').value = '1'")
    page.give("drop", SMALL, "my disc.png")
    page.says("my disc.png is done", "#announcement")
    page.says("Gaussians", "#right-label")
    assert page.text("#left-label").startswith("Original")
    wait_until(lambda: "WebP" in page.text("#others"))
    (job,) = service.client.get("/jobs").json()["jobs"]
    page.says(f"all {job['result']['gaussians']} Gaussians", "#prefix-words")
    assert (job["tune"], job["effort"]) == ("visual", 1)
    assert page.run("return location.hash") == f"#{job['id']}"
    assert not page.is_seen("#work")
    lines = page.run("return [...document.querySelectorAll('pre')].map((one) => one.textContent)")
    assert "-F image=@my_disc.png -F effort=1 '" in lines[0]  # no budget was sent
    assert 'sgmethod.encode("my_disc.png", effort=1).save(' in lines[1]
    assert job["budget"] == asdict(DEFAULT_BUDGET)
    score = job["result"]["ssimulacra2"]
    assert f"bits per pixel, SSIMULACRA 2 {score:.0f} ({quality_word(score)}), " in page.text("#outcome")
    both = page.settled()
    page.press("divider", "Home")
    wait_until(lambda: not np.array_equal(page.settled(), both))
    page.click("#zoom-in")
    assert page.text("#zoom").endswith("%")
    page.open("about:blank")
    page.open(f"{service.url}/#{job['id']}")  # as it stands in the address when the page is loaded again
    page.says("Gaussians", "#right-label")
    page.says("Original", "#left-label")  # the browser has kept it
    assert page.run("return document.getElementById('python').textContent") == lines[1]
    page.give("drop", COFFEE, "coffee.sg")
    page.says(COFFEE_SAYS, "#prefix-words")
    assert_as_python(page.decoded(COFFEE), COFFEE)
    assert page.run("return performance.getEntriesByName(location.origin + '/decode.png').length") == 0
    page.click("#rows li:first-child .pick")
    page.says("my disc.png", "#rows")
    page.give("drop", COFFEE[:-1], "cut.sg")
    page.says("the file is damaged")
    assert page.complaints() == []
    service.clear()


@pytest.mark.thorough
def test_what_the_slider_asks_for(page: Chromium, web: Service) -> None:
    """Nothing until it is moved, so that the service's default counts, which the page describes."""

    def asked() -> dict[str, object]:
        budget = web.job(page.queued(SMALL, "disc.png"))["budget"]
        page.cancel()
        return {budget["kind"]: budget["value"]}

    page.open_page(web)
    try:
        usual = page.imported("upload.js", "it.USUAL")
        assert usual == {"quality": DEFAULT_BUDGET.value, "max_bpp": DEFAULT_BUDGET.max_bpp}
        assert page.text("#rate") == f"about {DEFAULT_BUDGET.value:g} of 100"
        words = f"{quality_word(DEFAULT_BUDGET.value)}, in as few bytes as that takes, at most {usual['max_bpp']} bits"
        assert words in page.text("#rate-words")
        assert asked() == {"quality": DEFAULT_BUDGET.value}
        page.choose("aim", "size")
        page.says("at most 100 B", "#rate")
        assert asked() == {"bytes": 100}  # a quarter bit for each pixel would be 96
        page.choose("aim", "quality")
        page.choose("slider", "75")
        assert (page.text("#rate"), "at most" in page.text("#rate-words")) == ("about 73 of 100", False)
        assert asked() == {"quality": 73}
        words = [page.imported("words.js", f"it.qualityWord({score})") for score in (-9, 29, 30, 55, 70, 89.9, 90, 100)]
        assert words == [quality_word(score) for score in (-9, 29, 30, 55, 70, 89.9, 90, 100)]
    finally:
        page.run("localStorage.clear()")


@pytest.mark.thorough
@pytest.mark.parametrize("way", ["paste", "sample"])
def test_one_that_is_pasted_and_a_sample(page: Chromium, service: Service, way: str) -> None:
    page.open_page(service)
    page.run("document.getElementById('effort').value = '1'")
    if way == "paste":
        page.give("paste", SMALL, "pasted.png")
    else:
        assert page.text("#again") == "Encode this sample again"
        page.click("#again")
    job_id = wait_until(lambda: len(job := page.run("return location.hash.slice(1)")) == 32 and job)
    page.says(f"{service.wait(job_id)['result']['gaussians']:,} Gaussians", "#prefix-words")
    assert page.text("#left-label").startswith("Original")
    assert page.complaints() == []


@pytest.mark.thorough
def test_one_that_is_loaded_again(page: Chromium, service: Service) -> None:
    """In the middle: the address has the job, the browser its original."""
    page.open_page(service)
    page.give("drop", SLOW, "slow.png")
    page.says("Fitting")
    address = page.run("return location.href")
    wait_until(lambda: page.imported("storage.js", "it.kept(location.hash.slice(1)).then(Boolean)"))
    page.open("about:blank")
    page.open(address)
    page.says("Fitting")
    page.says("Original", "#left-label")
    page.cancel()
    assert page.complaints() == []


@pytest.mark.thorough
def test_what_comes_last_is_shown(page: Chromium, web: Service) -> None:
    """Given, chosen, or returned to, whatever ends last."""
    page.open_page(web)
    first = page.run("return location.hash")
    page.click("#figures-field summary")
    page.hold_back("cat.webp")
    page.click("#sample-cat")
    page.says("5.4 kB", "#right-label")
    page.give("drop", OTHER, "other.sg")
    page.says("40 × 56 pixels", "#figures")
    page.run("window.goOn()")
    original = f"{web.url}/static/samples/cat.webp"
    wait_until(lambda: page.run(f"return performance.getEntriesByName('{original}').length"))
    page.run("return new Promise((done) => setTimeout(done, 300))")
    assert "40 × 56 pixels" in page.text("#figures")
    for step, words, where in ((-1, "5.4 kB", "#right-label"), (-1, "9.0 kB", "#right-label"), (2, "40 ×", "#figures")):
        page.run(f"history.go({step})")
        page.says(words, where)
    # The address is another one before the page learns of it. What then becomes new must not take it back.
    page.run(f"location.hash = '{first}'; document.querySelector('#rows [aria-pressed=true]').click()")
    page.says("9.0 kB", "#right-label")
    assert page.run("return location.hash") == first


@pytest.mark.thorough
def test_one_that_is_cancelled(page: Chromium, web: Service) -> None:
    """In the queue, while an answer about it is on its way, and while it is sent."""
    page.open_page(web)
    job_id = page.queued(SMALL, "pasted.png", "paste")
    assert web.job(job_id)["state"] == "queued"
    page.hold_back(f"/jobs/{job_id}")
    time.sleep(1)  # more than a poll
    page.cancel()
    assert page.run("return document.getElementById('work').className") == "card"
    assert not page.is_seen("#cancel")
    wait_until(lambda: web.client.get(f"/jobs/{job_id}").status_code == 404)  # the page says so first
    page.run("window.goOn()")
    time.sleep(1)
    assert page.complaints() == []

    page.hold_back("/encode")
    before = web.client.get("/jobs").json()
    sent = "return performance.getEntriesByName(location.origin + '/encode').length"
    sent_before = page.run(sent)
    page.give("drop", SMALL, "one.png")
    page.says("Sending")
    page.cancel()
    page.run("window.goOn()")
    wait_until(lambda: page.run(sent) > sent_before)
    wait_until(lambda: web.client.get("/jobs").json() == before)
    page.says("Cancelled", "#work")


@pytest.mark.thorough
def test_files_are_known_by_their_first_bytes(page: Chromium, web: Service) -> None:
    page.open_blank(web)
    beginnings = {
        **{"PNG": "\x89PNG\r\n", "JPEG": "\xff\xd8\xff\xe0", "GIF": "GIF89a", "WebP": "RIFF....WEBPVP8 "},
        **{"AVIF": "\0\0\0\x1cftypavif....", "HEIC": "\0\0\0\x18ftypmif1....heic", "QOI": "qoif", "PPM": "P6\n1 1"},
        **{"BMP": "BM..", "JPEG XL": "\xff\n....", "TIFF": "II*\0....", "": "something else"},
    }
    files = f"{json.dumps([*beginnings.values()])}.map((text) => Uint8Array.from(text, (it) => it.charCodeAt(0)))"
    kinds = f"Promise.all({files}.map((bytes) => it.kindOf(new File([bytes], 'a.b'))))"
    found = page.imported("kinds.js", f"{kinds}.then((all) => all.map((one) => [one.kind, one.format ?? '']))")
    assert found == [["image", name] for name in beginnings]


@pytest.mark.thorough
def test_two_tabs(page: Chromium, web: Service) -> None:
    """Each has its own picture and its own job; what one removes the other learns of."""
    web.clear()  # of what other tests left
    page.open_page(web)
    page.queued(SMALL, "one.png")
    address, switch_to = page.run("return location.href"), page.driver.switch_to
    switch_to.new_window("tab")
    first, second = page.driver.window_handles
    try:
        page.open_page(web)
        page.choose("tune", "psnr")
        page.give("drop", SMALL, "two.png")
        page.says(" before it")
        assert page.run("return location.href") != address
        switch_to.window(first)
        assert page.run("return [location.href, document.getElementById('tune').value]") == [address, "visual"]
        assert [job["tune"] for job in web.client.get("/jobs").json()["jobs"]] == ["psnr", "visual"]
        switch_to.window(second)
        page.open("about:blank")
        page.open(address)  # the same job in both
        page.says("in the queue")
        page.says("Original", "#left-label")
        page.cancel()
        switch_to.window(first)
        page.says("has deleted it")
        assert len(web.client.get("/jobs").json()["jobs"]) == 1
        assert web.client.get(f"/jobs/{address.rpartition('#')[2]}").status_code == 404
    finally:
        switch_to.window(second)
        page.run("localStorage.clear()")
        page.driver.close()
        switch_to.window(first)


@pytest.mark.thorough
def test_what_is_refused(page: Chromium, web: Service) -> None:
    """Nothing is offered for it."""
    page.open_page(web)
    page.give("drop", b"%PDF-1.7", "text.pdf")
    page.says("text.pdf is a PDF", "#trouble")
    assert page.is_seen("#ellipses-field")
    assert page.complaints() == []
    page.give("drop", b"this is no picture", "words.png")
    page.says("not a PNG", "#work")
    parts = ("#progress", "#chart", "#cancel", "#stage", "#tools", "#ellipses-field", "#again")
    assert [part for part in parts if page.is_seen(part)] == []
    (complaint,) = page.complaints()
    assert "415" in complaint
    page.click("#sample-cat")
    page.says("5.4 kB", "#right-label")
    assert [page.is_seen(part) for part in ("#stage", "#tools", "#ellipses-field")] == [True] * 3
    page.type("#file", str(PHOTOGRAPHS / "kodim23-crop.png"))
    page.says("in the queue")
    page.cancel()


@pytest.mark.thorough
def test_with_a_key(page: Chromium, start_service: StartService) -> None:
    web = start_service("web", api_keys=f"ann:{digest('secret')}")
    page.open_page(web)
    page.give("drop", SMALL, "disc.png")
    page.says("needs an API key")
    page.type("#key", "wrong")
    page.click("#again")
    page.says("Unknown API key")
    assert all("401" in complaint for complaint in page.complaints())
    page.run("document.getElementById('key').value = ''")
    page.type("#key", "secret")
    page.click("#again")
    page.says("in the queue")
    page.open("about:blank")
    page.open(f"{web.url}/#{web.published(COFFEE, 'ann')}")  # the key is remembered until the window is closed
    page.says(COFFEE_SAYS, "#prefix-words")


@pytest.mark.thorough
def test_a_service_that_restarts_meanwhile(page: Chromium, start_service: StartService) -> None:
    service = start_service("web")
    page.open_page(service)
    page.queued(SMALL, "disc.png")
    service.environment["SG_PORT"] = service.url.rpartition(":")[2]
    assert service.stop() == 0
    page.says("trying again")
    service.start()
    page.says("in the queue")
    assert all("ERR_" in complaint or "Failed to load" in complaint for complaint in page.complaints())


BEYOND = """
    for (const one of document.querySelectorAll("details")) one.open = true;
    const right = (element) => element.getBoundingClientRect().right;
    return [...document.querySelectorAll("button, .button, input, select")].filter((one) => one.offsetParent)
        .filter((one) => right(one) > right(one.closest(".card, section, header"))).map((one) => one.id);
"""


def test_accessibility(page: Chromium, web: Service) -> None:
    """Nothing leaves its card, and no page scrolls sideways, with all parts open."""
    for width in (320, 390, 1000, 1920):
        page.tell("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        page.open(f"{web.url}/docs")
        wait_until(lambda: page.is_seen("#operations details"))
        page.run(BEYOND)
        assert page.run("return document.documentElement.scrollWidth") <= width
        page.open_page(web)
        page.says("AVIF", "#verdict")
        assert page.run(BEYOND) == []
        assert page.run("return document.documentElement.scrollWidth") <= width
    assert_open_to_all(page, at_least=20)
