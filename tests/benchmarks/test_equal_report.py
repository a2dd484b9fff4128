"""The page's tables of codecs at equal bytes, from figures by hand."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from benchmarks.rd.report import Row
from benchmarks.report import equal, results


def test_a_row_has_the_files_of_one_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"rd fidelity": 62.0, "rd visual": 58.0, "avif tune=iq 4:4:4": 59.0, "avif tune=iq 10 bits": 60.0}
    scores |= {"avif tune=ssimulacra2": 61.0, "avif grain": 48.0}
    rows = [
        Row(name, bpp, image, 0, bpp, 30.0, None, None, None, None, ssimulacra2=score + more, lpips=score / 1000)
        for name, score in scores.items()
        for bpp in (0.25, 0.5)
        for image, more in (("a", 0.0), ("b", 2.0))
    ]
    every = [asdict(row) for row in rows]
    others = {"rd/equal-kodak": [row | {"lpips": None} for row in every], "rd/equal-whole-psnr": []}
    monkeypatch.setattr(results, "rows", lambda name: others.get(name, every))
    monkeypatch.setattr(equal, "RESULTS", tmp_path)
    for cached in (equal.rows, equal.average):
        monkeypatch.setattr(equal, cached.__name__, cached.__wrapped__)
    assert equal.figures() == {}  # nothing was measured
    (tmp_path / "rd").mkdir()
    for name in sum(equal.FILES.values(), ()):
        (tmp_path / f"{name}.json").touch()
    lines = equal.means_table("768").splitlines()
    assert "| 0.25 | AVIF | iq, 10 bits | 30.00 | 61.00 | 0.0600 | - | - | - | - |" in lines  # not the LPIPS of 8 bits
    assert len(lines) == 2 + 2 * 5
    differences = equal.differences_table("whole").splitlines()
    assert differences[0] == "| bpp | sgmethod | AVIF | PSNR | SSIMULACRA 2 | LPIPS |"
    to_ssimulacra2 = (
        "| 0.25 | fidelity | ssimulacra2 | +0.00 ± 0.00 (0 of 2) | +1.00 ± 0.00 (2 of 2) | +0.0010 ± 0.0000 (0 of 2) |"
    )
    assert to_ssimulacra2 in differences
    to_grain = (
        "| 0.5 | visual | iq, film grain | +0.00 ± 0.00 (0 of 2) | +10.00 ± 0.00 (2 of 2) | +0.0100 ± 0.0000 (0 of 2) |"
    )
    assert to_grain in differences
    figures = equal.figures()
    assert figures["equal.768-visual-iq-film-grain-lpips-at-0.5"] == pytest.approx(0.01)
    assert figures["equal.whole-pictures"] == 2
