"""The page of `make demo`: it works without any server but for its own files, and asks for nothing else."""

from __future__ import annotations

import base64
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.bitstream.text import from_text
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from tests.javascript.site import Site, served
from tests.support.browser import Chromium, Page, assert_open_to_all
from tests.support.data import PHOTOGRAPHS, PICTURE, ROOT, STATIC
from tests.support.processes import run, wait_until

pytestmark = pytest.mark.thorough

PARROT = (PHOTOGRAPHS / "kodim23-crop.png").read_bytes()
COFFEE = STATIC / "samples" / "coffee.sg"
PACKAGES = ROOT / "build" / "npm"
MAX_BYTES = 150_000  # of the first load
CHARACTERS = "return [...document.querySelectorAll('figcaption span')].map((one) => one.textContent)"
STAGE = """
    const { width, height } = document.getElementById("canvas");
    const { data } = document.getElementById("canvas").getContext("2d").getImageData(0, 0, width, height);
    let sum = 0;
    for (let at = 0; at < data.length; at += 4) sum += data[at] * (1 + (at % 97));
    return sum;
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    if shutil.which("node") is None or not (PACKAGES / "node_modules" / "thumbhash").exists():
        pytest.skip("the packages that build the page are not there: make npm, which needs Node and npm")
    folder = tmp_path_factory.mktemp("demo")
    done = run("node", "demo/build.mjs", ROOT, folder, folder=PACKAGES)
    assert done.status == 0, done.stderr
    with served(folder) as site:
        yield site


def previewed(page: Page) -> list[str]:
    """What is below the tiles, once all are there."""
    wait_until(lambda: page.run("return document.querySelectorAll('.shown > *').length") == 5)
    wait_until(lambda: all(page.run(CHARACTERS)))
    captions: list[str] = page.run(CHARACTERS)
    return captions


def text_of(page: Page) -> str:
    return page.value_of("text")


def given(page: Page, data: bytes, name: str) -> str:
    """The text of the preview of a photograph that is dropped on the page."""
    before = text_of(page)
    page.give("drop", data, name)
    wait_until(lambda: text_of(page) != before)
    return text_of(page)


def test_a_photograph_becomes_previews_and_a_file(each_browser: Page, demo: Site) -> None:
    """Without a request for anything but the page's own files, and with none at all once the page is there."""
    demo.asked.clear()
    each_browser.open(demo.url)
    previewed(each_browser)
    wait_until(lambda: "Python package" in each_browser.text("#file-words"))
    first = set(demo.asked)
    sizes = [(demo.folder / (name.lstrip("/") or "index.html")).stat().st_size for name in first - {"/favicon.ico"}]
    assert sum(sizes) <= MAX_BYTES
    demo.asked.clear()

    text = given(each_browser, PARROT, "parrot.png")
    assert len(from_text(text)) <= 200
    assert psnr(decoded(text), read_image_8_bit(PARROT)) > 19  # seen: 19.8
    captions = previewed(each_browser)
    assert captions[0].startswith("128 × 96")
    counts = [int(re.match(r"\d+", words)[0]) for words in captions[1:]]  # type: ignore[index]
    assert counts[0] == len(text)
    assert all(20 < count <= len(text) for count in counts)
    assert text in each_browser.text("#element")

    wait_until(lambda: "made here" in each_browser.text("#file-words"))
    each_browser.run("""
        window.saved = null;
        const make = URL.createObjectURL;
        URL.createObjectURL = (blob) => {
            blob.arrayBuffer().then((data) => { window.saved = btoa(String.fromCharCode(...new Uint8Array(data))); });
            return make(blob);
        };
        HTMLAnchorElement.prototype.click = () => undefined;
    """)
    each_browser.click("#save")
    file = base64.b64decode(wait_until(lambda: each_browser.run("return window.saved")))
    assert 2000 < len(file) <= 4000
    assert psnr(sgmethod.decode(file), read_image_8_bit(PARROT)) > 30  # seen: 34.6
    assert set(demo.asked) <= {"/worker.js"}
    resources = each_browser.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert [name for name in resources if not name.startswith((demo.url, f"blob:{demo.url}"))] == []
    refused = "return fetch('http://127.0.0.1:9/').then(() => 'sent', (error) => error.name)"
    assert each_browser.complaints() == []
    assert each_browser.run(refused) == "TypeError"
    assert (
        each_browser.run(
            "return new Promise((done) => { const img = new Image(); img.onerror = () => done(1); "
            "img.onload = () => done(0); img.src = 'http://127.0.0.1:9/a.png'; })"
        )
        == 1
    )
    each_browser.complaints()


def decoded(text: str) -> np.ndarray:
    return sgmethod.open(from_text(text)).pixels(width=128)


def test_sizes_snippets_and_zoom_by_keyboard(each_browser: Page, demo: Site) -> None:
    each_browser.open(demo.url)
    previewed(each_browser)
    given(each_browser, PARROT, "parrot.png")
    previewed(each_browser)
    for size, most in ((0, 64), (8, 1000)):
        before = text_of(each_browser)
        each_browser.choose("bytes", size)
        wait_until(lambda: text_of(each_browser) != before)  # noqa: B023
        assert 0.8 * most <= len(from_text(text_of(each_browser))) <= most
        assert each_browser.text("#size-words").startswith(f"{most:,} bytes")
    for option, word in (
        ("sveltekit", "$lib/door.jpg?preview"),
        ("django", "models.CharField"),
        ("plain-html", "<sg-img"),
    ):
        each_browser.choose("framework", option)
        assert word in each_browser.text(f"#{option}")
        assert (
            each_browser.run("return [...document.querySelectorAll('.snippet')].filter((one) => !one.hidden).length")
            == 1
        )
    each_browser.run("document.querySelector('[data-sample=coffee]').click()")
    wait_until(lambda: f"{COFFEE.stat().st_size:,} bytes" in each_browser.text("#file-words"))
    seen = [each_browser.run(STAGE)]
    for key in ("+", "+", "ArrowDown", "-", "0"):  # or "-" would already show the whole
        each_browser.press("stage", key)
        wait_until(lambda: each_browser.run(STAGE) != seen[-1])
        seen.append(each_browser.run(STAGE))
    each_browser.click("#compare")
    assert each_browser.run(STAGE) != seen[-1]
    each_browser.click("#compare")
    assert each_browser.complaints() == []


def test_what_cannot_be_read_is_said(each_browser: Page, demo: Site) -> None:
    each_browser.open(demo.url)
    previewed(each_browser)
    each_browser.give("drop", b"no picture", "photo.jpg")
    each_browser.says("no picture that your browser can read", "#trouble")
    each_browser.give("drop", b"no file", "photo.sg")
    each_browser.says("no .sg file", "#trouble")
    each_browser.give("drop", PICTURE, "photo.sg")
    each_browser.says("photo.sg", "#file-words")


@pytest.mark.parametrize("width", [390, 1280])
def test_it_is_open_to_all(page: Chromium, demo: Site, width: int) -> None:
    """On a phone too, by day and by night."""
    page.tell("Emulation.setDeviceMetricsOverride", width=width, height=844, deviceScaleFactor=1, mobile=width == 390)
    page.open(demo.url)
    previewed(page)
    for option in page.run("return [...document.getElementById('framework').options].map((one) => one.value)"):
        page.choose("framework", option)
        assert page.run("return document.documentElement.scrollWidth") <= width
    assert_open_to_all(page)


def test_photographs_are_upright(each_browser: Page, demo: Site, tmp_path: Path) -> None:
    each_browser.open(demo.url)
    previewed(each_browser)
    rotated = Image.Exif()
    rotated[0x112] = 6  # a quarter turn
    with Image.open(PHOTOGRAPHS / "kodim23-crop.png") as parrot:
        parrot.convert("RGB").save(tmp_path / "rotated.jpg", exif=rotated, quality=95)
    text = given(each_browser, (tmp_path / "rotated.jpg").read_bytes(), "rotated.jpg")
    assert previewed(each_browser)[0].startswith("96 × 128")
    upright = read_image_8_bit((tmp_path / "rotated.jpg").read_bytes())
    assert psnr(sgmethod.open(from_text(text)).pixels(width=96), upright) > 19  # seen: 20.1
