"""What the tests of the page do in a browser: give files, look, wait."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

import sgmethod
from tests.harness.browser import Browser
from tests.harness.data import DATA, STATIC, golden_path
from tests.harness.processes import wait_until
from tests.harness.service import Service

OTHER = golden_path("v1-paper.sg").read_bytes()  # which the page does not read
COFFEE = (STATIC / "samples" / "coffee.sg").read_bytes()
AXE = (DATA / "axe.min.js").read_text()
COFFEE_SAYS = f"{sgmethod.info(COFFEE).gaussians:,} Gaussians"


def complaints(page: Browser) -> list[str]:
    """Without what WebGL in software makes the browser say, and looking at the canvas as these tests do."""
    return [said for said in page.complaints() if "WebGL" not in said and "getImageData" not in said]


def bytes_of(data: bytes) -> str:
    """An expression of JavaScript."""
    return f'Uint8Array.from(atob("{base64.b64encode(data).decode()}"), (letter) => letter.charCodeAt(0))'


def give(page: Browser, kind: str, data: bytes, name: str) -> None:
    """Drop a file onto the window, or paste it."""
    page.run(f"""
        const given = new DataTransfer();
        given.items.add(new File([{bytes_of(data)}], {json.dumps(name)}));
        const how = {{ cancelable: true, bubbles: true, dataTransfer: given, clipboardData: given }};
        dispatchEvent("{kind}" === "paste" ? new ClipboardEvent("paste", how) : new DragEvent("drop", how));
    """)


def queued(page: Browser, data: bytes, name: str, kind: str = "drop") -> str:
    """Give a picture; the id of its job, which waits, and which the address names."""
    give(page, kind, data, name)
    says(page, "in the queue")
    return str(page.run("return location.hash.slice(1)"))


def cancel(page: Browser) -> None:
    page.click("#cancel")
    says(page, "Cancelled", "#work")


def press(page: Browser, part: str, key: str, kind: str = "keydown") -> None:
    page.run(f"document.getElementById('{part}').dispatchEvent(new KeyboardEvent('{kind}', {{ key: '{key}' }}))")


def choose(page: Browser, field: str, value: object) -> None:
    """Change what a field says, as a person does."""
    page.run(f"""
        const field = document.getElementById("{field}");
        field.value = {json.dumps(value)};
        for (const kind of ["input", "change"]) field.dispatchEvent(new Event(kind, {{ bubbles: true }}));
    """)


def value_of(page: Browser, field: str) -> str:
    return str(page.run(f"return document.getElementById('{field}').value"))


def zoom_in(page: Browser) -> None:
    """As far as it goes."""
    wheel = "{ deltaY: -2000, clientX: 300, clientY: 300, cancelable: true }"
    page.run(f"document.getElementById('stage').dispatchEvent(new WheelEvent('wheel', {wheel}))")


def imported(page: Browser, module: str, expression: str) -> Any:
    """The value of an expression of what a module of the page exports, as `it`."""
    return page.run(f"return import('/static/{module}').then((it) => {expression})")


def assert_open_to_all(page: Browser, place: str = "document", least: int = 10, found: str = "violations") -> None:
    """No finding of axe, with all parts of a place open, neither by day nor by night."""
    page.run("for (const one of document.querySelectorAll('details')) one.open = true")
    page.run(AXE)
    for scheme in ("light", "dark"):
        page.prefer(scheme)
        passed, findings = page.run(f"""
            return axe.run({place}).then(({{ passes, violations, incomplete }}) => [passes.length, {found}
                .map(({{ id, nodes }}) => [id, ...nodes.map(({{ target }}) => target.join(" "))])]);
        """)
        assert passed > least
        assert findings == []


def hold_back(page: Browser, ending: str) -> None:
    """Let requests for what ends so, but those that remove it, wait until window.goOn() is called."""
    page.run(f"""
        const get = fetch;
        const late = new Promise((goOn) => {{ window.goOn = goOn; }});
        window.fetch = async (url, options) => {{
            if (String(url).endsWith("{ending}") && options?.method !== "DELETE") await late;
            return get(url, options);
        }};
    """)


def says(page: Browser, words: str, where: str = "#status") -> None:
    wait_until(lambda: words in page.text(where))


def open_page(page: Browser, service: Service) -> None:
    """Until its first sample is there, its original too."""
    page.open(f"{service.url}/")
    wait_until(lambda: page.is_seen("#right-label") and page.is_seen("#left-label"))


def open_blank(page: Browser, service: Service) -> None:
    """A page of the service on which nothing is drawn: enough for a test of a module alone."""
    page.open(f"{service.url}/docs")


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


def decoded(page: Browser, data: bytes, options: str = "{}") -> np.ndarray[Any, Any]:
    """By the decoder of the page: RGBA."""
    width, height, levels = page.run(f"""
        return import("/static/sgmethod/decoder.js").then(({{ decode }}) => {{
            const {{ width, height, data }} = decode({bytes_of(data)}, {options});
            return [width, height, [...data].map((level) => String.fromCharCode(level)).join("")];
        }});
    """)
    return np.frombuffer(levels.encode("latin-1"), np.uint8).reshape(height, width, 4)


def assert_as_python(ours: np.ndarray, data: bytes, **view: Any) -> None:
    """Samples [H, W, 4] of a view of the file, as signed integers, within what docs/format.md allows two decoders: one
    level, and seldom. 1 sample of 12,960 is the most seen."""
    expected = sgmethod.open(data).pixels(**view)
    if expected.shape[2] == 3:
        expected = np.dstack([expected, np.full(expected.shape[:2], 255)])
    assert ours.shape == expected.shape
    difference = np.abs(ours - expected)
    assert difference.max() <= 1
    assert np.count_nonzero(difference) <= max(1, difference.size // 10_000)
