"""Sites as a web server has them."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from tests.support.processes import TIMEOUT_S

# What a page shows of each photograph.
SHOWN = """
    return [...document.querySelectorAll("sg-img")].map((one) => ({
        text: one.getAttribute("preview"), drawn: Boolean(one.shadowRoot?.querySelector("canvas")),
        alt: one.querySelector("img").alt, loaded: one.querySelector("img").naturalWidth,
        uri: one.querySelector("img").style.backgroundImage, display: getComputedStyle(one).display,
    }));
"""


@dataclass
class Site:
    """A folder that is served.

    asked: the paths of all requests so far.
    may: unless it is set, photographs, which are PNG, are held back.
    """

    folder: Path
    url: str = ""
    asked: list[str] = field(default_factory=list)
    may: threading.Event = field(default_factory=threading.Event)


@contextmanager
def served(folder: Path, policy: str = "") -> Iterator[Site]:
    site = Site(folder)
    site.may.set()

    class Handler(SimpleHTTPRequestHandler):
        def end_headers(self) -> None:
            if policy:
                self.send_header("Content-Security-Policy", policy)
            super().end_headers()

        def do_GET(self) -> None:
            site.asked.append(self.path)
            if not self.path.endswith(".png") or site.may.wait(TIMEOUT_S):
                super().do_GET()

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder))) as server:
        site.url = f"http://127.0.0.1:{server.server_port}/"
        threading.Thread(target=server.serve_forever).start()
        try:
            yield site
        finally:
            site.may.set()
            server.shutdown()


def answers(port: int) -> bool:
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0
