"""The profiles of this project as codecs, and the file that any codec makes of a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass

from benchmarks.pictures import Pixels
from sgmethod import Budget, decode, encode
from sgmethod.profiles import DEFAULT_EFFORT, Profile, Tune


@dataclass(frozen=True)
class File:
    """A file, the seconds of its encode, and the quality at which another codec made it."""

    data: bytes
    encode_s: float
    quality: float = 0.0


@dataclass(frozen=True)
class Sg:
    """One profile of this project. tune, effort: of profile rd; one_quality: aims at a quality, not at a rate."""

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
        return " ".join([self.profile, *(part for part, is_set in parts.items() if is_set)])

    def best(self, pixels: Pixels, aim: float) -> File:
        """The best file within a rate in bits per pixel, or the file of a quality."""
        budget = Budget("quality" if self.one_quality else "bpp", aim)
        began = time.perf_counter()
        made = encode(pixels, budget, self.profile, tune=self.tune, effort=self.effort)
        return File(made.data, time.perf_counter() - began)

    def decode(self, data: bytes) -> Pixels:
        """Decode a file to pixels [H, W, 3]."""
        return decode(data)
