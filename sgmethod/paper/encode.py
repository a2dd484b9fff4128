"""Profiles paper and baseline: structure-guided start, fit, quantisation-aware tuning, for a budget of any kind."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sgmethod.bitstream import container, v1
from sgmethod.bitstream.v1 import StreamV1
from sgmethod.decoder import draw
from sgmethod.errors import BudgetError
from sgmethod.fitting.picture import Picture, target_of
from sgmethod.fitting.request import Request
from sgmethod.fitting.schedule import Schedule
from sgmethod.metrics import psnr
from sgmethod.native import native
from sgmethod.paper.fit import fit
from sgmethod.paper.tuning import Tuner, bits_per_gaussian
from sgmethod.profiles import PaperSettings
from sgmethod.start.placement import place

FIT_SHARE = 0.6  # of a time limit; the rest is for tuning
PSNR_ATTEMPTS = 4
PSNR_PER_DOUBLING_DB = 1.7  # of the number of Gaussians; where a search for a PSNR starts from


def encode(request: Request, settings: PaperSettings) -> tuple[bytes, int]:
    """The file, and the optimiser steps it took. Raises BudgetError for a budget no file can meet."""
    encoder = _Encoder(request, settings)
    height, width = request.pixels.shape[:2]
    if request.budget.kind == "psnr":
        stream = encoder.reach_psnr(request.budget.value)
    elif request.budget.kind == "gaussians":
        stream = encoder.run(request.gaussians_asked(), None)
    elif request.budget.kind == "quality":
        raise BudgetError(f"profile {request.profile} has no quality scale; give bpp, bytes, psnr or gaussians")
    else:
        stream = encoder.within_bytes(request.budget.max_bytes(width, height) or 0)
    return container.serialise(stream), encoder.steps


@dataclass
class _Encoder:
    request: Request
    settings: PaperSettings
    steps: int = 0

    def within_bytes(self, max_bytes: int) -> StreamV1:
        """The best stream of at most max_bytes."""
        height, width = self.request.pixels.shape[:2]
        s = self.settings
        groups = s.max_bitwidth - s.min_bitwidth + 1 if s.adaptive_bitwidth else 1
        bits = v1.record_budget_bits(max_bytes, groups)
        least = bits_per_gaussian(replace(s, mean_bitwidth=s.min_bitwidth))
        if bits < least:
            smallest = max_bytes + math.ceil((least - bits) / 8)
            raise BudgetError(
                f"a file of profile {self.request.profile} takes at least {smallest} bytes, the budget is {max_bytes}"
            )
        n = min(max(int(bits // bits_per_gaussian(s)), 1), width * height)
        return self.run(n, max_bytes)

    def reach_psnr(self, target_db: float) -> StreamV1:
        """The smallest stream found that reaches target_db, else the best found.

        Each attempt is a whole encode; the next number of Gaussians follows from the slope of PSNR over the
        logarithm of that number.
        """
        pixels = self.request.pixels.shape[0] * self.request.pixels.shape[1]
        n = max(pixels // 300, 1)
        tried: dict[int, tuple[float, StreamV1]] = {}
        for attempt in range(PSNR_ATTEMPTS):
            stream = self.run(n, None, (attempt + 1) / PSNR_ATTEMPTS)
            tried[n] = (psnr(draw(stream.scene()), self.request.pixels), stream)
            n = _next_count(tried, target_db, pixels)
            if n in tried:
                break
        reached = [m for m, (db, _) in tried.items() if db >= target_db]
        return tried[min(reached)][1] if reached else max(tried.values(), key=lambda t: t[0])[1]

    def run(self, n: int, max_bytes: int | None, share: float = 1.0) -> StreamV1:
        """A stream of n Gaussians, in max_bytes or with bitwidths set by lambda_b. share: of the time, from the start
        of the encode, at which it must be there."""
        request, settings = self.request, self.settings
        begun = request.recorder.clock.seconds()

        def tune_until() -> float | None:
            return request.until_s(share)

        def fit_until() -> float | None:
            until_s = tune_until()
            return None if until_s is None else begun + FIT_SHARE * (until_s - begun)

        image = request.pixels.astype(np.float32)
        image /= 255
        picture = Picture(target_of(request.pixels), settings.lambda_g, native.CUTOFF_V1)
        start = place(image, n, settings, np.random.default_rng(request.seed))
        fitted, fit_steps = fit(picture, start, settings, request.recorder, fit_until)
        tuner = Tuner(fitted, picture, settings, max_bytes, request.seed)
        schedule = Schedule("tune", settings.tune_steps, settings.final_rate, tune_until)
        self.steps += fit_steps + schedule.run(request.recorder, tuner.step)
        return tuner.stream(request.profile)


def _next_count(tried: dict[int, tuple[float, StreamV1]], target_db: float, most: int) -> int:
    """The number of Gaussians to try next, from the two attempts nearest to the target."""
    nearest = sorted(tried, key=lambda m: abs(tried[m][0] - target_db))[:2]
    n, db = nearest[0], tried[nearest[0]][0]
    slope = PSNR_PER_DOUBLING_DB
    if len(nearest) == 2 and nearest[0] != nearest[1]:
        other = nearest[1]
        slope = (db - tried[other][0]) / math.log2(n / other)
        slope = min(max(slope, 0.5), 6.0)
    aim = target_db + 0.05  # a little above, so that the last attempt rather meets the target than misses it
    doublings = min(max((aim - db) / slope, -4.0), 4.0)
    return min(max(round(n * 2**doublings), 1), most)
