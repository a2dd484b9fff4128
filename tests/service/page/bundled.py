"""Sites with the npm package that `make npm` has packed, and packages of npm's registry."""

from __future__ import annotations

import shutil
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
