"""The wall of previews on the page: nothing of it is loaded before it is asked for; then it sharpens."""

from __future__ import annotations

import base64
import json

import pytest

from sgmethod.bitstream.text import from_text
from tests.harness.browser import Chromium
from tests.harness.data import STATIC
from tests.harness.processes import wait_until
from tests.harness.service import Service
from tests.service.page.steps import assert_open_to_all

pytestmark = pytest.mark.thorough

WALL = json.loads((STATIC / "wall" / "wall.json").read_text())
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
DRAWN = """
    const hasPreview = (one) => one.shadowRoot.querySelector("canvas");
    return [...document.querySelectorAll("#wall sg-img")].filter(hasPreview).length;
"""


def test_the_wall_on_a_phone(page: Chromium, web: Service) -> None:
    page.tell("Emulation.setDeviceMetricsOverride", **PHONE)
    page.open_page(web)
    loaded = page.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert [name for name in loaded if "/wall/" in name or "/preview/" in name] == []
    page.run("document.getElementById('show-wall').click()")
    wait_until(lambda: page.run(DRAWN) == len(WALL["pictures"]))
    assert page.run("return document.documentElement.scrollWidth") == PHONE["width"]
    text = page.text("#wall")
    for name in ("sgmethod", "WebP", "BlurHash", "ThumbHash"):
        assert text.count(name) >= len(WALL["pictures"])
    assert_open_to_all(page, "'#wall-card'", 1)
    page.run("document.getElementById('load-wall').scrollIntoView(); document.getElementById('load-wall').click()")
    wait_until(lambda: page.run(DRAWN) < len(WALL["pictures"]))
    assert page.complaints() == []


def test_all_have_the_same_bytes() -> None:
    for picture in WALL["pictures"]:
        for size, most in enumerate(WALL["bytes"]):
            assert len(from_text(picture["previews"][size])) <= most
            assert len(base64.b64decode(picture["webp"][size] or "")) <= most
            assert picture["blurhash"][size]["characters"] <= 4 * most / 3
