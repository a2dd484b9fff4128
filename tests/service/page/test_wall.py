"""The page's wall of previews beside those of other codecs, at the same bytes."""

from __future__ import annotations

import base64
import json

import pytest

from sgmethod.bitstream.text import from_text
from tests.support.browser import Chromium, assert_open_to_all
from tests.support.data import STATIC
from tests.support.processes import wait_until
from tests.support.service import Service

WALL = json.loads((STATIC / "wall" / "wall.json").read_text())
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
# Only what is near the window is drawn: it has to be scrolled there first.
IS_DRAWN = """
    const one = document.querySelectorAll("#wall sg-img")[%d];
    one?.scrollIntoView();
    return Boolean(one?.shadowRoot.querySelector("canvas"));
"""
HAS_PHOTOGRAPH = """
    const one = document.querySelector("#wall sg-img");
    one.scrollIntoView();
    return one.shadowRoot.querySelector("img").naturalWidth > 0 && !one.shadowRoot.querySelector("canvas");
"""


@pytest.mark.thorough
def test_the_wall_on_a_phone(page: Chromium, web: Service) -> None:
    page.tell("Emulation.setDeviceMetricsOverride", **PHONE)
    page.open_page(web)
    loaded = page.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert [name for name in loaded if "/wall/" in name or "/sg-img.js" in name] == []
    page.run("const button = document.getElementById('show-wall'); button.focus(); button.click()")
    for index in range(len(WALL["pictures"])):
        wait_until(lambda index=index: page.run(IS_DRAWN % index))
    assert page.run("return document.activeElement.id") == "load-wall"
    assert page.run("return document.documentElement.scrollWidth") == PHONE["width"]
    text = page.text("#wall")
    for name in ("sgmethod", "WebP", "BlurHash", "ThumbHash"):
        assert text.count(name) >= len(WALL["pictures"])
    assert_open_to_all(page, "'#wall-card'", 1)
    page.run("document.getElementById('load-wall').click()")
    wait_until(lambda: page.run(HAS_PHOTOGRAPH))
    assert page.complaints() == []


def test_all_have_the_same_bytes() -> None:
    for picture in WALL["pictures"]:
        for size, most in enumerate(WALL["bytes"]):
            assert len(from_text(picture["previews"][size])) <= most
            assert len(base64.b64decode(picture["webp"][size] or "")) <= most
            assert picture["blurhash"][size]["characters"] <= 4 * most / 3
