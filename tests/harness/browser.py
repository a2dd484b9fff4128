"""A real browser for the tests of the page: Chromium, told what to do over the WebDriver protocol."""

from __future__ import annotations

import base64
import shutil
import subprocess
from pathlib import Path
from typing import Any

import httpx

HINT = "Chromium is not installed, so the page was not tested: sudo apt install chromium chromium-driver"
REQUIRED = "SGMETHOD_TEST_BROWSER"  # set to "required", a missing browser fails the tests
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"  # the protocol's name for a reference to one
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics processor
    "--disable-dev-shm-usage",
    "--window-size=1000,1000",
)


def find_driver() -> str | None:
    """The program that drives the browser; None if either is missing."""
    driver = shutil.which("chromedriver")
    return driver if shutil.which("chromium") else None


class Browser:
    """One window."""

    def __init__(self, driver: str) -> None:
        self._process = subprocess.Popen(
            [driver, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert self._process.stdout is not None
        port = next(line.split()[-1].rstrip(".") for line in self._process.stdout if "started successfully" in line)
        self._http = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60)
        chrome = {"args": OPTIONS, "binary": shutil.which("chromium")}
        wanted = {"goog:chromeOptions": chrome, "goog:loggingPrefs": {"browser": "ALL"}}
        self._session = ""
        started = self._ask("POST", "session", capabilities={"alwaysMatch": wanted})
        self._session = f"session/{started['sessionId']}/"

    def _ask(self, method: str, path: str, **body: Any) -> Any:
        content = body if method == "POST" else None
        answer = self._http.request(method, f"/{self._session}{path}", json=content).json()["value"]
        if isinstance(answer, dict) and "error" in answer:
            raise AssertionError(answer["message"])
        return answer

    def open(self, url: str) -> None:
        """Load a page."""
        self._ask("POST", "url", url=url)

    def _element(self, selector: str) -> str:
        found: str = self._ask("POST", "element", using="css selector", value=selector)[ELEMENT]
        return f"element/{found}"

    def type(self, selector: str, text: str) -> None:
        """Type into a field; into one for files, the path of a file."""
        self._ask("POST", f"{self._element(selector)}/value", text=text)

    def click(self, selector: str) -> None:
        """Click, as a person can: what is hidden or covered raises AssertionError."""
        self._ask("POST", f"{self._element(selector)}/click")

    def text(self, selector: str) -> str:
        """The text of an element as it is seen, empty where it is hidden."""
        return str(self._ask("GET", f"{self._element(selector)}/text"))

    def is_seen(self, selector: str) -> bool:
        """Whether an element is displayed."""
        return bool(self._ask("GET", f"{self._element(selector)}/displayed"))

    def run(self, script: str) -> Any:
        """What a script returns."""
        return self._ask("POST", "execute/sync", script=script, args=[])

    def prefer(self, scheme: str) -> None:
        """Dark or light, as a person's system asks for it."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self._ask("POST", "goog/cdp/execute", cmd="Emulation.setEmulatedMedia", params={"features": features})

    def complaints(self) -> list[str]:
        """What the console has said since the last call: errors of scripts, policies that were broken."""
        return [entry["message"] for entry in self._ask("POST", "se/log", type="browser")]

    def screenshot(self, path: Path) -> None:
        """Write a PNG of the window."""
        path.write_bytes(base64.b64decode(self._ask("GET", "screenshot")))

    def close(self) -> None:
        """End the browser."""
        try:
            self._ask("DELETE", "window")  # the only one, and the browser goes with it
        finally:
            self._http.close()
            self._process.terminate()
            self._process.wait(60)
            assert self._process.stdout is not None
            self._process.stdout.close()
