"""Previews in a page: their small decoder against ours, in Node and in browsers, and the element that draws them."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess

import numpy as np
import pytest

import sgmethod
from service.web.app import STATIC
from sgmethod.bitstream.text import to_text
from tests.harness.browser import Browser, Chromium
from tests.harness.data import golden
from tests.harness.processes import wait_until
from tests.harness.service import Service
from tests.service.page.steps import assert_as_python, complaints, open_blank

SIZE = 96  # of the longer side, pixels
SHORT = [golden(5)[name] for name in ("v5-color", "v5-grey", "v5-empty")]
GOOD = to_text(SHORT[0])
TEXTURED, LONG = to_text(golden(5)["v5-short-alpha"]), to_text(golden(5)["v5-long"])
BAD = ["", "x", "no preview", GOOD[:-4], GOOD[:200] + "A" + GOOD[201:], TEXTURED, LONG, "A" + GOOD[1:]]
DECODE = """
const answers = %s.map((text) => {
  try {
    const { width, height, data } = decodePreview(text, %d);
    return [width, height, btoa(String.fromCharCode(...data))];
  } catch (error) {
    return String(error.message);
  }
});
"""


def see_through() -> bytes:
    """A short file with alpha and without texture."""
    pixels = np.zeros((12, 16, 4), np.uint8)
    pixels[:, 8:] = (200, 90, 20, 255)
    return sgmethod.encode(pixels, bytes=60, tune="psnr", effort=1).data


@pytest.fixture(scope="module")
def files() -> list[bytes]:
    return [*SHORT, see_through()]


def assert_decoded(found: list[list[object] | str], files: list[bytes]) -> None:
    """The files as Python draws them, within what docs/format.md allows two decoders; and what is bad refused."""
    for answer, data in zip(found, files, strict=False):
        width, height, levels = answer
        ours = np.frombuffer(base64.b64decode(str(levels)), np.uint8).reshape(height, width, 4).astype(int)
        info = sgmethod.info(data)
        assert_as_python(ours, data, scale=SIZE / max(info.width, info.height))
    refused = found[len(files) :]
    assert len(refused) == len(BAD)
    assert [answer for answer in refused if not isinstance(answer, str)] == []


def test_in_node(files: list[bytes]) -> None:
    if shutil.which("node") is None:
        pytest.skip("Node is not installed: sudo apt install nodejs")
    texts = json.dumps([*map(to_text, files), *BAD])
    module = (STATIC / "decoder" / "preview.js").as_uri()
    start, end = f"const {{ decodePreview }} = await import('{module}');", "console.log(JSON.stringify(answers));"
    script = start + DECODE % (texts, SIZE) + end
    command = ["node", "--input-type=module", "--no-warnings", "--eval", script]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert_decoded(json.loads(done.stdout), files)


@pytest.mark.parametrize("name", ["browser", "firefox"])
def test_in_a_browser(request: pytest.FixtureRequest, name: str, web: Service, files: list[bytes]) -> None:
    browser: Browser = request.getfixturevalue(name)
    open_blank(browser, web)
    texts = json.dumps([*map(to_text, files), *BAD])
    found = browser.run(f"""
        return import("/static/decoder/preview.js").then(({{ decodePreview }}) => {{
            if (!(decodePreview({texts}[0]) instanceof ImageData)) throw new Error("no ImageData");
            {DECODE % (texts, SIZE)}
            return answers;
        }});
    """)
    assert_decoded(found, files)


def show(page: Browser, html: str) -> None:
    """Elements at the top of a page with the strict policy of the service's."""
    page.run(f"""
        document.body.insertAdjacentHTML("afterbegin", {json.dumps(html)});
        return import("/static/preview/sg-img.js").then(() => undefined);
    """)


STATE = """
    const one = document.getElementById("one");
    const img = one.querySelector("img") ?? one.shadowRoot.querySelector("img");
    const canvas = one.shadowRoot.querySelector("canvas");
    const { width, height } = one.getBoundingClientRect();
    return { ratio: width / height, drawn: canvas?.width ?? 0, opacity: getComputedStyle(img).opacity, alt: img.alt,
      loading: img.loading, sizes: img.sizes, source: img.currentSrc.split("/").pop(), loaded: img.naturalWidth > 0 };
"""


@pytest.mark.parametrize("name", ["browser", "firefox"])
def test_the_preview_stands_until_the_picture_is_there(request: pytest.FixtureRequest, name: str, web: Service) -> None:
    browser: Browser = request.getfixturevalue(name)
    open_blank(browser, web)
    browser.complaints()
    below = "<br>" * 500  # so far that the picture is not loaded yet
    show(browser, f'{below}<sg-img id="one" src="static/samples/cat.webp" alt="A cat" preview="{GOOD}"></sg-img>')
    wait_until(lambda: browser.run(STATE)["drawn"] == 256)
    browser.run("document.getElementById('one').scrollIntoView()")
    wait_until(lambda: browser.run(STATE)["loaded"] and not browser.run(STATE)["drawn"])
    state = browser.run(STATE)
    assert (state["opacity"], state["alt"], state["loading"]) == ("1", "A cat", "lazy")
    assert state["ratio"] == pytest.approx(1.5, rel=0.01)
    assert state["source"] == "cat.webp"
    assert browser.complaints() == []


def test_an_image_that_is_there_without_javascript(page: Chromium, web: Service) -> None:
    """It is taken into the element; and one that fails to load leaves the preview."""
    open_blank(page, web)
    image = '<img srcset="static/samples/none.webp 400w" sizes="50vw" alt="Cups" width="48" height="40">'
    show(page, f'<sg-img id="one" preview="{GOOD}"> {image} </sg-img>')
    wait_until(lambda: page.run(STATE)["drawn"] == 256)
    state = page.run(STATE)
    assert (state["alt"], state["sizes"], state["opacity"]) == ("Cups", "50vw", "0")
    assert state["ratio"] == pytest.approx(48 / 40, rel=0.01)
    wait_until(lambda: any("404" in said for said in complaints(page)))


def test_a_bad_text_is_a_warning(page: Chromium, web: Service) -> None:
    open_blank(page, web)
    complaints(page)
    show(page, '<sg-img id="one" src="static/samples/coffee.webp" alt="A cup" preview="nothing"></sg-img>')
    wait_until(lambda: page.run(STATE)["loaded"])
    state = page.run(STATE)
    assert (state["drawn"], state["opacity"]) == (0, "1")
    (warning,) = complaints(page)
    assert "sg-img has no preview" in warning
