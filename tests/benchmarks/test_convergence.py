"""Error against run time: the time until a quality at a size, and what a size costs."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.convergence import until, until_table
from benchmarks.pictures import photograph
from benchmarks.report import speed


def test_the_lowest_effort_that_has_the_quality_within_the_bytes() -> None:
    pixels = np.ascontiguousarray(photograph(48))
    first = until(pixels, {"bytes": 300, "psnr": 1.0}, "psnr", "psnr")
    assert (first["effort"], first["reached"]) == (1, True)
    more = until(pixels, {"bytes": 300, "psnr": first["psnr"] + 0.05}, "psnr", "psnr")
    assert (more["reached"], more["bytes"] <= 300) == (True, True)
    assert more["effort"] > 1
    never = until(pixels, {"bytes": 300, "psnr": 99.0}, "psnr", "psnr")
    assert (never["effort"], never["reached"]) == (9, False)


def test_means_are_over_the_pictures_that_reach_it() -> None:
    key = {"megapixels": 0.4, "picture": "fog"}
    avif = {**key, "method": "avif", "setting": "4", "encode_s": 0.5, "seconds": 3.0}
    ours = {**key, "method": "rd until", "seconds": 1.25, "reached": True}
    missed = {**ours, "picture": "moss", "seconds": 9.0, "reached": False}
    last = until_table([avif, {**avif, "setting": "6", "seconds": 1.0}, ours, missed]).splitlines()[-1]
    assert last == "| 0.4 | psnr | 1 of 2 | 1.25 | 0.50 | 3.00 |"


def test_what_a_size_costs_the_quickest_first(monkeypatch: pytest.MonkeyPatch) -> None:
    key = {"picture": "fog", "megapixels": 12.0, "psnr": 40.0, "ssimulacra2": 70.5, "bytes": 375000, "decode_ms": 9.0}
    ours = {**key, "method": "rd visual", "setting": "", "seconds": 21.04, "mib": 1234.5}
    avif = {**key, "method": "avif", "setting": "6", "seconds": 9.04, "encode_s": 1.52, "mib": 99.6}
    psnr = {**ours, "method": "rd", "seconds": 15.0}
    monkeypatch.setattr(speed, "rows", lambda name: [ours, avif, psnr] if "12" in name else [])
    _, _, first, *_, last = speed.costs_table(12).splitlines()
    assert first == "| AVIF of 10 bits, `tune=psnr`, speed 6 | 9 | 1.5 | 40.0 | 70.5 | 375,000 | 100 |"
    assert last == "| `rd`, tuned for the eye (the default) | 21 | - | 40.0 | 70.5 | 375,000 | 1,234 |"
