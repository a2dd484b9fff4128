"""What the tests of the page compare it with, and what they all assert."""

from __future__ import annotations

from typing import Any

import numpy as np

import sgmethod
from benchmarks.harness.data import DATA, STATIC, golden_path
from tests.service.browser import Chromium

OTHER = golden_path("v1-paper.sg").read_bytes()  # which the page does not read
COFFEE, PHOTOGRAPH = ((STATIC / "samples" / f"coffee.{kind}").read_bytes() for kind in ("sg", "webp"))
COFFEE_SAYS = f"{sgmethod.info(COFFEE).gaussians:,} Gaussians"
AXE = (DATA / "axe.min.js").read_text()


def assert_open_to_all(page: Chromium, place: str = "document", least: int = 10, found: str = "violations") -> None:
    """No finding of axe, with all parts of a place open, neither by day nor by night."""
    page.run("for (const one of document.querySelectorAll('details')) one.open = true")
    page.run(AXE)
    for scheme in ("light", "dark"):
        page.tell("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        passed, findings = page.run(f"""
            return axe.run({place}).then(({{ passes, violations, incomplete }}) => [passes.length, {found}
                .map(({{ id, nodes }}) => [id, ...nodes.map(({{ target }}) => target.join(" "))])]);
        """)
        assert passed > least
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
