"""Profile rd with one part left out at a time, by its settings. Files are real and decoded again; all have the same
size within a percent, so that the difference in PSNR is what the part is worth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from sgmethod import Budget, encode
from sgmethod.settings.rd import RD

NEXT_TO_NOTHING = 1e-6
TIMES = RD.effort.times

# What is left out, and the settings that leave it out.
PARTS = {
    "nothing": RD,
    "growth (all placed by structure at the start)": replace(
        RD, place=replace(RD.place, share=1.0), densify=replace(RD.densify, bits_of_new=1e12)
    ),
    "structure (random start)": replace(
        RD, place=replace(RD.place, start=replace(RD.place.start, structure_guided=False))
    ),
    "dropping Gaussians": replace(RD, prune=replace(RD.prune, bits_of_nothing=0.0, bits_of_dropped=0.0)),
    "dropping those not worth their bits": replace(
        RD, prune=replace(RD.prune, bits_of_dropped=RD.prune.bits_of_nothing)
    ),
    "smaller pictures at first": replace(RD, pyramid=replace(RD.pyramid, contrast_kept=math.inf)),
    "a price for existing (anything may grow)": replace(RD, densify=replace(RD.densify, bits_of_new=0.0)),
    # The price of a new Gaussian is a multiple of the price in the fit, and stays unchanged.
    "a price for bits while fitting": replace(
        RD,
        fit=replace(RD.fit, rate_weight=RD.fit.rate_weight * NEXT_TO_NOTHING),
        densify=replace(RD.densify, bits_of_new=RD.densify.bits_of_new / NEXT_TO_NOTHING),
    ),
    "more than the size at first": replace(
        RD, effort=replace(RD.effort, times=replace(TIMES, excess=0.0, finer_early=1.0))
    ),
    "refined integers": replace(RD, effort=replace(RD.effort, refine_sweeps=0)),
    "a price for bits while refining": replace(RD, refine=replace(RD.refine, weight=0.0)),
}


def measure(part: str, picture: Path, seed: int, bpp: float, steps: int) -> dict[str, Any]:
    """Encode a file without the part."""
    settings = replace(PARTS[part], effort=replace(PARTS[part].effort, steps=steps))
    stats = encode(picture, Budget("bpp", bpp), tune="psnr", settings=settings, seed=seed).stats
    return {"psnr": stats.psnr, "bpp": stats.bpp, "gaussians": stats.gaussians, "seconds": stats.seconds}
