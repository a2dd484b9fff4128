"""The paper's tables of quantisation, for files of profile paper.

Numbers of Gaussians are for the paper's 768x512 pixels; other pictures have as many for each pixel. Positions
are measured on whole pictures: a bit of one is a part of a side, and means less on a smaller picture. Files of one
picture, number and seed that have the same start share the float fit that they are tuned from.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from scipy.stats import spearmanr
from torch import Tensor

from benchmarks.ablation.gains import PIXELS, pixels_of
from sgmethod.bitstream import container
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.level import Level
from sgmethod.fitting.recorder import Recorder
from sgmethod.metrics import psnr
from sgmethod.paper.codebook import ResidualCodebook
from sgmethod.paper.fit import fit, level_of
from sgmethod.paper.placement import place_by_structure
from sgmethod.paper.schedule import Schedule
from sgmethod.paper.settings import PAPER, PaperSettings
from sgmethod.paper.stream import file_bytes
from sgmethod.paper.tuning import Tuner, bits_per_gaussian
from sgmethod.scene import Gaussians

RANDOM = replace(PAPER.start, structure_guided=False)
# What GaussianImage codes: random start, no regularisation, 6 bits of a factor, 16 of a position. Our optimiser.
PLAIN = replace(
    PAPER, start=RANDOM, lambda_g=0.0, adaptive_bitwidth=False, position_bits=16, mean_bitwidth=PAPER.min_bitwidth
)
# Without a price of a bit, bytes for the mean bitwidth set the bitwidths.
BUDGETED = replace(PAPER, lambda_b=0.0, bits_by_budget=True, mean_bitwidth=7.5)
# What makes PLAIN stronger than GaussianImage's own files: each taken back alone, and all of them.
RANGES = "GSImage, ranges from the least to the largest"
STAGES = "GSImage, colours matched stage by stage"
SHORT = "GSImage, a tenth of the fit"
WEAK = "GSImage, all three"
WIDE = replace(PLAIN, range_quantile=0.0)
SHORT_FIT = 0.1  # of the steps
BITWIDTHS: dict[str, dict[str, Any]] = {f"from {b:g} bits": {"start_bitwidth": b} for b in (6.5, 8, 10, 12)}
BITWIDTHS["from 8 bits, at four times the rate"] = {"bits_rate": 4 * PAPER.bits_rate}


@dataclass(frozen=True)
class Table:
    """A table of the paper. settings: of its rows, by name; numbers: of Gaussians; middle: the part that is coded."""

    settings: dict[str, PaperSettings]
    numbers: tuple[int, ...]
    middle: tuple[int, int] | None = None


def by_stage(codebook: ResidualCodebook, colors: Tensor) -> Tensor:
    """The indices [N, 2] of colours [N, 3] as GaussianImage finds them: the first entry, then the one for the rest."""
    first, second = codebook.entries
    index = torch.cdist(colors, first).argmin(1)
    return torch.stack([index, torch.cdist(colors - first[index], second).argmin(1)], 1)


TABLES = {
    "quantisation": Table(
        {
            "GSImage": PLAIN,
            **{RANGES: WIDE, STAGES: PLAIN, SHORT: PLAIN, WEAK: WIDE},
            "GSImage, structure-guided start": replace(PLAIN, start=PAPER.start),
            "GSImage, ABQ and 12 bits of a position": replace(PAPER, start=RANDOM, lambda_g=0.0),
            **{f"LSQ, {b} bits": replace(PAPER, adaptive_bitwidth=False, min_bitwidth=b) for b in (6, 7, 8)},
            **{f"ABQ, weight {w:g}": replace(PAPER, lambda_b=w) for w in (0.0012, 0.0014)},
            **{
                f"ABQ, weight {w:g}, gradient as printed": replace(PAPER, lambda_b=w, printed_gradient=True)
                for w in (0.0012, 0.0014)
            },
            "ABQ, 7.5 bits by a budget": BUDGETED,
        },
        (1000, 3000, 7000),
        (384, 256),
    ),
    "positions": Table(
        {f"{bits}": replace(BUDGETED, position_bits=bits) for bits in (16, 14, 12, 10)}, (1000, 3000, 7000)
    ),
    # Where bitwidths end, by what the paper does not give: where they begin, and how fast they learn.
    "bitwidths": Table(
        {
            f"{name}{', gradient as printed' if printed else ''}": replace(PAPER, **changes, printed_gradient=printed)
            for printed in (False, True)
            for name, changes in BITWIDTHS.items()
        },
        (3000,),
        (384, 256),
    ),
}


def measure(
    table: Table, setting: str, number: int, picture: Path, seed: int, steps: tuple[int, int]
) -> dict[str, Any]:
    """Measure one row. steps: of the fit, and of the tuning."""
    fit_steps = round(steps[0] * (SHORT_FIT if setting in (SHORT, WEAK) else 1))
    assign = by_stage if setting in (STAGES, WEAK) else ResidualCodebook.assign
    settings = replace(table.settings[setting], fit_steps=fit_steps, tune_steps=steps[1])
    pixels = pixels_of(picture, table.middle)
    n = max(round(number * pixels[..., 0].size / PIXELS), 1)
    of_fit = replace(PAPER, start=settings.start, lambda_g=settings.lambda_g, fit_steps=settings.fit_steps)
    began, clock = time.perf_counter(), Clock()
    level, gaussians = _fitted(picture, table.middle, of_fit, n, seed)
    budget = file_bytes(int(n * bits_per_gaussian(settings)), settings.max_bitwidth - settings.min_bitwidth + 1)
    with patch.object(ResidualCodebook, "assign", assign):
        tuner = Tuner(gaussians, level, settings, budget if settings.bits_by_budget else None, seed)
        schedule = Schedule("tune", settings.tune_steps, settings.optimiser.final_rate)
        schedule.run(Deadline.from_limit(clock), Recorder(clock), tuner.step)
        stream = tuner.stream()
    seconds = time.perf_counter() - began
    data = container.serialise(stream)
    return {
        "gaussians": n,
        "psnr": psnr(draw(stream.scene()), pixels),
        "bpp": 8 * len(data) / (pixels.shape[0] * pixels.shape[1]),
        "bits_of_factor": float(tuner.bits().round().mean()),
        "bits_by_size": bits_by_size(tuner),
        "seconds": seconds,
    }


def bits_by_size(tuner: Tuner) -> float | None:
    """Spearman's rank correlation of a Gaussian's soft bitwidth and its area; None where all bitwidths are equal."""
    bits, factors = tuner.bits()[:, 0].numpy(), tuner.p.factors.numpy()
    if np.ptp(bits) == 0:
        return None
    return float(spearmanr(bits, np.abs(factors[:, 0] * factors[:, 2])).statistic)


@lru_cache(maxsize=8)
def _fitted(
    path: Path, middle: tuple[int, int] | None, settings: PaperSettings, n: int, seed: int
) -> tuple[Level, Gaussians]:
    """The picture as the fit sees it, and the Gaussians fitted to it."""
    pixels, clock = pixels_of(path, middle), Clock()
    level = level_of(pixels)
    start = place_by_structure(
        pixels.astype(np.float32) / np.float32(255), n, settings.start, np.random.default_rng(seed)
    )
    return level, fit(level, start, settings, Recorder(clock), Deadline.from_limit(clock))[0]
