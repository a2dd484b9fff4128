"""The page when things come at a bad moment, or are not as they should be."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from tests.service.page.steps import COFFEE, COFFEE_SAYS, OTHER
from tests.support.browser import Chromium, assert_open_to_all, bytes_of
from tests.support.data import golden
from tests.support.node import assert_as_python
from tests.support.pictures import SMALL, saved
from tests.support.processes import wait_until
from tests.support.service import Service

pytestmark = pytest.mark.thorough


def see_through() -> bytes:
    """A picture that is clear on the left."""
    picture = Image.new("RGBA", (64, 48), (10, 90, 200, 255))
    picture.paste((0, 0, 0, 0), (0, 0, 32, 48))
    return saved(picture)


def test_a_file_that_cannot_be_read_is_not_the_end(page: Chromium, web: Service) -> None:
    """As a folder that is dropped with others."""
    page.open_page(web)
    page.run(f"""
        const slice = Blob.prototype.slice;
        Blob.prototype.slice = function (...given) {{
            if (this.name === "folder") throw new DOMException("no file", "NotFoundError");
            return slice.apply(this, given);
        }};
        const given = new DataTransfer();
        given.items.add(new File(["?"], "folder"));
        given.items.add(new File(["%PDF-1.7"], "text.pdf"));
        given.items.add(new File([{bytes_of(SMALL)}], "one.png"));
        dispatchEvent(new DragEvent("drop", {{ cancelable: true, bubbles: true, dataTransfer: given }}));
    """)
    page.says("folder cannot be read. text.pdf is a PDF", "#trouble")
    page.says("in the queue")
    page.cancel()


def test_each_aim_has_its_own_value(page: Chromium, web: Service) -> None:
    def aim(kind: str) -> str:
        page.choose("aim", kind)
        return page.value_of("aim-value")

    page.open_page(web)
    try:
        assert aim("bytes") == "20000"
        page.choose("aim-value", "15000")
        assert aim("psnr") == "32"
        page.open_page(web)
        assert page.value_of("aim-value") == "32"
        assert aim("bytes") == "15000"
    finally:
        page.run("localStorage.clear()")


def test_a_browser_that_blocks_site_data(page: Chromium, web: Service) -> None:
    """To reach its storages throws."""
    block = "Object.defineProperty(window, name, { get() { throw new DOMException('blocked', 'SecurityError'); } })"
    source = f"for (const name of ['localStorage', 'sessionStorage']) {block};"
    script = page.tell("Page.addScriptToEvaluateOnNewDocument", source=source)
    try:
        page.open_page(web)
        page.choose("aim", "bytes")
        page.choose("aim-value", "15000")
        page.choose("aim", "psnr")
        page.choose("aim", "bytes")
        assert page.value_of("aim-value") == "15000"  # until the page is left
        assert page.complaints() == []
    finally:
        page.tell("Page.removeScriptToEvaluateOnNewDocument", **script)


def test_a_browser_whose_database_never_answers(page: Chromium, web: Service) -> None:
    """The page waited for it with a picture at hand."""
    script = page.tell("Page.addScriptToEvaluateOnNewDocument", source="IDBFactory.prototype.open = () => ({});")
    try:
        page.open("about:blank")
        page.open(f"{web.url}/#{web.published(COFFEE)}")
        page.says(COFFEE_SAYS, "#prefix-words")
    finally:
        page.tell("Page.removeScriptToEvaluateOnNewDocument", **script)


def test_while_the_service_cannot_be_reached(page: Chromium, web: Service) -> None:
    """One sentence says so, and a sample that did not come is asked for again."""
    page.open_page(web)
    page.says("5.4 kB", "#sample-cat")  # the last one whose button is drawn
    page.run("""
        const get = fetch;
        window.fetch = (...given) => (window.isBack ? get(...given) : Promise.reject(new TypeError("offline")));
    """)
    page.give("drop", OTHER, "other.sg")
    page.says("reached")
    assert page.text("#status") == "The file cannot be opened: The service cannot be reached."
    page.click("#sample-cat")
    page.says("The service cannot be reached.", "#trouble")
    page.run("window.isBack = true")
    page.click("#sample-cat")
    page.says("5.4 kB", "#right-label")
    page.says("Original", "#left-label")


def test_a_format_that_this_service_cannot_read(page: Chromium, web: Service) -> None:
    """Who visits it cannot install what its answer asks for."""
    page.open_page(web)
    page.run("""
        const get = fetch;
        const refusal = () => Response.json({ detail: "reading HEIC files needs an extra package" }, { status: 415 });
        window.fetch = async (url, options) => (String(url).endsWith("/encode") ? refusal() : get(url, options));
    """)
    page.give("drop", b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "photo.heic")
    page.says("This service cannot read HEIC pictures. Save or share this one as JPEG first.")
    assert not page.is_seen("#again")


def test_a_width_typed_before_the_original_is_there(page: Chromium, web: Service) -> None:
    page.open_page(web)
    page.hold_back(".webp")
    page.click("#sample-cat")
    page.says("5.4 kB", "#right-label")
    assert not page.is_seen("#left-label")
    page.run("document.getElementById('width').value = 321")
    page.run("goOn()")
    wait_until(lambda: page.is_seen("#left-label"))
    assert page.value_of("width") == "321"


def test_blinking_by_keyboard(page: Chromium, web: Service) -> None:
    page.open_page(web)
    page.says("Original", "#left-label")
    seen = "return getComputedStyle(document.getElementById('right-label')).visibility"
    for key in (" ", "Enter"):
        page.press("blink", key)
        assert page.run(seen) == "hidden"
        page.press("blink", key, "keyup")
        assert page.run(seen) == "visible"
    page.press("blink", " ")
    page.run("dispatchEvent(new Event('blur'))")  # the window's, by the keys that change it
    assert page.run(seen) == "visible"
    for part, state in (("stage", "hidden"), ("zoom-fit", "visible")):  # a letter alone is a key of the picture
        page.run(f"document.getElementById('{part}').focus()")
        page.tell("Input.dispatchKeyEvent", type="keyDown", key="b")
        assert page.run(seen) == state
        page.tell("Input.dispatchKeyEvent", type="keyUp", key="b")
        assert page.run(seen) == "visible"


def test_the_divider_by_keyboard(page: Chromium, web: Service) -> None:
    page.open_page(web)
    for key, place in (("ArrowUp", "52"), ("ArrowRight", "54"), ("ArrowDown", "52"), ("ArrowLeft", "50")):
        page.press("divider", key)
        page.settled()
        assert page.run("return document.getElementById('divider').getAttribute('aria-valuenow')") == place


def test_a_button_is_clicked_however_long_it_is_pressed(page: Chromium, web: Service) -> None:
    """What it stands in is made anew whenever a job is looked at."""
    page.open_page(web)
    for name in ("one.png", "two.png"):
        page.queued(SMALL, name)
    page.says("two.png", "#rows")
    x, y = page.run("""
        const button = document.querySelector("#rows li:last-child .pick");
        button.scrollIntoView({ block: "center" });
        const { x, y, width, height } = button.getBoundingClientRect();
        return [x + width / 2, y + height / 2];
    """)
    asked = "return performance.getEntriesByType('resource').filter(({ name }) => name.includes('/jobs/')).length"
    before = page.run(asked)
    where = {"x": x, "y": y, "button": "left", "clickCount": 1}
    page.tell("Input.dispatchMouseEvent", type="mousePressed", **where)
    wait_until(lambda: page.run(asked) >= before + 4)
    page.tell("Input.dispatchMouseEvent", type="mouseReleased", **where)
    wait_until(lambda: page.run("return document.querySelector('#rows li:last-child .pick').ariaPressed") == "true")
    web.clear()


def test_a_link_of_somebody_else(page: Chromium, web: Service) -> None:
    """There is no original, neither while its job waits nor afterwards."""
    job_id = web.submitted()
    page.open(f"{web.url}/#{job_id}")
    page.says("in the queue")
    assert page.text("#zoom") == ""
    web.publish(job_id, COFFEE)
    page.says("Shared: the original is not part of the link", "#note")
    assert page.text("#zoom").endswith("%")
    assert not page.is_seen("#divider")
    assert page.run("return document.getElementById('blink').disabled")
    web.clear()


def test_an_opened_file_is_there_after_a_reload(page: Chromium, web: Service) -> None:
    page.open_page(web)
    page.give("drop", COFFEE, "my coffee.sg")
    page.says(COFFEE_SAYS, "#prefix-words")
    address = page.run("return location.href")
    wait_until(lambda: page.imported("storage.js", "it.kept(location.hash.slice(1)).then(Boolean)"))
    page.open("about:blank")
    page.open(address)
    page.says(COFFEE_SAYS, "#prefix-words")
    assert page.run("return location.href") == address
    for unknown, words in (("file-unknown", "no longer has this file"), ("5f1c0e9a", "No picture has this address")):
        page.open("about:blank")
        page.open(f"{web.url}/#{unknown}")
        page.says(words, "#work")
        assert not page.is_seen("#stage")
    assert page.complaints() == []


def test_what_the_browser_cannot_read_is_sent_only_if_it_ought_to_know(page: Chromium, web: Service) -> None:
    page.open_page(web)
    sent = "return performance.getEntriesByName(location.origin + '/encode').length"
    page.give("drop", SMALL[:-300], "cut.png")
    page.says("This PNG is damaged, or too large for this browser.")
    assert page.run(sent) == 0
    assert page.text("#again") == "Send it anyway"
    page.click("#again")
    page.says("in the queue")
    page.click("#cancel")
    page.queued(saved(Image.new("RGB", (64, 48), "green"), "TIFF"), "green.tif")
    assert "cannot show the original" in page.text("#note")
    page.click("#cancel")


def test_what_a_waiting_job_says(page: Chromium, web: Service) -> None:
    page.open_blank(web)
    states = "[1, 3].map((position) => it.stateOf({ state: 'queued', position }).words)"
    words = page.imported("progress.js", states)
    assert words == ["Waiting: next in the queue", "Waiting: in the queue, 2 before it"]
    assert page.imported("words.js", "[0.2, 59.7, 119.7].map(it.seconds)") == ["1 s", "1 min 0 s", "2 min 0 s"]


def test_on_a_phone(page: Chromium, web: Service) -> None:
    """What ends an encode is on the first screen, and nothing covers the picture. Transparency is shown on white."""
    screen = {"width": 390, "height": 664, "deviceScaleFactor": 1, "mobile": True}
    page.tell("Emulation.setDeviceMetricsOverride", **screen)
    page.open_page(web)
    page.tell("Page.setInterceptFileChooserDialog", enabled=True)
    page.click("#choose")
    assert page.run("return scrollY") == 0
    assert page.run("return document.getElementById('tools').getBoundingClientRect().height") < 90  # two rows
    page.queued(see_through(), "clear.png")
    row = page.settled()
    assert row[len(row) // 3].tolist() == [255, 255, 255]
    assert row[2 * len(row) // 3].tolist() == [10, 90, 200]
    low, stage, *words = page.run("""
        const box = (id) => document.getElementById(id).getBoundingClientRect();
        const words = ["left-label", "right-label", "note", "work"].map(box).filter(({ height }) => height);
        return [box("cancel").bottom, box("stage").bottom, ...words.map(({ top }) => top)];
    """)
    assert low <= screen["height"]
    assert len(words) == 3  # there is nothing of ours yet
    assert min(words) >= stage
    assert page.run("return document.documentElement.scrollWidth") == screen["width"]
    page.click("#cancel")
    page.says("stay transparent in the file", "#note")
    assert page.complaints() == []


def test_downloads_are_confirmed(page: Chromium, web: Service) -> None:
    page.open_page(web)
    page.says("AVIF", "#verdict")  # buttons move until then
    page.run("HTMLAnchorElement.prototype.click = function () { window.saved = this.download; }")
    page.click("#link")
    page.says("The link is in the clipboard", "#taken")
    page.click("#save-sg")
    page.says("Downloaded coffee.sg, 9.0 kB.", "#taken")
    page.click("#save-picture")
    page.says("Downloaded coffee.png", "#taken")
    assert page.run("return window.saved") == "coffee.png"
    for width in (1, 20_000):
        page.run(f"document.getElementById('width').value = {width}")
        page.click("#save-picture")
        page.says("the width must be between 10 and 8660 pixels", "#taken")
        page.run("document.getElementById('taken').textContent = ''")
    page.run("Object.defineProperty(navigator, 'clipboard', { value: undefined })")  # as over plain HTTP
    page.click("#link")
    page.says("is in the clipboard", "#taken")
    page.click("#sample-cat")
    assert page.text("#taken") == ""


def test_what_is_saved_stays_transparent(page: Chromium, web: Service) -> None:
    data = golden(2)["v2-alpha"]
    page.open_page(web)
    page.give("drop", data, "clear.sg")
    page.says(f"{len(data)} B", "#right-label")
    page.run("""
        HTMLAnchorElement.prototype.click = () => undefined;
        const made = URL.createObjectURL;
        URL.createObjectURL = (blob) => { window.blob = blob; return made(blob); };
    """)
    page.click("#save-picture")
    page.says("Downloaded clear.png", "#taken")
    png = page.run("return window.blob.arrayBuffer().then((buffer) => [...new Uint8Array(buffer)])")
    assert_as_python(np.array(Image.open(io.BytesIO(bytes(png)))).astype(int), data)


def test_requests_for_people(page: Chromium, web: Service) -> None:
    """Under the strict policy, and from nowhere else. Links on a dark ground had too little contrast."""
    document = web.client.get("/openapi.json").json()
    operations = {what["operationId"]: what for methods in document["paths"].values() for what in methods.values()}
    page.open(f"{web.url}/docs")
    shown = "return document.querySelectorAll('#operations details').length"
    wait_until(lambda: page.run(shown) > len(operations))  # and the fields of answers after them
    assert page.text("#operations summary").startswith("POST /encode ")
    for name, operation in operations.items():
        assert operation["summary"] in page.text(f"#{name} summary")
    first = next(iter(operations))
    assert not page.is_seen(f"#{first} pre")
    page.click(f"#{first} summary")
    assert f"'{web.url}/encode?wait=50'" in page.text(f"#{first} pre")
    assert "202" in page.text(f"#{first} table:last-of-type")
    assert_open_to_all(page, found="[...violations, ...incomplete]")
    assert page.complaints() == []
