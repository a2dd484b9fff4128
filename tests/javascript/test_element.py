"""<sg-img> in a page: it draws the preview until the photograph is there, and is as an <img> otherwise."""

from __future__ import annotations

import json

import pytest

from sgmethod.bitstream.text import to_text
from tests.javascript.site import Site
from tests.support.browser import Chromium, Page
from tests.support.data import golden
from tests.support.processes import wait_until

GOOD, OTHER = (to_text(golden(2)[name]) for name in ("v2-color", "v2-grey"))


def show(page: Page, html: str) -> None:
    """Elements at the top of the site's page."""
    page.run(f"""
        document.body.insertAdjacentHTML("afterbegin", {json.dumps(html)});
        return import("/sgmethod/sg-img.js").then(() => undefined);
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
def test_the_preview_stands_until_the_picture_is_there(each_browser: Page, site: Site) -> None:
    each_browser.open(site.url)
    below = "<br>" * 500  # so far that the picture is not loaded yet
    show(each_browser, f'{below}<sg-img id="one" src="cat.webp" alt="A cat" preview="{GOOD}"></sg-img>')
    wait_until(lambda: each_browser.run(STATE)["drawn"] == 256)
    each_browser.run("document.getElementById('one').scrollIntoView()")
    wait_until(lambda: each_browser.run(STATE)["loaded"] and not each_browser.run(STATE)["drawn"])
    state = each_browser.run(STATE)
    assert (state["alt"], state["loading"]) == ("A cat", "lazy")
    assert state["ratio"] == pytest.approx(1.5, rel=0.01)
    assert state["source"] == "cat.webp"
    assert each_browser.complaints() == []


@pytest.mark.thorough
def test_an_image_that_is_there_without_javascript(page: Chromium, site: Site) -> None:
    """It stays as it is; and one that fails to load leaves the preview, but not on paper."""
    page.open(site.url)
    image = '<img srcset="none.webp 400w" sizes="50vw" alt="Cups" width="48" height="40">'
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
def test_a_bad_text_is_a_warning(page: Chromium, site: Site) -> None:
    page.open(site.url)
    page.complaints()
    below = "<br>" * 500  # a cached photograph that is loaded at once needs no preview, and warns of none
    show(page, f'{below}<sg-img id="one" src="coffee.webp" alt="A cup" preview="nothing"></sg-img>')
    warnings = wait_until(page.complaints)
    assert len(warnings) == 1
    assert "sg-img has no preview" in warnings[0]
    page.run("document.getElementById('one').scrollIntoView()")
    wait_until(lambda: page.run(STATE)["loaded"])
    assert page.run(STATE)["drawn"] == 0


PREVIEWED = """
    const all = [...document.querySelectorAll("sg-img")];
    return all.flatMap((one, i) => (one.shadowRoot.querySelector("canvas") ? [i] : []));
"""


def test_only_previews_near_the_viewport_take_memory(each_browser: Page, site: Site) -> None:
    """They are drawn again when they come back; and those that reserve the space of their photographs stay."""
    each_browser.open(site.url)
    img = '<img src="none.webp" width="300" height="200" loading="lazy" alt="">'
    show(each_browser, f'<sg-img style="width: 300px" preview="{GOOD}">{img}</sg-img>' * 200)
    screen = each_browser.run("return innerHeight / document.querySelector('sg-img').offsetHeight")

    def drawn() -> list[int]:
        found: list[int] = each_browser.run(PREVIEWED)
        return found

    wait_until(lambda: 0 in drawn())
    assert len(drawn()) <= 3 * screen + 2
    each_browser.run("document.querySelector('sg-img:last-of-type').scrollIntoView()")
    wait_until(lambda: 199 in drawn() and 0 not in drawn())
    assert len(drawn()) <= 3 * screen + 2
    each_browser.run("scrollTo(0, 0)")
    wait_until(lambda: 0 in drawn() and 199 not in drawn())
    show(each_browser, f'<sg-img preview="{OTHER}"><img src="none.webp" alt=""></sg-img>' * 3)
    each_browser.run("scrollTo(0, document.body.scrollHeight)")
    wait_until(lambda: {0, 1, 2} < set(drawn()) and 202 in drawn())


# Each answers with what it sees of a new <sg-img>. Tag and property names are those of an <img>, which is the model.
HELP = f"""
    const turns = async () => {{ for (let i = 0; i < 3; i++) await new Promise((done) => setTimeout(done)); }};
    const [text, other, photo] = ["{GOOD}", "{OTHER}", "/cat.webp"];
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
            for (const name of names) one[name] = { preview: other, src: `/none${drawn.length}` }[name];
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
    "a placeholder": (  # stays until there is more to see, and leaves the page's own attribute as it is
        """
        const seen = [];
        for (const [preview, src] of [[text, photo], [text, "/none"], ["nothing", "/none"]]) {
            const html = `<sg-img preview="${preview}"><picture><img src="${src}"></picture></sg-img>`;
            const img = put(html).querySelector("img");
            img.style.backgroundImage = "url(data:image/webp;base64,AAAA)"; // as an attribute, the policy forbids it
            const style = img.getAttribute("style");
            if (src === photo) await loaded(img);
            await turns();
            seen.push(getComputedStyle(img).backgroundImage !== "none", img.getAttribute("style") === style);
        }
        return seen;""",
        [False, True, False, True, True, True],
    ),
    "moved into another document": (
        """
        const one = put(`<sg-img preview="${text}"></sg-img>`);
        frame().body.append(one);
        return [seen(one), seen(one.shadowRoot.firstElementChild)];""",
        ["grid", "grid"],
    ),
    "made here for another document": (
        """
        const one = Object.assign(document.createElement("sg-img"), { src: photo });
        frame().body.append(one);
        return [seen(one), inner(one).src];""",
        ["grid", "PHOTO"],
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


def test_it_is_as_an_img_and_leaves_what_is_not_its_own(each_browser: Page, site: Site) -> None:
    each_browser.open(site.url)
    early = f'Object.assign(document.createElement("sg-img"), {{ preview: "{GOOD}", src: "/cat.webp" }})'
    each_browser.run(f"window.EARLY = {early}; document.body.append(window.EARLY);")
    show(each_browser, "")
    tasks = ", ".join(f"async () => {{ {script} }}" for script, _ in OWNED.values())
    found = each_browser.run(f"""return (async () => {{
        {HELP}
        const answers = [];
        for (const task of [{tasks}]) answers.push(await task().catch(String));
        return answers;
    }})()""")
    photo = f"{site.url}cat.webp"
    expected = json.loads(json.dumps([value for _, value in OWNED.values()]).replace("PHOTO", photo))
    assert dict(zip(OWNED, found, strict=True)) == dict(zip(OWNED, expected, strict=True))
