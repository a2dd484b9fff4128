"""A site of each test's own."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.javascript.site import Site, served
from tests.support.data import JAVASCRIPT, STATIC
from tests.support.node import install, packed

PAGE = '<!doctype html><meta charset="utf-8"><title>A site</title><link rel="icon" href="cat.webp">'


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    """The package's modules, photographs and an empty page, under a policy that allows no inline styles and scripts."""
    shutil.copytree(JAVASCRIPT, tmp_path / "sgmethod")
    for name in ("cat.webp", "coffee.webp"):
        shutil.copy(STATIC / "samples" / name, tmp_path)
    (tmp_path / "index.html").write_text(PAGE)
    with served(tmp_path, "default-src 'self'") as site:
        yield site


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder node_modules with Vite, sharp, TypeScript, Express and the package."""
    folder = tmp_path_factory.mktemp("packages")
    install(folder, packed(), "vite@8", "sharp@0.35", "typescript@5", "express@5")
    return folder / "node_modules"


@pytest.fixture
def npm_site(packages: Path, tmp_path: Path) -> Path:
    """A folder in which they can be imported, with a cache of its own."""
    (tmp_path / "package.json").write_text('{ "private": true, "type": "module" }')
    shutil.copytree(packages, tmp_path / "node_modules", symlinks=True, copy_function=os.link)
    return tmp_path
