"""The page of `make demo`: it works without any server but for its own files, and asks for nothing else."""

from __future__ import annotations

import io
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
from tests.support.browser import Chromium, Page, assert_open_to_all, bytes_of
from tests.support.data import PHOTOGRAPHS, ROOT
from tests.support.pictures import saved
from tests.support.processes import run, wait_until

pytestmark = pytest.mark.thorough

PARROT = (PHOTOGRAPHS / "kodim23-crop.png").read_bytes()
PACKAGES = ROOT / "build" / "npm"
CHARACTERS = "return [...document.querySelectorAll('figcaption span')].map((one) => one.textContent)"


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    if shutil.which("node") is None or not (PACKAGES / "node_modules" / "esbuild").exists():
        pytest.skip("the packages that build the page are not there: make npm, which needs Node and npm")
    folder = tmp_path_factory.mktemp("demo")
    done = run("node", "demo/build.mjs", ROOT, folder, folder=PACKAGES)
    assert done.status == 0, done.stderr
    with served(folder) as site:
        yield site


def previewed(page: Page) -> list[str]:
    """What is below the tiles, once all are there."""
    wait_until(lambda: page.run("return document.querySelectorAll('.shown > :is(img, sg-img)').length") == 3)
    wait_until(lambda: all(page.run(CHARACTERS)))
    captions: list[str] = page.run(CHARACTERS)
    return captions


@pytest.fixture
def shown(each_browser: Page, demo: Site) -> Page:
    """The page with previews of its own photograph."""
    each_browser.open(demo.url)
    previewed(each_browser)
    return each_browser


def text_of(page: Page) -> str:
    return page.value_of("text")


def given(page: Page, data: bytes, name: str) -> str:
    """The text of the preview of a photograph that is dropped on the page."""
    before = text_of(page)
    page.give("drop", data, name)
    wait_until(lambda: text_of(page) not in ("", before))
    return text_of(page)


def test_a_photograph_becomes_a_preview(each_browser: Page, demo: Site) -> None:
    """Without a request for anything but the page's own files, and with none at all once the page is there."""
    demo.asked.clear()
    each_browser.open(demo.url)
    previewed(each_browser)
    first = set(demo.asked)
    sizes = [(demo.folder / (name.lstrip("/") or "index.html")).stat().st_size for name in first - {"/favicon.ico"}]
    (most,) = re.findall(r"the page loads at most (\d+) kB", (ROOT / "docs" / "previews.md").read_text())
    assert sum(sizes) <= 1000 * int(most)
    demo.asked.clear()

    text = given(each_browser, PARROT, "parrot.png")
    assert len(from_text(text)) <= 200
    assert psnr(decoded(text), read_image_8_bit(PARROT)) > 19  # seen: 19.8
    captions = previewed(each_browser)
    assert captions[0].startswith("128 × 96")
    counts = [int(re.match(r"\d+", words)[0]) for words in captions[1:]]  # type: ignore[index]
    assert counts[0] == len(text)
    assert 100 < counts[1] <= len(text)
    assert text in each_browser.text("#element")

    assert set(demo.asked) == set()
    resources = each_browser.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert [name for name in resources if not name.startswith((demo.url, f"blob:{demo.url}"))] == []
    refused = "return fetch('http://127.0.0.1:9/').then(() => 'sent', (error) => error.name)"
    assert each_browser.complaints() == []
    assert each_browser.run(refused) == "TypeError"
    image = "img.onerror = () => done('refused'); img.src = 'http://127.0.0.1:9/a.png';"
    assert each_browser.run(f"return new Promise((done) => {{ const img = new Image(); {image} }})") == "refused"
    each_browser.complaints()


def decoded(text: str) -> np.ndarray:
    return sgmethod.open(from_text(text)).pixels(width=128)


def test_sizes_and_what_to_copy(shown: Page) -> None:
    given(shown, PARROT, "parrot.png")
    previewed(shown)
    for size, most in ((0, 64), (8, 1000)):
        before = text_of(shown)
        shown.choose("bytes", size)
        wait_until(lambda: text_of(shown) != before)  # noqa: B023
        assert 0.8 * most <= len(from_text(text_of(shown))) <= most
        assert shown.text("#size-words").startswith(f"{most:,} bytes")
    shown.run("navigator.clipboard.writeText = async (text) => { window.copied = text; }")
    for part in ("text", "element"):
        shown.click(f"[data-copies={part}]")
        copied = wait_until(lambda: shown.run("return window.copied"))
        assert (copied == text_of(shown)) if part == "text" else '<img src="parrot.png" alt="" width="128"' in copied
        shown.run("window.copied = null")
    assert shown.complaints() == []


LEFT = """
    const text = (id) => document.getElementById(id).value ?? document.getElementById(id).textContent;
    const pictures = document.querySelectorAll(".shown :is(img, canvas, sg-img)").length;
    const busy = document.querySelectorAll("[aria-busy=true]").length;
    return [text("text"), text("element"), pictures, busy];
"""


def test_nothing_of_the_last_photograph_stays_while_the_next_is_worked_on(shown: Page) -> None:
    wait_until(lambda: shown.run(LEFT)[3:] == [0])
    drop = f"""
        const given = new DataTransfer();
        given.items.add(new File([{bytes_of(PARROT)}], "parrot.png"));
        dispatchEvent(new DragEvent("drop", {{ cancelable: true, dataTransfer: given }}));
    """
    assert shown.run(drop + LEFT) == ["", "", 0, 4]
    previewed(shown)
    assert shown.complaints() == []


def test_a_transparent_picture_shows_through_its_previews_alone(page: Chromium, demo: Site) -> None:
    """No sign of a broken image, and no black."""
    picture = np.zeros((200, 300, 4), np.uint8)
    picture[60:140, 90:210] = (200, 80, 40, 255)
    page.open(demo.url)
    previewed(page)
    given(page, saved(Image.fromarray(picture), "PNG"), "transparent.png")
    previewed(page)
    photograph, *others = page.run(
        "return [...document.querySelectorAll('.shown')].map((one) => one.getBoundingClientRect())"
    )
    shown = np.asarray(Image.open(io.BytesIO(page.driver.get_screenshot_as_png())).convert("RGB")).astype(int)

    def border(box: dict[str, float]) -> np.ndarray:
        left, top, width, height = (round(box[name]) for name in ("x", "y", "width", "height"))
        return shown[top + 8 : top + height - 8, left + 8 : left + width // 8]

    for box in others[:2]:  # the preview, and WebP
        assert np.abs(border(box) - border(photograph)[0, 0]).max() < 40


MOVED = """
    const all = (done) => new PerformanceObserver((list) => done(list.getEntries().map(({ value }) => value)))
        .observe({ type: "layout-shift", buffered: true });
    return Promise.race([new Promise(all), new Promise((done) => setTimeout(() => done([]), 500))]);
"""


def test_what_cannot_be_read_is_said(shown: Page) -> None:
    shown.give("drop", b"no picture", "photo.jpg")
    shown.says("no picture that your browser can read", "#trouble")
    assert text_of(shown) == ""


@pytest.mark.parametrize("width", [320, 390, 1280])
def test_it_is_open_to_all(page: Chromium, demo: Site, width: int) -> None:
    """On a phone too, by day and by night; and nothing moves as it opens."""
    page.tell("Emulation.setDeviceMetricsOverride", width=width, height=1800, deviceScaleFactor=1, mobile=width < 400)
    page.open(demo.url)
    previewed(page)
    assert page.run("return document.documentElement.scrollWidth") <= width
    assert page.run(MOVED) == []
    assert_open_to_all(page)


def test_photographs_are_upright(shown: Page, tmp_path: Path) -> None:
    rotated = Image.Exif()
    rotated[0x112] = 6  # a quarter turn
    with Image.open(PHOTOGRAPHS / "kodim23-crop.png") as parrot:
        parrot.convert("RGB").save(tmp_path / "rotated.jpg", exif=rotated, quality=95)
    text = given(shown, (tmp_path / "rotated.jpg").read_bytes(), "rotated.jpg")
    assert previewed(shown)[0].startswith("96 × 128")
    upright = read_image_8_bit((tmp_path / "rotated.jpg").read_bytes())
    assert psnr(sgmethod.open(from_text(text)).pixels(width=96), upright) > 19  # seen: 20.1
