"""<sg-img> in layouts of many photographs: each is shown at its own aspect ratio, as an <img> would be, or cropped
where the page says so. With the rules of docs/previews.md, before and after the script, and before and after the
photographs.
"""

from __future__ import annotations

import json
from typing import Any

import pytest
from PIL import Image

from sgmethod.bitstream.text import to_text
from tests.javascript.site import Site
from tests.support.browser import Page
from tests.support.data import code_in, golden
from tests.support.processes import wait_until

SIZES = [
    *((60, 40), (40, 60), (60, 40), (50, 50), (80, 30), (30, 45)),
    *((64, 48), (48, 64), (60, 40), (40, 60), (90, 60), (60, 45)),
]
TEXT = to_text(golden(2)["v2-color"])
# Of section, and of what is in it; a number is the aspect ratio to which the page crops.
LAYOUTS: dict[str, tuple[str, str, float | None]] = {
    "grid": ("display: grid; grid-template-columns: repeat(4, 1fr); gap: 8px", "", None),
    "grid with rows of a fixed height": ("display: grid; grid: auto-flow 70px / repeat(4, 1fr)", "", None),
    "wrapping flex row": ("display: flex; flex-wrap: wrap; gap: 8px", "flex: 1 1 200px", None),
    "flex row of shares": ("display: flex; flex-wrap: wrap", "flex: 0 0 25%", None),
    "flex column": ("display: flex; flex-direction: column; width: 300px; height: 400px", "", None),
    "flex column that does not stretch": (
        "display: flex; flex-direction: column; align-items: start",
        "width: 90px",
        None,
    ),
    "columns": ("columns: 4", "", None),
    "figures in a grid": ("display: grid; grid-template-columns: repeat(4, 1fr)", "", None),
    "figures in a flex row": ("display: flex; flex-wrap: wrap; gap: 8px", "flex: 1 1 200px", None),
    "squares in a grid": ("display: grid; grid-template-columns: repeat(4, 1fr)", "aspect-ratio: 1", 1),
    "squares in a flex row": ("display: flex; flex-wrap: wrap", "flex: 0 0 25%; aspect-ratio: 1", 1),
    "a fixed height in a flex row": ("display: flex; flex-wrap: wrap", "width: 200px; height: 100px", 2),
    "a fixed height in a block": ("width: 300px", "height: 200px", 1.5),
    "as high as a grid's row": ("display: grid; grid: auto-flow 100px / repeat(4, 200px)", "height: 100%", 2),
    "figures that float": ("display: flow-root", "float: left", None),
    "figures as inline blocks": ("", "display: inline-block", None),
    "figures as table cells": ("display: table", "display: table-cell", None),
    "figures in a row that shrinks": ("display: flex; width: 300px", "", None),
    "figures in a centred column": ("display: flex; flex-direction: column; align-items: center", "", None),
    "figures in a centred grid": ("display: grid; place-items: center", "", None),
    "figures that fit their content": ("", "width: fit-content", None),
    "figures that float where it is narrow": ("width: 50px; display: flow-root", "float: left", None),
    "figures as narrow table cells": ("display: table; width: 50px", "display: table-row", None),
    "never enlarged": ("width: 70px", "width: fit-content", None),
}
MEASURE = """
    const part = (one, name) => one.querySelector(name) ?? one.shadowRoot?.querySelector(name);
    const measured = async (one) => {
        while (COVERED && !part(one, "canvas")) { // those far from the viewport have none
            one.scrollIntoView();
            await new Promise((done) => setTimeout(done, 10));
        }
        const boxes = [part(one, "img"), one, part(one, "canvas")].map((other) => other?.getBoundingClientRect());
        return boxes.map((box) => box && [box.x, box.y + scrollY, box.width, box.height]);
    };
    return (async () => {
        const found = [];
        for (const section of document.querySelectorAll("section")) {
            found.push([section.title, []]);
            for (const one of section.querySelectorAll("sg-img")) found.at(-1)[1].push(await measured(one));
        }
        return found;
    })();
"""
LOAD = """
    const all = [...document.querySelectorAll("sg-img")].map((one) => one.querySelector("img") ?? one);
    for (const one of all) one.src += "?now";
"""
LOADED = """
    const inner = (one) => one.querySelector("img") ?? one.shadowRoot.querySelector("img");
    const all = [...document.querySelectorAll("sg-img")].map(inner);
    return all.every((img) => img.complete && img.naturalWidth);
"""
KINDS = {
    "img": '<sg-img preview="{text}"><img {known}></sg-img>',
    "picture": '<sg-img preview="{text}"><picture><img {known}></picture></sg-img>',
    "alone": '<sg-img preview="{text}" {known} loading="eager"></sg-img>',
}


def page_of(kind: str) -> tuple[str, str]:
    """Rules, and each layout with all photographs, which do not exist yet."""
    rules = code_in("docs/previews.md", heading="Plain HTML")[1] + " figure { margin: 0 }"
    html = "<!doctype html><meta charset=utf-8><link rel=stylesheet href=style.css>"
    for number, (title, (outer, inner, crop)) in enumerate(LAYOUTS.items()):
        rules += f" #a{number} {{ {outer} }} #a{number} {'sg-img' if crop else '> *'} {{ {inner} }}"
        photographs = ""
        for i, (width, height) in enumerate(SIZES):
            known = f'src="{i}.jpg" width="{width}" height="{height}" alt=""'
            one = KINDS[kind].format(text=TEXT, known=known)
            photographs += f"<figure>{one}<figcaption>A caption</figcaption></figure>" if "figures" in title else one
        html += f'<section id="a{number}" title="{title}">{photographs}</section>'
    return rules, html


def assert_own_aspects(page: Page, covered: bool = False) -> list[Any]:
    """Photograph, preview and element are at the same place, and as wide and high as they should be. Returns where."""
    wrong: dict[str, list[Any]] = {}
    found = page.run(MEASURE.replace("COVERED", str(covered).lower()))
    for title, photographs in found:
        for i, (img, host, canvas) in enumerate(photographs):
            expected = LAYOUTS[title][2] or SIZES[i][0] / SIZES[i][1]
            same = [abs(a - b) < 1 for other in (host, canvas) if other for a, b in zip(img, other, strict=True)]
            if title == "never enlarged":
                same.append(img[2] == min(SIZES[i][0], 70))
            if not (img[3] > 1 and img[2] / img[3] == pytest.approx(expected, rel=0.02) and all(same)):
                wrong.setdefault(title, []).append((i, img, host, canvas))
        assert len(photographs) == len(SIZES)
    assert {title: len(places) for title, places in wrong.items()} == {}, json.dumps(wrong)
    return [[title, [img for img, *_ in photographs]] for title, photographs in found]


def assert_same_places(before: list[Any], after: list[Any]) -> None:
    """Nothing has moved, by more than rounding."""
    moved = {
        title: (place, now)
        for (title, places), (_, places_now) in zip(before, after, strict=True)
        for place, now in zip(places, places_now, strict=True)
        if max(abs(a - b) for a, b in zip(place, now, strict=True)) > 1
    }
    assert moved == {}


@pytest.mark.parametrize(
    "kind", ["img", *(pytest.param(kind, marks=pytest.mark.thorough) for kind in ("picture", "alone"))]
)
def test_each_photograph_has_its_own_aspect_ratio(each_browser: Page, site: Site, kind: str) -> None:
    for name, text in zip(("style.css", "index.html"), page_of(kind), strict=True):
        (site.folder / name).write_text(text)
    each_browser.open(site.url)
    early = assert_own_aspects(each_browser) if kind != "alone" else None  # as without JavaScript
    each_browser.run("return import('/sgmethod/sg-img.js').then(() => undefined)")
    previewed = assert_own_aspects(each_browser, covered=True)
    for i, size in enumerate(SIZES):
        Image.new("RGB", size, (90, 40 * i % 256, 90)).save(site.folder / f"{i}.jpg")
    each_browser.run(LOAD)
    wait_until(lambda: each_browser.run(LOADED))
    now = assert_own_aspects(each_browser)
    for before in filter(None, (early, previewed)):
        assert_same_places(before, now)
