"""The profiles of this project as codecs, and what any codec makes of a picture."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.pictures import Pixels
from sgmethod import Budget, decode, encode, info
from sgmethod.profiles import DEFAULT_EFFORT, Profile, Tune


@dataclass(frozen=True)
class Run:
    """What a codec made of a picture [H, W, 3]."""

    data: bytes
    encode_s: float
    decode: Callable[[bytes], Pixels]
    gaussians: int | None = None


@dataclass(frozen=True)
class Sg:
    """One profile of this project.

    tune, effort: of profile rd; one_quality: what is aimed at is a quality and not bits per pixel.
    """

    profile: Profile
    tune: Tune = "psnr"
    effort: int = DEFAULT_EFFORT
    one_quality: bool = False

    @property
    def name(self) -> str:
        """The profile, and every setting that is not the usual one."""
        parts = {
            "visual": self.tune == "visual",
            f"effort {self.effort}": self.effort != DEFAULT_EFFORT,
            "one quality": self.one_quality,
        }
        return " ".join([self.profile, *(part for part, said in parts.items() if said)])

    def run(self, pixels: Pixels, aim: float) -> Run:
        """The best file within a rate in bits per pixel, or the file of a quality."""
        budget = Budget("quality" if self.one_quality else "bpp", aim)
        began = time.perf_counter()
        made = encode(pixels, budget, self.profile, tune=self.tune, effort=self.effort)
        return Run(made.data, time.perf_counter() - began, decode, info(made.data).gaussians)
