"""The page's tables and plots of codecs at equal bytes, from figures by hand."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from benchmarks.rd.report import Row
from benchmarks.report import equal, results
from benchmarks.report.plots import save


def test_a_row_has_the_files_of_one_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"rd fidelity": 62.0, "rd visual": 58.0, "avif tune=iq 4:4:4": 59.0, "avif tune=iq 10 bits": 60.0}
    scores |= {"avif tune=ssimulacra2": 61.0, "avif grain": 48.0}
    rows = [
        Row(name, bpp, image, 0, bpp, 30.0, None, None, None, None, ssimulacra2=score + more, lpips=score / 1000)
        for name, score in scores.items()
        for bpp in (0.25, 0.5)
        for image, more in (("a", 0.0), ("b", 2.0))
    ]
    monkeypatch.setattr(results, "rows", lambda _: [asdict(row) for row in rows])
    monkeypatch.setattr(equal, "RESULTS", tmp_path)
    for cached in (equal.rows, equal.average):
        monkeypatch.setattr(equal, cached.__name__, cached.__wrapped__)
    assert equal.plots() == {}  # nothing was measured
    for size in equal.SETS:
        (tmp_path / "rd").mkdir(exist_ok=True)
        (tmp_path / f"rd/equal-{size}.json").touch()
    lines = equal.means_table("768").splitlines()
    assert "| 0.25 | AVIF | iq, 10 bits | 30.00 | 61.00 | 0.0600 | - | - | - | - |" in lines  # not the LPIPS of 8 bits
    assert len(lines) == 2 + 2 * 5
    differences = equal.differences_table("768").splitlines()
    assert (
        "| 0.25 | fidelity | ssimulacra2 | SSIMULACRA 2 | 63.00 | 62.00 | +1.00 ± 0.00 | 2 of 2 | +1.00 to +1.00 |"
        in differences
    )
    assert (
        "| 0.5 | visual | iq, film grain | LPIPS | 0.0580 | 0.0480 | +0.0100 ± 0.0000 | 0 of 2 | +0.0100 to +0.0100 |"
        in differences
    )
    figures = equal.figures()
    assert (figures["equal.768-visual-lpips-at-0.5"], figures["equal.whole-pictures"]) == (pytest.approx(0.01), 2)
    plots = equal.plots()
    assert list(plots)[1] == "equal-ssimulacra2"
    title, of, panels = plots["equal-ssimulacra2"]
    save(panels, title, of, tmp_path / "plot")
    assert "AVIF, ssimulacra2" in (tmp_path / "plot.svg").read_text()
