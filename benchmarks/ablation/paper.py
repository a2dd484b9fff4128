"""The tables of the paper's ablation section, for profile paper.

Numbers of Gaussians are for the paper's 768x512 pixels; other pictures have as many for each pixel. Float fits are of
pictures at half the size, where a quarter of the Gaussians, of n_0 and of N_t are the same for each pixel. Files are
of whole pictures: a bit of a position is a part of a side, and means less on a smaller picture. Files of one picture,
number and seed share the float fit that they are tuned from.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ablation.fits import FLOAT, PaperFit, fit_of_paper
from benchmarks.pictures import Pixels
from sgmethod.bitstream import container
from sgmethod.bitstream.v1 import file_bytes
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.paper.schedule import Schedule
from sgmethod.paper.tuning import Tuner, bits_per_gaussian
from sgmethod.settings.paper import BASELINE, PAPER, PaperSettings

PIXELS = 768 * 512
# Without a price of a bit, bytes for the profile's mean bitwidth set the bitwidths, as they do in an encode.
BUDGETED = replace(PAPER, lambda_b=0.0)
# The paper does not say how its Sobel kernels are scaled. Ours are divided by 8; the regularisation goes with the third
# power of that.
NOT_DIVIDED = 8**3


@dataclass(frozen=True)
class Table:
    """A table of the paper. settings: of its rows, by name; numbers: of Gaussians; coded: files, not float fits."""

    settings: dict[str, PaperSettings]
    numbers: tuple[int, ...]
    coded: bool


TABLES = {
    "regularisation": Table(
        {
            **{f"{w:g}": replace(FLOAT, lambda_g=w) for w in (0.0, 0.04, 0.06, 0.08)},
            "0.06, kernels not divided": replace(FLOAT, lambda_g=0.06 * NOT_DIVIDED),
        },
        (70_000,),
        False,
    ),
    "ratio": Table(
        {
            "fixed, 6:2:1": replace(FLOAT, start=replace(FLOAT.start, threshold_factor=math.inf)),
            "dynamic": FLOAT,
            "even, 1:1:1": replace(FLOAT, start=replace(FLOAT.start, ratio=(1.0, 1.0, 1.0))),
        },
        (50_000, 60_000, 70_000),  # with fewer, the dynamic ratio is the fixed one
        False,
    ),
    "quantisation": Table(
        {
            "GSImage": BASELINE,
            **{f"LSQ, {b} bits": replace(PAPER, adaptive_bitwidth=False, min_bitwidth=b) for b in (6, 7, 8)},
            **{f"ABQ, weight {w:g}": replace(PAPER, lambda_b=w) for w in (0.0012, 0.0014)},
            "ABQ, 7.5 bits by a budget": BUDGETED,
        },
        (1000, 3000, 7000),
        True,
    ),
    "positions": Table(
        {f"{bits}": replace(BUDGETED, position_bits=bits) for bits in (16, 14, 12, 10)}, (1000, 3000, 7000), True
    ),
}


def measure(
    table: Table, setting: str, number: int, picture: Path, seed: int, steps: tuple[int, int]
) -> dict[str, Any]:
    """Measure one row. steps: of the fit, and of the tuning."""
    settings = replace(table.settings[setting], fit_steps=steps[0], tune_steps=steps[1])
    pixels = read_image_8_bit(picture.read_bytes())
    if table.coded:
        return _coded(picture, settings, _as_dense(number, pixels), seed)
    return _float(_halved(pixels), settings, number, seed)


def _float(pixels: Pixels, settings: PaperSettings, number: int, seed: int) -> dict[str, Any]:
    part = 0.25
    # N_t = k pixels^alpha is to be that part too.
    start = settings.start
    k = start.threshold_factor * part ** (1 - start.threshold_exponent)
    start = replace(start, ratio_start=round(part * start.ratio_start), threshold_factor=k)
    n = _as_dense(number, pixels)
    began = time.perf_counter()
    fit = fit_of_paper(pixels, n, replace(settings, start=start), seed)
    seconds, shown = time.perf_counter() - began, draw(fit.scene)
    return {"gaussians": n, "psnr": psnr(shown, pixels), "ms_ssim": ms_ssim(shown, pixels), "seconds": seconds}


def _coded(path: Path, settings: PaperSettings, n: int, seed: int) -> dict[str, Any]:
    of_fit = replace(PAPER, start=settings.start, lambda_g=settings.lambda_g, fit_steps=settings.fit_steps)
    began, clock = time.perf_counter(), Clock()
    fit = _fitted(path, of_fit, n, seed)
    budget = file_bytes(int(n * bits_per_gaussian(settings)), settings.max_bitwidth - settings.min_bitwidth + 1)
    tuner = Tuner(fit.gaussians, fit.level, settings, None if settings.lambda_b else budget, seed)
    schedule = Schedule("tune", settings.tune_steps, settings.optimiser, settings.patience)
    schedule.run(Deadline(clock), Recorder(clock), tuner.step)
    stream = tuner.stream("paper" if settings.start.structure_guided else "baseline")
    seconds = time.perf_counter() - began
    data, pixels = container.serialise(stream), read_image_8_bit(path.read_bytes())
    return {
        "gaussians": n,
        "psnr": psnr(draw(stream.scene()), pixels),
        "bpp": 8 * len(data) / (pixels.shape[0] * pixels.shape[1]),
        "bits_of_factor": float(tuner.bits().round().mean()),
        "seconds": seconds,
    }


@lru_cache(maxsize=1)
def _fitted(path: Path, settings: PaperSettings, n: int, seed: int) -> PaperFit:
    return fit_of_paper(read_image_8_bit(path.read_bytes()), n, settings, seed)


def _as_dense(number: int, pixels: Pixels) -> int:
    return max(round(number * pixels[..., 0].size / PIXELS), 1)


def _halved(pixels: Pixels) -> Pixels:
    """A picture at half the size, without an odd last row or column."""
    height, width = pixels.shape[0] // 2, pixels.shape[1] // 2
    even = pixels[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
    return np.asarray(np.round(even.mean((1, 3))), np.uint8)
