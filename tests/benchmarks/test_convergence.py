"""Error against run time: the time until a quality at a size."""

from __future__ import annotations

import numpy as np

from benchmarks.convergence import until
from benchmarks.pictures import photograph


def test_the_lowest_effort_that_has_the_quality_within_the_bytes() -> None:
    pixels = np.ascontiguousarray(photograph(48))
    first = until(pixels, {"bytes": 300, "psnr": 1.0}, "psnr", "psnr")
    assert (first["effort"], first["reached"]) == (1, True)
    more = until(pixels, {"bytes": 300, "psnr": first["psnr"] + 0.05}, "psnr", "psnr")
    assert (more["reached"], more["bytes"] <= 300) == (True, True)
    assert more["effort"] > 1
    never = until(pixels, {"bytes": 300, "psnr": 99.0}, "psnr", "psnr")
    assert (never["effort"], never["reached"]) == (9, False)
