"""Previews in a page: their small decoder against ours, the element that draws them, and the page's wall of them."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest

import sgmethod
from sgmethod.bitstream.text import from_text, to_text
from tests.service.browser import Chromium, Page
from tests.service.page.bundled import node
from tests.service.page.steps import assert_as_python, assert_open_to_all
from tests.support.data import JAVASCRIPT, STATIC, golden
from tests.support.processes import wait_until
from tests.support.service import Service

SIZE = 96  # of the longer side, pixels
SHORT = [golden(2)[name] for name in ("v2-color", "v2-grey", "v2-empty")]
GOOD = to_text(SHORT[0])
TEXTURED, LONG = to_text(golden(2)["v2-short-alpha"]), to_text(golden(2)["v2-long"])
STRAY_BITS = GOOD[:-1] + chr(ord(GOOD[-1]) + 1)
BAD = ["", "x", "no preview", GOOD[:-4], GOOD[:200] + "A" + GOOD[201:], TEXTURED, LONG, "A" + GOOD[1:]]
BAD += [GOOD + "=", GOOD + "\n", STRAY_BITS]
DECODE = """
const { decodePreview } = await import("%s");
console.log(JSON.stringify(%s.map((text) => {
  try {
    const { width, height, data } = decodePreview(text, %d);
    return [width, height, btoa(String.fromCharCode(...data))];
  } catch (error) {
    return String(error.message);
  }
})));
"""


def test_the_small_decoder_in_node() -> None:
    """The files as Python draws them, within what docs/format.md allows two decoders; and what is bad refused."""
    see_through = np.zeros((12, 16, 4), np.uint8)
    see_through[:, 8:] = (200, 90, 20, 255)
    files = [*SHORT, sgmethod.encode(see_through, bytes=60, tune="psnr", effort=1).data]
    texts = json.dumps([*map(to_text, files), *BAD])
    found = json.loads(node(DECODE % ((JAVASCRIPT / "preview.js").as_uri(), texts, SIZE)))
    drawn, refused = found[: len(files)], found[len(files) :]
    for (width, height, levels), data in zip(drawn, files, strict=True):
        ours = np.frombuffer(base64.b64decode(levels), np.uint8).reshape(height, width, 4).astype(int)
        info = sgmethod.info(data)
        assert_as_python(ours, data, scale=SIZE / max(info.width, info.height))
    assert [type(answer) for answer in refused] == [str] * len(BAD)


VIEWS = [
    {"width": 24},
    {"height": 10},
    {"width": 24, "height": 10},
    {"width": 9, "region": [4, 4, 18, 6]},
    {"scale": 2},
]
WRONG = [{"widht": 24}, {"scale": 2, "width": 24}]


def test_the_whole_decoder_in_node() -> None:
    """Sizes as Python's, what a file holds, and options that do not exist."""
    data = golden(2)["v2-short-alpha"]
    script = f"""
        const {{ decode, info }} = await import("{(JAVASCRIPT / "decoder.js").as_uri()}");
        const bytes = new Uint8Array({list(data)});
        const pictures = {json.dumps(VIEWS)}.map((view) => decode(bytes, view));
        const sizes = pictures.map(({{ width, height }}) => [width, height]);
        const errors = {json.dumps(WRONG)}.map((view) => {{
            try {{ return decode(bytes, view); }} catch (error) {{ return error.name; }}
        }});
        console.log(JSON.stringify([sizes, info(bytes), errors]));
    """
    sizes, found, errors = json.loads(node(script))
    file = sgmethod.open(data)
    expected = [file.pixels(**view).shape[1::-1] for view in VIEWS]  # type: ignore[arg-type]
    assert sizes == [list(size) for size in expected]
    of_python = {name: getattr(file.info, name) for name in ("width", "height", "gaussians", "alpha", "texture")}
    assert found == of_python
    assert errors == ["TypeError", "TypeError"]


def show(page: Page, html: str) -> None:
    """Elements at the top of a page with the strict policy of the service's."""
    page.run(f"""
        document.body.insertAdjacentHTML("afterbegin", {json.dumps(html)});
        return import("/static/sgmethod/sg-img.js").then(() => undefined);
    """)


STATE = """
    const one = document.getElementById("one");
    const img = one.querySelector("img") ?? one.shadowRoot.querySelector("img");
    const canvas = one.shadowRoot.querySelector("canvas");
    const { width, height } = one.getBoundingClientRect();
    return { ratio: width / height, drawn: canvas?.width ?? 0, alt: img.alt,
      loading: img.loading, sizes: img.sizes, source: img.currentSrc.split("/").pop(), loaded: img.naturalWidth > 0 };
"""


@pytest.mark.thorough
def test_the_preview_stands_until_the_picture_is_there(each_browser: Page, web: Service) -> None:
    each_browser.open_blank(web)
    below = "<br>" * 500  # so far that the picture is not loaded yet
    show(each_browser, f'{below}<sg-img id="one" src="static/samples/cat.webp" alt="A cat" preview="{GOOD}"></sg-img>')
    wait_until(lambda: each_browser.run(STATE)["drawn"] == 256)
    each_browser.run("document.getElementById('one').scrollIntoView()")
    wait_until(lambda: each_browser.run(STATE)["loaded"] and not each_browser.run(STATE)["drawn"])
    state = each_browser.run(STATE)
    assert (state["alt"], state["loading"]) == ("A cat", "lazy")
    assert state["ratio"] == pytest.approx(1.5, rel=0.01)
    assert state["source"] == "cat.webp"
    assert each_browser.complaints() == []


@pytest.mark.thorough
def test_an_image_that_is_there_without_javascript(page: Chromium, web: Service) -> None:
    """It stays as it is; and one that fails to load leaves the preview, but not on paper."""
    page.open_blank(web)
    image = '<img srcset="static/samples/none.webp 400w" sizes="50vw" alt="Cups" width="48" height="40">'
    show(page, f'<sg-img id="one" preview="{GOOD}"> {image} </sg-img>')
    wait_until(lambda: page.run(STATE)["drawn"] == 256)
    state = page.run(STATE)
    assert (state["alt"], state["sizes"]) == ("Cups", "50vw")
    assert state["ratio"] == pytest.approx(48 / 40, rel=0.01)
    wait_until(lambda: any("404" in line for line in page.complaints()))
    assert page.run("return document.querySelector('#one img').outerHTML") == image
    seen = "return getComputedStyle(one.shadowRoot.querySelector('canvas')).display"
    page.tell("Emulation.setEmulatedMedia", media="print")
    assert page.run(f"const one = document.getElementById('one'); {seen}") == "none"
    page.tell("Emulation.setEmulatedMedia", media="")
    assert page.run(f"const one = document.getElementById('one'); {seen}") == "block"


@pytest.mark.thorough
def test_a_bad_text_is_a_warning(page: Chromium, web: Service) -> None:
    page.open_blank(web)
    page.complaints()
    below = "<br>" * 500  # a cached photograph that is loaded at once needs no preview, and warns of none
    show(page, f'{below}<sg-img id="one" src="static/samples/coffee.webp" alt="A cup" preview="nothing"></sg-img>')
    warnings = wait_until(page.complaints)
    assert len(warnings) == 1
    assert "sg-img has no preview" in warnings[0]
    page.run("document.getElementById('one').scrollIntoView()")
    wait_until(lambda: page.run(STATE)["loaded"])
    assert page.run(STATE)["drawn"] == 0


# Each answers with what it sees of a new <sg-img>. Tag and property names are those of an <img>, which is the model.
HELP = f"""
    const turns = async () => {{ for (let i = 0; i < 3; i++) await new Promise((done) => setTimeout(done)); }};
    const [text, other, photo] = ["{GOOD}", "{to_text(SHORT[1])}", "/static/samples/cat.webp"];
    const put = (html, place = document.body) => {{
        place.insertAdjacentHTML("beforeend", `<section>${{html}}</section>`);
        return place.lastElementChild.firstElementChild;
    }};
    const loaded = (img) => img.complete || new Promise((done) => img.addEventListener("load", done));
    const inner = (one) => one.shadowRoot.querySelector("img");
    const frame = () => put("<iframe></iframe>").contentDocument;
    const seen = (one) => one.ownerDocument.defaultView.getComputedStyle(one).display;
    const box = (one, width) => {{
        one.parentElement.style.width = `${{width}}px`;
        const {{ width: w, height: h }} = one.querySelector("img").getBoundingClientRect();
        return [w, h];
    }};
"""
OWNED = {
    "a preview after the photograph": (
        """
        const one = put(`<sg-img src="${photo}" loading="eager"></sg-img>`);
        await loaded(inner(one));
        const covers = [];
        for (const preview of [text, other, other]) {
            one.setAttribute("preview", preview);
            await turns();
            covers.push(Boolean(one.shadowRoot.querySelector("canvas")));
        }
        return covers;""",
        [False, False, False],
    ),
    "another photograph with its preview, in either order": (
        """
        const drawn = [];
        for (const names of [["preview", "src"], ["src", "preview"]]) {
            const one = put(`<sg-img src="${photo}" loading="eager" preview="${text}"></sg-img>`);
            await loaded(inner(one));
            for (const name of names) one[name] = { preview: other, src: `/static/samples/none${drawn.length}` }[name];
            await turns();
            drawn.push(one.shadowRoot.querySelectorAll("canvas").length > 0);
        }
        return drawn;""",
        [True, True],
    ),
    "a second <img> before the first": (
        """
        const one = put(`<sg-img preview="${text}"><img src="${photo}" alt=""></sg-img>`);
        await turns();
        one.prepend(new Image());
        await turns();
        return one.children.length;""",
        2,
    ),
    "<picture>": (
        """
        const img = `<img src="${photo}" width="1200" height="800" alt="">`;
        return box(put(`<sg-img preview="${text}"><picture>${img}</picture></sg-img>`), 300);""",
        [300, 200],
    ),
    "no size": (
        """
        const one = put(`<sg-img preview="${other}"><img alt=""></sg-img>`);
        await turns();
        const { width, height } = one.shadowRoot.querySelector("canvas");
        return Math.abs(box(one, 300)[1] - (300 * height) / width) < 1;""",
        True,
    ),
    "cropped": (
        """
        const one = put(`<sg-img><img src="${photo}" width="120" height="80" alt=""></sg-img>`);
        Object.assign(one.style, { width: "80px", height: "80px", objectPosition: "left" });
        const { objectFit, objectPosition } = getComputedStyle(one.querySelector("img"));
        return [...box(one, 300), objectFit, objectPosition];""",
        [80, 80, "cover", "0% 50%"],
    ),
    "moved into another document": (
        """
        const one = put(`<sg-img preview="${text}"></sg-img>`);
        frame().body.append(one);
        return [seen(one), seen(one.shadowRoot.firstElementChild)];""",
        ["block", "grid"],
    ),
    "made here for another document": (
        """
        const one = Object.assign(document.createElement("sg-img"), { src: photo });
        frame().body.append(one);
        return [seen(one), inner(one).src];""",
        ["block", "PHOTO"],
    ),
    "properties": (
        """
        const one = Object.assign(put("<sg-img></sg-img>"), { src: photo, alt: "A cat", preview: text, width: 30 });
        const found = [inner(one).src, inner(one).alt, inner(one).getAttribute("width"), one.getAttribute("preview")];
        found.push(one.src, one.alt);
        one.alt = null;
        return [...found, inner(one).hasAttribute("alt")];""",
        ["PHOTO", "A cat", "30", GOOD, "PHOTO", "A cat", False],
    ),
    "properties set before there was a module": (
        """
        const one = window.EARLY;
        return [one.preview, inner(one).src];""",
        [GOOD, "PHOTO"],
    ),
}


def test_it_is_as_an_img_and_leaves_what_is_not_its_own(each_browser: Page, web: Service) -> None:
    each_browser.open_blank(web)
    early = f'Object.assign(document.createElement("sg-img"), {{ preview: "{GOOD}", src: "/static/samples/cat.webp" }})'
    each_browser.run(f"window.EARLY = {early}; document.body.append(window.EARLY);")
    show(each_browser, "")
    tasks = ", ".join(f"async () => {{ {script} }}" for script, _ in OWNED.values())
    found = each_browser.run(f"""return (async () => {{
        {HELP}
        const answers = [];
        for (const task of [{tasks}]) answers.push(await task().catch(String));
        return answers;
    }})()""")
    photo = f"{web.url}/static/samples/cat.webp"
    expected = json.loads(json.dumps([value for _, value in OWNED.values()]).replace("PHOTO", photo))
    assert dict(zip(OWNED, found, strict=True)) == dict(zip(OWNED, expected, strict=True))


WALL = json.loads((STATIC / "wall" / "wall.json").read_text())
PHONE = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
DRAWN = """
    const hasPreview = (one) => one.shadowRoot.querySelector("canvas");
    return [...document.querySelectorAll("#wall sg-img")].filter(hasPreview).length;
"""


@pytest.mark.thorough
def test_the_wall_on_a_phone(page: Chromium, web: Service) -> None:
    page.tell("Emulation.setDeviceMetricsOverride", **PHONE)
    page.open_page(web)
    loaded = page.run("return performance.getEntriesByType('resource').map((one) => one.name)")
    assert [name for name in loaded if "/wall/" in name or "/sg-img.js" in name] == []
    page.run("const button = document.getElementById('show-wall'); button.focus(); button.click()")
    wait_until(lambda: page.run(DRAWN) == len(WALL["pictures"]))
    assert page.run("return document.activeElement.id") == "load-wall"
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
