"""Profile rd with one part left out at a time. Files are real and decoded again; all have the same size within a
percent, so that the difference in PSNR is what the part is worth."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from sgmethod import Budget
from sgmethod.codec import encode
from sgmethod.io.image import read_image
from sgmethod.profiles import PROFILES, RD, RdSettings
from sgmethod.rd import fit, quantiser


@dataclass(frozen=True)
class Part:
    """A part and how to leave it out: other settings, or a patch while encoding."""

    name: str
    without: dict[str, Any]
    patched: Callable[[], AbstractContextManager[Any]] = nullcontext


def _keep_all(_: Any, _bits: float, _most: int) -> None:
    """In place of dropping Gaussians."""


PARTS = (
    Part("nothing", {}),
    Part("growth (all placed by structure at the start)", {"start_share": 1.0, "bits_of_new": 1e12}),
    Part(
        "structure (random start)", {}, lambda: patch.object(fit, "START", replace(fit.START, structure_guided=False))
    ),
    Part("dropping Gaussians", {}, lambda: patch.object(fit.RdFit, "_drop", _keep_all)),
    Part("dropping those not worth their bits", {"bits_of_dropped": RD.bits_of_nothing}),
    Part("smaller pictures at first", {"halvings": 0}),
    Part("a price for existing (anything may grow)", {"bits_of_new": 0.0}),
    Part("a price for bits while fitting", {}, lambda: patch.object(quantiser, "add_rate_gradient")),
    Part("more than the size at first", {"times": replace(RD.times, excess=0.0)}),
    Part("refined integers", {"refine_sweeps": 0}),
    Part("a price for bits while refining", {"refine_weight": 0.0}),
)


def measure(part: Part, picture: Path, seed: int, bpp: float, settings: RdSettings) -> dict[str, Any]:
    """One file without the part."""
    with part.patched(), patch.dict(PROFILES, {"rd": replace(settings, **part.without)}):
        stats = encode(read_image(picture.read_bytes()), Budget("bpp", bpp), "rd", tune="psnr", seed=seed).stats
    return {"psnr": stats.psnr, "bpp": stats.bpp, "gaussians": stats.gaussians, "seconds": stats.seconds}
