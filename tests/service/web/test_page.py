"""The page, in a real browser, against a real service."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sgmethod
from service.keys import digest
from service.web.app import STATIC
from tests.harness.browser import Browser
from tests.harness.data import DATA, golden, golden_path
from tests.harness.pictures import SMALL
from tests.harness.processes import wait_until
from tests.harness.service import Service, StartService

OLD = golden_path("v3-color.sg").read_bytes()
COFFEE = (STATIC / "samples" / "coffee.sg").read_bytes()
COFFEE_SAYS = f"{sgmethod.info(COFFEE).gaussians:,} Gaussians"
FIRST_LOOK_BYTES = 150_000
SNIPPET_BYTES = 200_000
AXE = (DATA / "axe.min.js").read_text()


@pytest.fixture
def page(browser: Browser) -> Iterator[Browser]:
    """The browser, which has nothing to complain of yet, and is elsewhere afterwards."""
    browser.complaints()
    yield browser
    browser.open("about:blank")


def complaints(page: Browser) -> list[str]:
    """Without what WebGL in software makes the browser say, and looking at the canvas as these tests do."""
    return [said for said in page.complaints() if "WebGL" not in said and "getImageData" not in said]


def text64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def give(page: Browser, kind: str, data: bytes, name: str) -> None:
    """Drop a file onto the window, or paste it."""
    page.run(f"""
        const bytes = Uint8Array.from(atob("{text64(data)}"), (letter) => letter.charCodeAt(0));
        const given = new DataTransfer();
        given.items.add(new File([bytes], {json.dumps(name)}));
        const how = {{ cancelable: true, bubbles: true, dataTransfer: given, clipboardData: given }};
        dispatchEvent("{kind}" === "paste" ? new ClipboardEvent("paste", how) : new DragEvent("drop", how));
    """)


def says(page: Browser, words: str, where: str = "#status") -> None:
    wait_until(lambda: words in page.text(where))


def open_page(page: Browser, service: Service) -> None:
    """Until its first sample is there."""
    page.open(f"{service.url}/")
    wait_until(lambda: page.is_seen("#right-label"))


def shown(page: Browser) -> np.ndarray[Any, Any]:
    """The middle row of what is on the large canvas: RGB."""
    row = page.run("""
        const canvas = document.getElementById("canvas");
        const middle = canvas.getContext("2d").getImageData(0, canvas.height >> 1, canvas.width, 1).data;
        return [...middle];
    """)
    return np.array(row).reshape(-1, 4)[:, :3]


def settled(page: Browser) -> np.ndarray[Any, Any]:
    """The same, once it has been drawn."""
    page.run("return new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return shown(page)


def test_first_look_compare_and_zoom(page: Browser, web: Service) -> None:
    page.open("about:blank")
    open_page(page, web)
    says(page, "AVIF", "#verdict")
    sizes = page.run("return performance.getEntriesByType('resource').map((one) => [one.name, one.transferSize])")
    before_sample = [size for name, size in sizes if not name.endswith(("webp", "avif"))]
    assert sum(before_sample) < FIRST_LOOK_BYTES
    assert all(name.startswith(web.url) for name, _ in sizes)
    assert "Original" in page.text("#left-label")
    assert "4.7 kB" in page.text("#right-label")
    assert [name in page.text("#rivals") for name in ("Original", "Gaussians", "JPEG", "WebP", "AVIF")] == [True] * 5

    both = settled(page)
    page.run("document.getElementById('divider').dispatchEvent(new KeyboardEvent('keydown', { key: 'Home' }))")
    ours = settled(page)
    page.run("document.getElementById('divider').dispatchEvent(new KeyboardEvent('keydown', { key: 'End' }))")
    original = settled(page)
    half = len(both) // 2
    assert (both[: half - 2] == original[: half - 2]).all()
    assert (both[half + 2 :] == ours[half + 2 :]).all()
    assert 0 < np.abs(ours.astype(int) - original).mean() < 10

    wheel = "document.getElementById('stage').dispatchEvent(new WheelEvent('wheel', { deltaY: -2000, clientX: 300, "
    page.run(wheel + "clientY: 300, cancelable: true }))")
    blocks = settled(page)
    assert page.text("#zoom") == "6400 %"
    steps = np.abs(np.diff(blocks.astype(int), axis=0)).sum(1)
    assert (steps > 0).sum() <= len(blocks) // 64 + 2  # whole pixels of the original
    page.run("document.getElementById('divider').dispatchEvent(new KeyboardEvent('keydown', { key: 'Home' }))")
    wait_until(lambda: np.abs(np.diff(settled(page).astype(int), axis=0)).max() <= 6)  # 1 here; 42 in the original
    page.click("#zoom-fit")

    page.run(
        "const prefix = document.getElementById('prefix'); prefix.value = 5; prefix.dispatchEvent(new Event('input'))"
    )
    assert re.search(r"the first 2\d\d B of 4\.7 kB", page.text("#right-label"))
    wait_until(lambda: np.abs(settled(page).astype(int) - ours).mean() > 10)
    page.run("document.querySelector('[value=ellipses]').click()")
    says(page, "one standard deviation", "#legend")
    page.run("document.querySelector('[value=heat]').click()")
    says(page, "bits per pixel", "#legend")
    page.click("#sample-cat")
    says(page, "5.4 kB", "#right-label")
    assert complaints(page) == []


def test_a_photograph_that_is_dropped(page: Browser, service: Service) -> None:
    open_page(page, service)
    give(page, "drop", SMALL, "my disc.png")
    says(page, "Gaussians", "#right-label")
    assert page.text("#left-label").startswith("Original")
    wait_until(lambda: "WebP" in page.text("#rivals"))
    (job,) = service.client.get("/jobs").json()["jobs"]
    assert f"{job['result']['gaussians']} Gaussians" in page.text("#figures")
    assert page.run("return location.hash") == f"#{job['id']}"
    assert not page.is_seen("#work")
    lines = page.run("return [...document.querySelectorAll('pre')].map((one) => one.textContent)")
    assert "-F image=@my_disc.png -F bpp=0.3" in lines[0]
    assert 'sgmethod.encode("my_disc.png", bpp=0.3' in lines[1]
    page.open("about:blank")
    page.open(f"{service.url}/#{job['id']}")  # as it stands in the address when the page is loaded again
    says(page, "Gaussians", "#right-label")
    says(page, "Original", "#left-label")  # the browser has kept it
    assert complaints(page) == []


def test_one_that_is_pasted_and_cancelled(page: Browser, web: Service) -> None:
    open_page(page, web)
    give(page, "paste", SMALL, "pasted.png")
    says(page, "in the queue")
    page.click("#cancel")
    says(page, "Cancelled", "#work")
    assert page.run("return document.getElementById('work').className") == "card"
    assert not page.is_seen("#cancel")
    assert web.client.get("/jobs?state=queued").json()["jobs"] == []


def test_files_of_gaussians_are_opened(page: Browser, web: Service) -> None:
    open_page(page, web)
    give(page, "drop", COFFEE, "my coffee.sg")
    says(page, COFFEE_SAYS, "#figures")
    assert page.run("return performance.getEntriesByName(location.origin + '/decode.png?').length") == 0
    give(page, "drop", OLD, "old.sg")
    says(page, "Drawn by the service", "#note")
    says(page, "48 × 40 pixels", "#figures")
    page.click("#rows li:first-child .pick")
    says(page, COFFEE_SAYS, "#figures")
    give(page, "drop", COFFEE[:-1], "cut.sg")
    says(page, "the file is damaged")
    assert complaints(page) == []


def test_requests_for_people(page: Browser, web: Service) -> None:
    """Under the strict policy, and from nowhere else."""
    document = web.client.get("/openapi.json").json()
    operations = {what["operationId"]: what for methods in document["paths"].values() for what in methods.values()}
    page.open(f"{web.url}/docs")
    shown = "return document.querySelectorAll('#operations details').length"
    wait_until(lambda: page.run(shown) > len(operations))  # and examples after them
    for name, operation in operations.items():
        assert operation["summary"] in page.text(f"#{name} summary")
    first = next(iter(operations))
    assert not page.is_seen(f"#{first} pre")
    page.click(f"#{first} summary")
    assert f"curl {web.url}/livez" in page.text(f"#{first} pre")
    assert "200" in page.text(f"#{first} table")
    assert page.complaints() == []


def test_what_is_refused(page: Browser, web: Service) -> None:
    open_page(page, web)
    give(page, "drop", b"%PDF-1.7", "text.pdf")
    says(page, "text.pdf is a PDF", "#trouble")
    assert complaints(page) == []
    give(page, "drop", b"this is no picture", "words.png")
    says(page, "not a PNG")
    assert [page.is_seen(part) for part in ("#progress", "#chart", "#cancel")] == [False] * 3
    (complaint,) = complaints(page)
    assert "415" in complaint
    page.type("#file", str(golden_path("v1-paper.png")))
    says(page, "in the queue")


def test_with_a_key(page: Browser, start_service: StartService) -> None:
    web = start_service("web", api_keys=f"ann:{digest('secret')}")
    open_page(page, web)
    give(page, "drop", SMALL, "disc.png")
    says(page, "needs an API key")
    page.type("#key", "wrong")
    page.click("#again")
    says(page, "not known")
    assert all("401" in complaint for complaint in complaints(page))
    page.run("document.getElementById('key').value = ''")
    page.type("#key", "secret")
    page.click("#again")
    says(page, "in the queue")
    page.open("about:blank")
    page.open(f"{web.url}/#{web.published(COFFEE, 'ann')}")  # the key is remembered until the window is closed
    says(page, COFFEE_SAYS, "#figures")


def test_a_service_that_restarts_meanwhile(page: Browser, start_service: StartService) -> None:
    service = start_service("web")
    open_page(page, service)
    give(page, "drop", SMALL, "disc.png")
    says(page, "in the queue")
    service.environment["SG_PORT"] = service.url.rpartition(":")[2]
    assert service.stop() == 0
    says(page, "trying again")
    service.start()
    says(page, "in the queue")
    assert all("ERR_" in complaint or "Failed to load" in complaint for complaint in complaints(page))


def test_nobody_is_left_out(page: Browser, web: Service) -> None:
    open_page(page, web)
    says(page, "AVIF", "#verdict")
    page.run("for (const one of document.querySelectorAll('details')) one.open = true")
    page.run(AXE)
    for scheme in ("light", "dark"):
        page.prefer(scheme)
        passed, findings = page.run("""
            return axe.run().then(({ passes, violations }) => [
                passes.length, violations.map(({ id, nodes }) => [id, ...nodes.map(({ target }) => target.join(" "))])
            ]);
        """)
        assert passed > 20
        assert findings == []


def decoded(page: Browser, data: bytes, options: str = "{}") -> np.ndarray[Any, Any]:
    """By the decoder of the page: RGB."""
    text = page.run(f"""
        const bytes = Uint8Array.from(atob("{text64(data)}"), (letter) => letter.charCodeAt(0));
        return import("/static/decoder/decoder.js").then(({{ decode }}) => {{
            const {{ width, height, data }} = decode(bytes, {options});
            return [width, height, [...data].map((level) => String.fromCharCode(level)).join("")];
        }});
    """)
    width, height, levels = text
    return np.frombuffer(levels.encode("latin-1"), np.uint8).reshape(height, width, 4)[..., :3]


def assert_same(page: Browser, data: bytes, options: str, **view: Any) -> None:
    """Within what docs/format.md allows two decoders: one level, and seldom. 1 sample of 12,960 is the most seen."""
    ours = decoded(page, data, options).astype(int)
    expected = sgmethod.open(data).pixels(**view)
    assert ours.shape == expected.shape
    difference = np.abs(ours - expected)
    assert difference.max() <= 1
    assert np.count_nonzero(difference) <= max(1, difference.size // 10_000)


def test_the_decoder_of_the_page(page: Browser, web: Service) -> None:
    open_page(page, web)
    for data in golden(4).values():
        assert_same(page, data, "{}")
    assert_same(page, COFFEE, "{}")
    assert_same(page, COFFEE, "{ scale: 0.3 }", scale=0.3)
    assert_same(page, COFFEE, "{ scale: 3, region: [100, 50, 60, 40] }", scale=3, region=(100, 50, 60, 40))
    assert_same(page, COFFEE, "{ prefix: 0.2 }", prefix=0.2)
    assert_same(page, golden(4)["v4-texture"], "{ scale: 0.4 }", scale=0.4)
    assert_same(page, golden(4)["v4-texture"], "{ scale: 2, region: [5, 60, 50, 90] }", scale=2, region=(5, 60, 50, 90))
    for hostile in (OLD, COFFEE[:100], b"", COFFEE[:-1] + b"\1"):
        with pytest.raises(AssertionError, match=r"not known here|is damaged|no \.sg file"):
            decoded(page, hostile)


def test_webgl_draws_what_the_decoder_does(page: Browser, web: Service) -> None:
    open_page(page, web)
    levels = page.run("""
        return (async () => {
            const { openGpu } = await import("/static/viewer/gpu.js");
            const { readFile } = await import("/static/decoder/file.js");
            const file = readFile(new Uint8Array(await (await fetch("/static/samples/coffee.sg")).arrayBuffer()));
            const context = new OffscreenCanvas(864, 576).getContext("2d", { willReadFrequently: true });
            context.drawImage(openGpu().draw(file, file.count, [0, 0], 2, 864, 576), 0, 0);
            const { data } = context.getImageData(0, 0, 864, 576);
            return [...data].map((level) => String.fromCharCode(level)).join("");
        })();
    """)
    drawn = np.frombuffer(levels.encode("latin-1"), np.uint8).reshape(576, 864, 4)[..., :3].astype(int)
    difference = np.abs(drawn - sgmethod.open(COFFEE).pixels(scale=2))
    # WebGL draws no pyramid, which is a little off; the worst seen are 5 levels, 0.34 in the mean.
    assert difference.max() <= 8
    assert difference.mean() < 0.5


def test_html_that_shows_a_picture(page: Browser, web: Service, tmp_path: Path) -> None:
    open_page(page, web)
    html = page.run("""
        return (async () => {
            const { snippetOf } = await import("/static/page/taking.js");
            const sg = new Uint8Array(await (await fetch("/static/samples/coffee.sg")).arrayBuffer());
            return snippetOf({ sg, size: [432, 288] });
        })();
    """)
    assert len(html) < SNIPPET_BYTES
    alone = tmp_path / "alone.html"
    alone.write_text(html)
    page.complaints()
    page.open(alone.as_uri())
    pixel = "return [...document.querySelector('canvas').getContext('2d').getImageData(200, 100, 1, 1).data]"
    wait_until(lambda: page.run(pixel)[3] == 255)
    assert np.abs(np.array(page.run(pixel)[:3]) - sgmethod.decode(COFFEE)[100, 200]).max() <= 1
    assert complaints(page) == []
