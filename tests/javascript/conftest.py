"""A site of each test's own."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.javascript.site import Site, served
from tests.support.data import JAVASCRIPT, STATIC

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
