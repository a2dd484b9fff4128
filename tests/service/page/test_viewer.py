"""The large picture of the page, in a real browser: comparing, zoom, and what is beyond pixels."""

from __future__ import annotations

import re

import numpy as np
import pytest

import sgmethod
from tests.service.page.steps import COFFEE, PHOTOGRAPH
from tests.support.browser import Chromium
from tests.support.data import golden
from tests.support.pictures import page_of_text
from tests.support.processes import wait_until
from tests.support.service import Service

pytestmark = pytest.mark.thorough

FIRST_LOOK_BYTES = 170_000
TEXTURED = golden(2)["v2-texture"]


def largest_step(page: Chromium) -> int:
    """Of levels, from one pixel on the screen to the next."""
    return int(np.abs(np.diff(page.settled(), axis=0)).max())


def test_first_look_compare_and_zoom(page: Chromium, web: Service) -> None:
    page.open("about:blank")
    page.tell("Network.clearBrowserCache")
    page.open_page(web)
    page.says("AVIF", "#verdict")
    sizes = page.run("return performance.getEntriesByType('resource').map((one) => [one.name, one.transferSize])")
    before_sample = [size for name, size in sizes if not name.endswith(("webp", "avif"))]
    assert sum(before_sample) < FIRST_LOOK_BYTES
    assert all(name.startswith(web.url) for name, _ in sizes)
    assert "times" not in page.text("header")  # by how much a file is smaller depends on the picture
    assert "Original" in page.text("#left-label")
    assert "9.0 kB" in page.text("#right-label")
    assert "dB" not in page.text("#labels")
    assert re.fullmatch(r"6\.[67] times smaller than the original; fine detail is lost\.", page.text("#outcome"))
    assert page.text("#figures") == ""
    page.click("#figures-field summary")
    assert re.search(r"0\.30 bits per pixel · PSNR 3\d\.\d dB · SSIM 0\.\d\d\.", page.text("#figures"))
    assert [name in page.text("#others") for name in ("Original", "Gaussians", "JPEG", "WebP", "AVIF")] == [True] * 5

    both = page.settled()
    page.press("divider", "Home")
    ours = page.settled()
    page.press("divider", "End")
    original = page.settled()
    half = len(both) // 2
    assert (both[: half - 2] == original[: half - 2]).all()
    assert (both[half + 2 :] == ours[half + 2 :]).all()
    assert 0 < np.abs(ours.astype(int) - original).mean() < 10

    page.zoom_in()
    assert page.text("#zoom") == "6400 %"
    wait_until(lambda: largest_step(page) <= 6)  # 1 here; 42 with hard pixels
    page.press("divider", "Home")
    wait_until(lambda: largest_step(page) <= 6)
    page.click("#zoom-fit")

    page.choose("prefix", 5)
    assert re.search(r"the first [45]\d\d B of 9\.0 kB", page.text("#right-label"))
    wait_until(lambda: np.abs(page.settled() - ours).mean() > 10)
    page.click("#ellipses")
    page.says("one standard deviation", "#legend")
    page.click("#sample-cat")
    page.says("5.4 kB", "#right-label")
    assert page.complaints() == []


def test_fingers(page: Chromium, web: Service) -> None:
    """One moves the divider, two zoom where they are."""

    def touch(*moments: list[tuple[float, float]]) -> None:
        for kind, places in zip(["touchStart", *["touchMove"] * (len(moments) - 1)], moments, strict=True):
            points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
            page.tell("Input.dispatchTouchEvent", type=kind, touchPoints=points)
        page.tell("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    page.open_page(web)
    left, top, width, height = page.run("""
        const { x, y, width, height } = document.getElementById("stage").getBoundingClientRect();
        return [x, y, width, height];
    """)
    x, y = left + width / 2, top + height / 2
    touch([(x, y)], [(x + width / 8, y)], [(x + width / 4, y)])
    page.settled()
    assert page.run("return document.getElementById('divider').getAttribute('aria-valuenow')") == "75"
    before = int(page.text("#zoom").removesuffix(" %"))
    touch([(x - 20, y), (x + 20, y)], [(x - 50, y), (x + 50, y)], [(x - 80, y), (x + 80, y)])
    assert 3.8 < int(page.text("#zoom").removesuffix(" %")) / before < 4.2
    page.click("#zoom-fit")
    assert page.complaints() == []


def test_other_codecs_of_the_service(page: Chromium, keeping: Service) -> None:
    """No browser writes AVIF: the service makes it of the job's picture, as long as it has it."""
    page.open_page(keeping)
    keeping.publish(page.queued(PHOTOGRAPH, "coffee.webp"), COFFEE)
    page.says("AVIF", "#verdict")
    assert re.search(r"AVIF (8\.[7-9]|9\.\d) kB \d\d\.\d dB 0\.\d{3}", page.text("#others"))
    row = "#others tbody tr:last-child"
    page.click(f"{row} button")
    page.says("AVIF", "#left-label")
    assert page.run(f"return document.activeElement === document.querySelector('{row} button')")
    assert page.complaints() == []


def test_the_better_file_is_offered(page: Chromium, keeping: Service) -> None:
    """Of what Gaussians do not suit, with a sentence that says why; the service makes it of the job's picture."""
    page.open_page(keeping)
    assert not page.is_seen("#advice")
    job = page.queued(page_of_text(), "words.png")
    keeping.publish(job, COFFEE, bytes=20_000, better="webp", advice="Gaussians do not suit this: WebP takes less")
    page.says("Gaussians do not suit this: WebP takes less. Save as lossless WebP", "#advice")
    assert not page.is_seen("#note")
    page.run("""
        HTMLAnchorElement.prototype.click = function () { window.saved = this.download; };
        const made = URL.createObjectURL;
        URL.createObjectURL = (blob) => { window.size = blob.size; return made(blob); };
    """)
    page.click("#advice button")
    wait_until(lambda: page.run("return window.saved") == "words.webp")
    assert page.run("return window.size") == len(keeping.client.get(f"/jobs/{job}/comparison.webp").content)
    assert page.complaints() == []


def test_another_codec_that_fails(page: Chromium, web: Service) -> None:
    """This service keeps no images; the page knows, and does not ask."""
    page.open_page(web)
    web.publish(page.queued(PHOTOGRAPH, "coffee.webp"), COFFEE)
    page.says("no longer has the picture", "#others")
    assert page.complaints() == []


def test_a_codec_that_fails_is_not_the_end(page: Chromium, web: Service) -> None:
    page.open_page(web)
    page.run("""
        const tell = Worker.prototype.postMessage;
        Worker.prototype.postMessage = function (message) {
            tell.call(this, message.given.type === "image/webp" ? { ...message, name: "unknown" } : message);
        };
    """)
    page.click("#sample-cat")
    page.says("WebP answers[name] is not a function", "#others")
    page.says("AVIF", "#verdict")


def test_texture_on_and_off(page: Chromium, web: Service) -> None:
    page.open_page(web)
    page.give("drop", golden(2)["v2-color"], "smooth.sg")
    wait_until(lambda: not page.is_seen("#texture-field"))
    page.give("drop", TEXTURED, "textured.sg")
    wait_until(lambda: page.is_seen("#texture"))
    textured, size = page.settled(), sgmethod.info(TEXTURED)
    page.click("#texture")
    page.says("without texture", "#right-label")
    wait_until(lambda: not np.array_equal(page.settled(), textured))
    page.press("stage", "1")
    middle, smooth = size.height // 2, sgmethod.decode(TEXTURED, view=sgmethod.View(texture=False)).astype(int)

    def is_smooth() -> bool:
        row = page.settled()
        left = (len(row) - size.width) // 2
        parts = (row[at : at + size.width] for at in (left, left + 1))  # the canvas may be an odd number wide, or high
        return any(np.abs(part - smooth[y]).max() <= 1 for part in parts for y in (middle - 1, middle))

    wait_until(is_smooth)
    assert page.complaints() == []
