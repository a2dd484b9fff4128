"""What the tests of the page compare it with, and what they all assert."""

from __future__ import annotations

from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import sgmethod
from tests.service.browser import Chromium
from tests.service.page.bundled import install
from tests.support.data import ROOT, STATIC, golden_path

OTHER = golden_path("v1-paper.sg").read_bytes()  # which the page does not read
COFFEE, PHOTOGRAPH = ((STATIC / "samples" / f"coffee.{kind}").read_bytes() for kind in ("sg", "webp"))
COFFEE_SAYS = f"{sgmethod.info(COFFEE).gaussians:,} Gaussians"
AXE_VERSION = "4.14.1"


@cache
def axe() -> str:
    """axe-core, which looks for what on a page shuts people out. From npm's registry, once for all runs."""
    installed = ROOT / "build" / f"axe-core-{AXE_VERSION}"
    if not installed.exists():
        installed.parent.mkdir(exist_ok=True)
        with TemporaryDirectory(dir=installed.parent) as folder:  # in the same file system
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
