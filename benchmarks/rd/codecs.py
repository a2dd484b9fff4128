"""The profiles of this project as codecs, and the file that any codec makes of a picture."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from benchmarks.pictures import Pixels
from sgmethod import decode, encode
from sgmethod.bitstream import container
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.profiles import DEFAULT_EFFORT, EFFORTS, Profile, Tune
from sgmethod.rd import encode as rd
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import RateControl
from sgmethod.settings.rd import RdSettings


@dataclass(frozen=True)
class File:
    """A file, the seconds of its encode, and the quality at which another codec made it."""

    data: bytes
    encode_s: float
    quality: float = 0.0


@dataclass(frozen=True)
class Sg:
    """One profile of this project.

    tune, effort: of profile rd; one_quality: what is aimed at is not bits per pixel but one quantum for all
    pictures, given as a quality: 16 points halve it.
    """

    profile: Profile
    tune: Tune = "psnr"
    effort: int = DEFAULT_EFFORT
    one_quality: bool = False

    @property
    def name(self) -> str:
        """The profile, and every setting that is not the usual one."""
        parts = {
            self.tune: self.tune != "psnr",
            f"effort {self.effort}": self.effort != DEFAULT_EFFORT,
            "one quality": self.one_quality,
        }
        return " ".join([self.profile, *(part for part, is_set in parts.items() if is_set)])

    def best(self, pixels: Pixels, aim: float) -> File:
        """The best file within a rate in bits per pixel, or the file of a quality."""
        began = time.perf_counter()
        if self.one_quality:
            data = self._at_quantum(pixels, 3.2 * 2 ** (-aim / 16))
        else:
            tuned: dict[str, Any] = {"tune": self.tune, "effort": self.effort, "profile": self.profile}
            data = encode(pixels, bpp=aim, **tuned).data
        return File(data, time.perf_counter() - began)

    def decode(self, data: bytes) -> Pixels:
        """Decode a file to pixels [H, W, 3]."""
        return decode(data)

    def _at_quantum(self, pixels: Pixels, quantum: float) -> bytes:
        """The file of a fixed quantum, which is no budget."""
        clock, rate = Clock(), RateControl(pixels.shape[0] * pixels.shape[1], quantum)
        problem = Problem(Objective.from_pixels(pixels, self.tune))
        session = Session(Deadline.from_limit(clock), Recorder(clock))
        stream, _ = rd.encode(problem, RdSettings(EFFORTS[self.effort]), rate, session)
        return container.serialise(stream)
