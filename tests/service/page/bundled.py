"""Scripts in Node, and sites: how they are served, the npm package that `make npm` has packed, npm's registry."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from tests.support.data import ROOT
from tests.support.processes import run


def packed() -> Path:
    """The package as npm installs it."""
    files = sorted((ROOT / "dist").glob("sgmethod-*.tgz"))
    if not files or shutil.which("npm") is None:
        pytest.skip("the npm package is not built: make npm, which needs Node and npm")
    return files[-1]


def install(folder: Path, *packages: str | Path) -> None:
    """Install packages in a folder; skip the test where the registry is out of reach."""
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    (folder / "package.json").write_text('{ "private": true, "type": "module" }')
    done = run("npm", "install", "--silent", "--no-audit", "--no-fund", *packages, folder=folder)
    if done.status:
        pytest.skip(f"npm cannot install {' '.join(map(str, packages))}: {done.stderr[-300:]}")


def node(script: str, folder: Path = ROOT) -> str:
    """What a module prints that runs in a folder; it must end well."""
    if shutil.which("node") is None:
        pytest.skip("Node is not installed: sudo apt install nodejs")
    done = run("node", "--input-type=module", "--eval", script, folder=folder)
    assert done.status == 0, done.stderr
    return done.stdout


@contextmanager
def served(folder: Path, handler: type[SimpleHTTPRequestHandler] = SimpleHTTPRequestHandler) -> Iterator[str]:
    """The address at which a folder is served."""
    quiet = type("Quiet", (handler,), {"log_message": lambda *_: None})
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(quiet, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
