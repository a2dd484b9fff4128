"""Real browsers for the tests of pages: Chromium, driven by selenium, and Firefox, driven by Mozilla's Marionette.

Debian has no geckodriver, through which selenium would drive Firefox.
"""

from __future__ import annotations

import base64
import json
import shutil
import tempfile
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from selenium.common.exceptions import StaleElementReferenceException
from selenium.webdriver import Chrome, ChromeOptions, ChromeService

from tests.support.data import ROOT
from tests.support.node import install
from tests.support.processes import TIMEOUT_S, wait_until

if TYPE_CHECKING:
    from tests.support.service import Service

CHROMIUM, CHROMEDRIVER, FIREFOX = (shutil.which(name) for name in ("chromium", "chromedriver", "firefox-esr"))
HINT = "Chromium is not installed, so the page was not tested: sudo apt install chromium chromium-driver"
FIREFOX_HINT = "Firefox is not installed, so the page was not tested in it: sudo apt install firefox-esr"
REQUIRED = "SGMETHOD_TEST_BROWSER"  # set to "required", a missing browser fails the tests
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--window-size=1000,1000",
)
AXE_VERSION = "4.14.1"

T = TypeVar("T")


def bytes_of(data: bytes) -> str:
    """An expression of JavaScript."""
    return f'Uint8Array.from(atob("{base64.b64encode(data).decode()}"), (letter) => letter.charCodeAt(0))'


class Page(ABC):
    """A window of a browser: what tests do in it. Elements are those of the driver's library, found by selector."""

    driver: Any
    stale: type[Exception]  # raised for an element that the page has replaced since it was found

    @abstractmethod
    def run(self, script: str) -> Any:
        """Return what a script returns, once its promise is kept."""

    @abstractmethod
    def open(self, url: str) -> None:
        """Load a page."""

    @abstractmethod
    def _console(self) -> list[str]:
        """Return the errors of scripts and violated policies that the console got since the last call."""

    @abstractmethod
    def close(self) -> None:
        """End the browser."""

    def open_page(self, service: Service) -> None:
        """Until its first sample is there, its original too."""
        self.open(f"{service.url}/")
        wait_until(lambda: self.is_seen("#right-label") and self.is_seen("#left-label"))

    def open_blank(self, service: Service) -> None:
        """A page of the service on which nothing is drawn: enough for a test of a module alone."""
        self.open(f"{service.url}/docs")

    def on(self, selector: str, act: Callable[[Any], T]) -> T:
        """Do something with the element of a selector; once more if the page replaces the element meanwhile."""
        while True:
            try:
                return act(self.driver.find_element("css selector", selector))
            except self.stale:
                continue

    def type(self, selector: str, text: str) -> None:
        """Type into a field; into one for files, the path of a file."""
        self.on(selector, lambda element: element.send_keys(text))

    def click(self, selector: str) -> None:
        """Click, as a person can: raises the driver's error if the element is hidden or covered."""
        self.on(selector, lambda element: element.click())

    def text(self, selector: str) -> str:
        """Return the visible text of an element, empty where it is hidden."""
        return str(self.on(selector, lambda element: element.text))

    def is_seen(self, selector: str) -> bool:
        return bool(self.on(selector, lambda element: element.is_displayed()))

    def complaints(self) -> list[str]:
        """Return the console's errors since the last call, without those about reading the canvas, as tests do."""
        return [line for line in self._console() if "getImageData" not in line]

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


class Chromium(Page):
    """Chromium."""

    def __init__(self) -> None:
        options = ChromeOptions()
        for option in OPTIONS:
            options.add_argument(option)
        options.binary_location = str(CHROMIUM)
        options.accept_insecure_certs = True  # those of tests
        options.timeouts = {"script": int(1000 * TIMEOUT_S)}
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        self.driver, self.stale = Chrome(options, ChromeService(CHROMEDRIVER)), StaleElementReferenceException

    def open(self, url: str) -> None:
        self.driver.get(url)

    def run(self, script: str) -> Any:
        return self.driver.execute_script(script)

    def tell(self, command: str, **parameters: Any) -> Any:
        """Run a command of Chromium's own protocol."""
        return self.driver.execute_cdp_cmd(command, parameters)

    def _console(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def close(self) -> None:
        self.driver.quit()


class Firefox(Page):
    """Firefox, with a profile of its own."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="firefox-")
        self._log = Path(self._folder.name) / "console.log"
        self._read = 0
        prefs = {"devtools.console.stdout.content": True}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the library's
            from marionette_driver.errors import StaleElementException
            from marionette_driver.marionette import Marionette

            self.driver = Marionette(port=0, bin=FIREFOX, headless=True, gecko_log=str(self._log), prefs=prefs)
        self.stale = StaleElementException
        self.driver.start_session()
        self.driver.timeout.script = TIMEOUT_S

    def open(self, url: str) -> None:
        self.driver.navigate(url)

    def run(self, script: str) -> Any:
        return self.driver.execute_script(script, sandbox=None)

    def _console(self) -> list[str]:
        lines = self._log.read_text(errors="replace").splitlines()
        new, self._read = lines[self._read :], len(lines)
        return [line for line in new if "http://" in line and line.startswith(("JavaScript error:", "console.error:"))]

    def close(self) -> None:
        self.driver.quit(in_app=False)
        self.driver.cleanup()
        self._folder.cleanup()


@cache
def axe() -> str:
    """axe-core, which looks for what on a page shuts people out. From npm's registry, once for all runs."""
    installed = ROOT / "build" / f"axe-core-{AXE_VERSION}"
    if not installed.exists():
        installed.parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=installed.parent) as folder:  # in the same file system
            install(Path(folder), f"axe-core@{AXE_VERSION}")
            with suppress(OSError):  # another test was faster
                (Path(folder) / "node_modules" / "axe-core").rename(installed)
    return (installed / "axe.min.js").read_text()


def assert_open_to_all(page: Chromium, place: str = "document", at_least: int = 10, found: str = "violations") -> None:
    """No finding of axe, with all parts of a place open, neither by day nor by night."""
    page.run("for (const one of document.querySelectorAll('details')) one.open = true")
    page.run(axe())
    for scheme in ("light", "dark"):
        page.tell("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        passed, findings = page.run(f"""
            return axe.run({place}).then(({{ passes, violations, incomplete }}) => [passes.length, {found}
                .map(({{ id, nodes }}) => [id, ...nodes.map(({{ target }}) => target.join(" "))])]);
        """)
        assert passed > at_least
        assert findings == []
