"""The recipes of docs/previews.md that need no framework: in Node, in Chromium, and with FastAPI."""

from __future__ import annotations

import asyncio
import io
import json
import re
import shutil
import threading
from http.server import SimpleHTTPRequestHandler
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.bitstream.text import from_text, to_text
from sgmethod.metrics import psnr
from tests.service.browser import Chromium
from tests.service.page.bundled import served
from tests.service.page.test_previews import show
from tests.support.data import JAVASCRIPT, PHOTOGRAPHS, ROOT, golden
from tests.support.processes import TIMEOUT_S, wait_until
from tests.support.service import Service

PAGE = (ROOT / "docs" / "previews.md").read_text()
PHOTOGRAPH = PHOTOGRAPHS / "kodim23-crop.png"
SHORTENED = "woOAaA..."  # a preview in the document
PICTURE = """
    const one = document.querySelector("sg-img");
    const img = one.querySelector("img") ?? one.shadowRoot.querySelector("img");
    return [img.alt, img.naturalWidth > 0, !one.shadowRoot.querySelector("canvas")];
"""
BOX = """
    const { width, height } = document.querySelector("sg-img img").getBoundingClientRect();
    return [width, height, document.querySelector("sg-img").getBoundingClientRect().height];
"""


def blocks(heading: str) -> list[str]:
    """The code below a heading."""
    (section,) = re.findall(rf"^## {heading}$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)
    return code_of(section)


def code_of(text: str) -> list[str]:
    """The code in a document."""
    found: list[str] = re.findall(r"^```\w+\n(.*?)^```$", text, re.M | re.S)
    return found


@pytest.mark.thorough
def test_plain_html(page: Chromium, web: Service) -> None:
    text = to_text(golden(2)["v2-color"])
    page.open_blank(web)
    within, rules, alone = blocks("Plain HTML")
    assert SHORTENED in within and SHORTENED in alone
    within, alone = (re.sub(r"photo(-2x)?\.avif", "static/samples/cat.webp", html) for html in (within, alone))
    page.run(f"""
        const sheet = new CSSStyleSheet();
        sheet.replaceSync({json.dumps(rules)});
        document.adoptedStyleSheets.push(sheet);
        document.body.insertAdjacentHTML("afterbegin", {json.dumps(f"<div>{within.replace(SHORTENED, text)}</div>")});
        document.body.firstChild.style.width = "300px";
    """)
    assert page.run(BOX) == [300, 200, 200]  # before the script has run
    show(page, "")
    assert page.run(BOX) == [300, 200, 200]
    wait_until(lambda: page.run(PICTURE) == ["A red door", True, True])
    show(page, alone.replace(SHORTENED, text))
    wait_until(lambda: page.run(PICTURE) == ["A red door", True, True])


class Held(SimpleHTTPRequestHandler):
    """Serves files, and photo.png only once it may."""

    may = threading.Event()

    def do_GET(self) -> None:
        if self.path != "/photo.png" or self.may.wait(TIMEOUT_S):
            super().do_GET()


@pytest.mark.thorough
def test_a_tag_shows_a_webp_then_the_preview_then_the_photograph(page: Chromium, tmp_path: Path) -> None:
    shutil.copy(PHOTOGRAPH, tmp_path / "photo.png")
    shutil.copytree(JAVASCRIPT, tmp_path / "sgmethod")
    tag = sgmethod.preview(PHOTOGRAPH).element("photo.png", "A parrot")
    html = f'<!doctype html><body style="margin:0"><div style="width:384px">{tag}</div>'
    (tmp_path / "index.html").write_text(html)
    photograph = np.asarray(Image.open(PHOTOGRAPH).convert("RGB").resize((384, 288)))

    def likeness() -> float:
        shown = Image.open(io.BytesIO(page.driver.get_screenshot_as_png())).convert("RGB").crop((0, 0, 384, 288))
        return psnr(np.asarray(shown), photograph)

    with served(tmp_path, Held) as address:
        try:
            page.open(f"{address}index.html")
            wait_until(lambda: likeness() > 17)  # seen: 19.6
            webp = likeness()
            page.run("return import('/sgmethod/sg-img.js').then(() => undefined)")
            wait_until(lambda: page.run("return document.querySelector('sg-img').shadowRoot.querySelector('canvas')"))
            assert likeness() > 17
            assert likeness() != webp
            Held.may.set()
            wait_until(lambda: page.run(PICTURE) == ["A parrot", True, True])
            assert likeness() > 25
        finally:
            Held.may.set()


def test_fastapi() -> None:
    (block,) = blocks("FastAPI")
    names: dict[str, Any] = {"__name__": "recipe"}
    exec(compile(block, "recipe", "exec"), names)

    async def upload(data: bytes) -> httpx2.Response:
        transport = httpx2.ASGITransport(app=names["app"])
        async with httpx2.AsyncClient(transport=transport, base_url="http://recipe") as client:
            return await client.post("/photos", content=data)

    answer = asyncio.run(upload(PHOTOGRAPH.read_bytes()))
    assert answer.status_code == 200
    photo = answer.json()
    assert (photo["width"], photo["height"]) == (128, 96)
    assert len(from_text(photo["preview"])) <= 200
    answer = asyncio.run(upload(b"text"))
    assert (answer.status_code, answer.json()["detail"][:15]) == (422, "the file is not")
