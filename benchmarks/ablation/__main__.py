"""What each part of profile rd is worth: the same pictures at the same rate with one part left out at a time.

    python -m benchmarks.ablation --images FOLDER [--bpp 0.25] [--steps N] [--most 6]

Files are real and decoded again. All have the same size within a percent, so the difference in PSNR is what the part
is worth.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.machine import RESULTS, Record, in_words
from benchmarks.pictures import chosen_from
from sgmethod import Budget
from sgmethod.codec import encode
from sgmethod.io.image import read_image
from sgmethod.profiles import PAPER, PROFILES, RD, RdSettings
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
    Part("structure (random start)", {}, lambda: patch.object(fit, "PAPER", replace(PAPER, structure_guided=False))),
    Part("dropping Gaussians", {}, lambda: patch.object(fit.RdFit, "_drop", _keep_all)),
    Part("dropping those not worth their bits", {"bits_of_dropped": RD.bits_of_nothing}),
    Part("smaller pictures at first", {"halvings": 0}),
    Part("a price for existing (anything may grow)", {"bits_of_new": 0.0}),
    Part("a price for bits while fitting", {}, lambda: patch.object(quantiser, "add_rate_gradient")),
    Part("more than the size at first", {"times": replace(RD.times, excess=0.0)}),
    Part("refined integers", {"refine_sweeps": 0}),
    Part("a price for bits while refining", {"refine_weight": 0.0}),
)


def measure(part: Part, pictures: list[Path], bpp: float, settings: RdSettings) -> dict[str, Any]:
    """Mean figures over the pictures without the part."""
    stats = []
    with ExitStack() as stack:
        stack.enter_context(part.patched())
        stack.enter_context(patch.dict(PROFILES, {"rd": replace(settings, **part.without)}))
        for picture in pictures:
            stats.append(encode(read_image(picture.read_bytes()), Budget("bpp", bpp), "rd", tune="psnr").stats)
    return {
        "without": part.name,
        "psnr": statistics.fmean(s.psnr for s in stats),
        "bpp": statistics.fmean(s.bpp for s in stats),
        "gaussians": statistics.fmean(s.gaussians for s in stats),
        "seconds": statistics.fmean(s.seconds for s in stats),
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ablation", description="Profile rd, part by part.")
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--steps", type=int, default=RD.steps)
    parser.add_argument("--most", type=int, default=6, help="pictures, taken evenly from the folder")
    parser.add_argument("--out", type=Path, default=RESULTS / "ablation.json")
    options = parser.parse_args()
    pictures = chosen_from(options.images, options.most)
    names = [p.name for p in pictures]
    settings = {"pictures": names, "steps": options.steps, "bpp": options.bpp}
    record = Record(options.out, "benchmarks.ablation", settings)
    for part in PARTS:
        if not record.has(without=part.name):
            record.add(measure(part, pictures, options.bpp, replace(RD, steps=options.steps)))
    print(f"\nMeans over {', '.join(names)}; {options.steps} steps.\n\n{in_words(record.content)}")


if __name__ == "__main__":
    main()
