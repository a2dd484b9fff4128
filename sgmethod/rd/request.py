"""Request: what the pipeline is given."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import Backend, Coding, Frame
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.level import Histogram, Level, Pyramid, target_of
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.rate_control import RateControl
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Request:
    """One picture to encode, without alpha: everything that its pipeline needs to know.

    with_shear: shear is coded even where no Gaussian has any, as an alpha part has no flag that says so; spread: of
    the levels of a channel, at most.
    """

    objective: Objective
    rate: RateControl
    deadline: Deadline
    backend: Backend
    settings: RdSettings
    recorder: Recorder
    seed: int = 0
    with_shear: bool = False
    background: tuple[int, int, int] = field(init=False)
    grey: bool = field(init=False)
    spread: int = field(init=False)

    def __post_init__(self) -> None:
        pixels, found = self.pixels, Histogram(self.pixels)
        background = coded_background(found.background, self.rate.is_short)
        grey = len(set(background)) == 1 and bool((pixels == pixels[:, :, :1]).all())
        object.__setattr__(self, "background", background)
        object.__setattr__(self, "grey", grey)
        object.__setattr__(self, "spread", found.spread)

    @property
    def pixels(self) -> Pixels:
        """[H, W, 3]."""
        return self.objective.pixels

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def samples(self) -> int:
        """Of the picture, whose mean squared error is minimised."""
        return self.pixels.size

    @property
    def is_one_colour(self) -> bool:
        """Whether the picture is its background, and needs no Gaussian."""
        return self.spread == 0

    @property
    def is_nearly_flat(self) -> bool:
        """Whether rounding to 8 bits may be all that the background misses."""
        return self.spread <= 2

    def pyramid(self) -> Pyramid:
        """The picture in the sizes that its file can show."""
        target = target_of(self.pixels, self.background)
        whole = Level(self.backend, Frame(*self.size), target, self.objective.visibility)
        return Pyramid.of(whole, self.settings.pyramid, self.rate.expected_gaussians())

    def coding(self, quantum: float) -> Coding:
        """How a quantum codes this picture."""
        return Coding(*self.size, quantum, self.grey, is_short=self.rate.is_short)

    def stream(self, gaussians: Gaussians, quantum: float) -> StreamV2:
        """The coded picture."""
        own = self.background, self.grey, self.with_shear, self.rate.is_short
        return StreamV2.of(gaussians, self.size, quantum, *own)
