"""Real browsers for the tests of the page, told what to do by WebDriver's commands.

Chromium has a program of its own for that, which speaks HTTP. Firefox's is in no package of Debian's, but all that it
does is to hand the commands on to Firefox, over a socket that Firefox itself opens (Marionette). So does Firefox here.
"""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import httpx

from tests.harness.page import Page
from tests.harness.processes import PATIENCE_S, wait_until

HINT = "Chromium is not installed, so the page was not tested: sudo apt install chromium chromium-driver"
FIREFOX_HINT = "Firefox is not installed, so the page was not tested in it: sudo apt install firefox-esr"
REQUIRED = "SGMETHOD_TEST_BROWSER"  # set to "required", a missing browser fails the tests
TIMEOUTS = {"script": int(1000 * PATIENCE_S)}  # milliseconds; browsers by themselves give a script 30 s
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics processor
    "--disable-dev-shm-usage",
)
PREFERENCES = {
    "marionette.port": 0,  # any that is free, which it writes into its profile
    "devtools.console.stdout.content": True,
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "app.update.enabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "services.settings.server": "data:,",  # where it would ask for news
    "browser.backup.enabled": False,
}
# By our names: how Chromium's program is asked, and what Firefox calls it.
COMMANDS = {
    "open": ("POST", "url", "WebDriver:Navigate"),
    "find": ("POST", "element", "WebDriver:FindElement"),
    "type": ("POST", "element/{id}/value", "WebDriver:ElementSendKeys"),
    "click": ("POST", "element/{id}/click", "WebDriver:ElementClick"),
    "text": ("GET", "element/{id}/text", "WebDriver:GetElementText"),
    "is_seen": ("GET", "element/{id}/displayed", "WebDriver:IsElementDisplayed"),
    "run": ("POST", "execute/sync", "WebDriver:ExecuteScript"),
}


def find_driver() -> str | None:
    """The program that drives Chromium; None if either is missing."""
    driver = shutil.which("chromedriver")
    return driver if shutil.which("chromium") else None


def find_firefox() -> str | None:
    """Firefox ESR; None if it is missing."""
    return shutil.which("firefox-esr")


class Chromium(Page):
    """Chromium. size: width and height of the window, in pixels."""

    def __init__(self, driver: str, size: tuple[int, int] = (1000, 1000)) -> None:
        self._process = subprocess.Popen(
            [driver, "--port=0"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert self._process.stdout is not None
        port = next(line.split()[-1].rstrip(".") for line in self._process.stdout if "started successfully" in line)
        self._http = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S)
        chrome = {"args": (*OPTIONS, "--window-size={},{}".format(*size)), "binary": shutil.which("chromium")}
        wanted = {"goog:chromeOptions": chrome, "goog:loggingPrefs": {"browser": "ALL"}, "timeouts": TIMEOUTS}
        wanted["acceptInsecureCerts"] = True  # those of tests
        self._session = ""
        started = self._ask("POST", "session", capabilities={"alwaysMatch": wanted})
        self._session = f"session/{started['sessionId']}/"

    def _ask(self, method: str, path: str, **body: Any) -> Any:
        content = body if method == "POST" else None
        answer = self._http.request(method, f"/{self._session}{path}", json=content).json()["value"]
        if isinstance(answer, dict) and "error" in answer:
            raise AssertionError(answer["message"])
        return answer

    def _do(self, command: str, **given: Any) -> Any:
        method, path, _ = COMMANDS[command]
        return self._ask(method, path.format(**given), **given)

    def tell(self, command: str, **parameters: Any) -> Any:
        """A command of Chromium's own protocol."""
        return self._ask("POST", "goog/cdp/execute", cmd=command, params=parameters)

    def new_tab(self) -> str:
        """Open a tab, to which switch_to() leads."""
        return str(self._ask("POST", "window/new", type="tab")["handle"])

    def tab(self) -> str:
        """The one that commands are for."""
        return str(self._ask("GET", "window"))

    def switch_to(self, tab: str) -> None:
        """Let commands be for that tab."""
        self._ask("POST", "window", handle=tab)

    def close_tab(self) -> None:
        """Close the one that commands are for; another must be switched to."""
        self._ask("DELETE", "window")

    def prefer(self, scheme: str) -> None:
        """Dark or light, as a person's system asks for it."""
        self.tell("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def _console(self) -> list[str]:
        return [entry["message"] for entry in self._ask("POST", "se/log", type="browser")]

    def close(self) -> None:
        try:
            self._ask("DELETE", "window")  # the only one, and the browser goes with it
        finally:
            self._http.close()
            self._process.terminate()
            self._process.wait(PATIENCE_S)
            assert self._process.stdout is not None
            self._process.stdout.close()


class Firefox(Page):
    """Firefox, with a profile of its own."""

    def __init__(self, program: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="firefox-", ignore_cleanup_errors=True)
        profile = Path(self._folder.name)
        lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in PREFERENCES.items()]
        (profile / "user.js").write_text("".join(lines))
        self._log = profile / "console.log"
        self._heard = 0
        command = [program, "--headless", "--marionette", "--no-remote", "--profile", str(profile)]
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        port = profile / "MarionetteActivePort"
        wait_until(lambda: port.exists() and port.read_text().strip())
        self._socket = socket.create_connection(("127.0.0.1", int(port.read_text())), timeout=PATIENCE_S)
        self._stream = self._socket.makefile("rb")
        self._commands = 0
        self._read()  # its greeting
        self._ask("WebDriver:NewSession", {})
        self._ask("WebDriver:SetTimeouts", TIMEOUTS)

    def _read(self) -> Any:
        length = b""
        while not length.endswith(b":"):
            if not (digit := self._stream.read(1)):
                raise AssertionError("Firefox has ended")
            length += digit
        return json.loads(self._stream.read(int(length[:-1])))

    def _ask(self, command: str, given: dict[str, Any]) -> Any:
        self._commands += 1
        message = json.dumps([0, self._commands, command, given]).encode()
        self._socket.sendall(b"%d:%b" % (len(message), message))
        _, _, error, answer = self._read()
        if error is not None:
            raise AssertionError(error["message"])
        return answer

    def _do(self, command: str, **given: Any) -> Any:
        answer = self._ask(COMMANDS[command][2], given)
        return answer["value"] if isinstance(answer, dict) and "value" in answer else answer

    def _console(self) -> list[str]:
        lines = self._log.read_text(errors="replace").splitlines()
        new, self._heard = lines[self._heard :], len(lines)
        return [line for line in new if "http://" in line and line.startswith(("JavaScript error:", "console.error:"))]

    def close(self) -> None:
        try:
            self._ask("Marionette:Quit", {"flags": ["eForceQuit"]})
        finally:
            self._stream.close()
            self._socket.close()
            self._process.wait(PATIENCE_S)
            self._folder.cleanup()
