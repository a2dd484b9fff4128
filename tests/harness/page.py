"""A window of a browser, and what tests do in it: open the page, give it files, look, wait."""

from __future__ import annotations

import base64
import json
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.harness.processes import wait_until
from tests.harness.service import Service

ELEMENT = "element-6066-11e4-a52e-4f735466cecf"  # WebDriver's name for a reference to one


def bytes_of(data: bytes) -> str:
    """An expression of JavaScript."""
    return f'Uint8Array.from(atob("{base64.b64encode(data).decode()}"), (letter) => letter.charCodeAt(0))'


class Page(ABC):
    """One window."""

    @abstractmethod
    def _do(self, command: str, **given: Any) -> Any:
        """What one of browser.COMMANDS comes to. Raises AssertionError if the browser refuses."""

    @abstractmethod
    def _console(self) -> list[str]:
        """What the console has said since the last call: errors of scripts, policies that were broken."""

    @abstractmethod
    def close(self) -> None:
        """End the browser."""

    def open(self, url: str) -> None:
        """Load a page."""
        self._do("open", url=url)

    def open_page(self, service: Service) -> None:
        """Until its first sample is there, its original too."""
        self.open(f"{service.url}/")
        wait_until(lambda: self.is_seen("#right-label") and self.is_seen("#left-label"))

    def open_blank(self, service: Service) -> None:
        """A page of the service on which nothing is drawn: enough for a test of a module alone."""
        self.open(f"{service.url}/docs")

    def _element(self, selector: str) -> str:
        return str(self._do("find", using="css selector", value=selector)[ELEMENT])

    def type(self, selector: str, text: str) -> None:
        """Type into a field; into one for files, the path of a file."""
        self._do("type", id=self._element(selector), text=text)

    def click(self, selector: str) -> None:
        """Click, as a person can: what is hidden or covered raises AssertionError."""
        self._do("click", id=self._element(selector))

    def text(self, selector: str) -> str:
        """The text of an element as it is seen, empty where it is hidden."""
        return str(self._do("text", id=self._element(selector)))

    def is_seen(self, selector: str) -> bool:
        """Whether an element is displayed."""
        return bool(self._do("is_seen", id=self._element(selector)))

    def run(self, script: str) -> Any:
        """What a script returns."""
        return self._do("run", script=script, args=[])

    def complaints(self) -> list[str]:
        """What the console has said since the last call, without what WebGL in software makes the browser say, and
        looking at the canvas as these tests do.
        """
        return [said for said in self._console() if "WebGL" not in said and "getImageData" not in said]

    def says(self, words: str, where: str = "#status") -> None:
        """Wait until an element says so."""
        try:
            wait_until(lambda: words in self.text(where))
        except AssertionError:
            raise AssertionError(f"{where} says {self.text(where)!r}, and not {words!r}") from None

    def give(self, kind: str, data: bytes, name: str) -> None:
        """Drop a file onto the window, or paste it."""
        self.run(f"""
            const given = new DataTransfer();
            given.items.add(new File([{bytes_of(data)}], {json.dumps(name)}));
            const how = {{ cancelable: true, bubbles: true, dataTransfer: given, clipboardData: given }};
            dispatchEvent("{kind}" === "paste" ? new ClipboardEvent("paste", how) : new DragEvent("drop", how));
        """)

    def queued(self, data: bytes, name: str, kind: str = "drop") -> str:
        """Give a picture; the id of its job, which waits, and which the address names."""
        self.give(kind, data, name)
        self.says("in the queue")
        return str(self.run("return location.hash.slice(1)"))

    def cancel(self) -> None:
        """Cancel the job that is shown."""
        self.click("#cancel")
        self.says("Cancelled", "#work")

    def press(self, part: str, key: str, kind: str = "keydown") -> None:
        """Press a key where a part has the focus; kind "keyup" releases it."""
        self.run(f"document.getElementById('{part}').dispatchEvent(new KeyboardEvent('{kind}', {{ key: '{key}' }}))")

    def choose(self, field: str, value: object) -> None:
        """Change what a field says, as a person does."""
        self.run(f"""
            const field = document.getElementById("{field}");
            field.value = {json.dumps(value)};
            for (const kind of ["input", "change"]) field.dispatchEvent(new Event(kind, {{ bubbles: true }}));
        """)

    def value_of(self, field: str) -> str:
        """What a field says."""
        return str(self.run(f"return document.getElementById('{field}').value"))

    def zoom_in(self) -> None:
        """As far as it goes."""
        wheel = "{ deltaY: -3000, clientX: 300, clientY: 300, cancelable: true }"
        self.run(f"document.getElementById('stage').dispatchEvent(new WheelEvent('wheel', {wheel}))")

    def imported(self, module: str, expression: str) -> Any:
        """The value of an expression of what a module of the page exports, as `it`."""
        return self.run(f"return import('/static/{module}').then((it) => {expression})")

    def hold_back(self, ending: str) -> None:
        """Let requests for what ends so, but those that remove it, wait until window.goOn() is called."""
        self.run(f"""
            const get = fetch;
            const late = new Promise((goOn) => {{ window.goOn = goOn; }});
            window.fetch = async (url, options) => {{
                if (String(url).endsWith("{ending}") && options?.method !== "DELETE") await late;
                return get(url, options);
            }};
        """)

    def settled(self) -> NDArray[np.int64]:
        """The middle row of what is on the large canvas, once it has been drawn: RGB."""
        row = self.run("""
            const drawn = (done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done)));
            return new Promise(drawn).then(() => {
                const canvas = document.getElementById("canvas");
                return [...canvas.getContext("2d").getImageData(0, canvas.height >> 1, canvas.width, 1).data];
            });
        """)
        return np.array(row).reshape(-1, 4)[:, :3]

    def decoded(self, data: bytes) -> NDArray[np.int64]:
        """RGBA by the decoder of the page."""
        width, height, levels = self.run(f"""
            return import("/static/sgmethod/decoder.js").then(({{ decode }}) => {{
                const {{ width, height, data }} = decode({bytes_of(data)});
                return [width, height, [...data].map((level) => String.fromCharCode(level)).join("")];
            }});
        """)
        return np.frombuffer(levels.encode("latin-1"), np.uint8).reshape(height, width, 4).astype(int)
