"""HTML of docs/previews.md and of Preview.element(), in a page."""

from __future__ import annotations

import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.bitstream.text import to_text
from sgmethod.metrics import psnr
from tests.javascript.site import Site, served
from tests.javascript.test_element import show
from tests.support.browser import Chromium
from tests.support.data import JAVASCRIPT, PHOTOGRAPHS, code_in, golden
from tests.support.processes import wait_until

pytestmark = pytest.mark.thorough

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


def test_plain_html(page: Chromium, site: Site) -> None:
    text = to_text(golden(2)["v2-color"])
    page.open(site.url)
    within, rules, alone = code_in("docs/previews.md", heading="Plain HTML")
    assert SHORTENED in within and SHORTENED in alone
    within, alone = (re.sub(r"photo(-2x)?\.avif", "cat.webp", html) for html in (within, alone))
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


def test_nothing_but_the_page_is_beside_a_photograph_that_is_contained(page: Chromium, tmp_path: Path) -> None:
    """Not the WebP either, which is placed as the photograph is, or goes when that is there."""
    Image.new("RGB", (200, 400), "#c06030").save(tmp_path / "photo.png")  # upright, in boxes that lie
    shutil.copytree(JAVASCRIPT, tmp_path / "sgmethod")
    preview = sgmethod.preview(tmp_path / "photo.png", 64)
    html, element = preview.html("photo.png"), preview.element("photo.png")
    assert "url(data:image" in html and "url(data:image" in element
    box = "width: 400px !important; height: 200px !important; object-fit: contain !important"
    rules = f"body {{ margin: 0; background: #0f0 }} sg-img, img {{ display: block; {box} }}"
    body = f'{html}{element}<script type="module" src="sgmethod/sg-img.js"></script>'
    (tmp_path / "index.html").write_text(f"<!doctype html><style>{rules}</style>{body}")
    with served(tmp_path) as site:
        page.open(site.url)
        page.run("for (const img of document.images) img.loading = 'eager'")
        wait_until(lambda: page.run("return [...document.images].every((img) => img.complete)"))
        wait_until(lambda: page.run(PICTURE) == ["", True, True])
        shown = np.asarray(Image.open(io.BytesIO(page.driver.get_screenshot_as_png())).convert("RGB"))
    for row in (100, 300):
        assert shown[row, [60, 200, 340]].tolist() == [[0, 255, 0], [0xC0, 0x60, 0x30], [0, 255, 0]]


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

    with served(tmp_path) as site:
        site.may.clear()
        page.open(site.url)
        wait_until(lambda: likeness() > 17)  # seen: 19.6
        webp = likeness()
        page.run("return import('/sgmethod/sg-img.js').then(() => undefined)")
        wait_until(lambda: page.run("return document.querySelector('sg-img').shadowRoot.querySelector('canvas')"))
        assert likeness() > 17
        assert likeness() != webp
        site.may.set()
        wait_until(lambda: page.run(PICTURE) == ["A parrot", True, True])
        assert likeness() > 25
