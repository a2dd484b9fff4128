"""Request: the pipeline's input."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from sgmethod.backend.protocol import Backend, Coding, Frame
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.level import Histogram, Level, Pyramid, target_of
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd.rate_control import RateControl
from sgmethod.scene import Gaussians, Pixels
from sgmethod.settings.rd import RdSettings


@dataclass(frozen=True)
class Request:
    """A picture to encode, without alpha, and everything that its pipeline needs to know.

    with_shear: code shear even if no Gaussian has any, as the header of alpha has no flag for it.
    """

    objective: Objective
    rate: RateControl
    deadline: Deadline
    backend: Backend
    settings: RdSettings
    recorder: Recorder
    seed: int = 0
    with_shear: bool = False

    @cached_property
    def _histogram(self) -> Histogram:
        return Histogram(self.pixels)

    @cached_property
    def background(self) -> tuple[int, int, int]:
        """Level of each channel below all Gaussians."""
        return coded_background(self._histogram.background, self.rate.is_short)

    @cached_property
    def grey(self) -> bool:
        """Whether chroma is left out."""
        return len(set(self.background)) == 1 and bool((self.pixels == self.pixels[:, :, :1]).all())

    @property
    def pixels(self) -> Pixels:
        """The picture [H, W, 3]."""
        return self.objective.pixels

    @property
    def size(self) -> tuple[int, int]:
        """The picture's (width, height)."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def samples(self) -> int:
        """Number of values whose mean squared error is minimised."""
        return self.pixels.size

    @property
    def is_one_colour(self) -> bool:
        """Whether the picture is its background and needs no Gaussian."""
        return self._histogram.spread == 0

    @property
    def is_nearly_flat(self) -> bool:
        """Whether the background may miss no more than rounding to 8 bits does."""
        return self._histogram.spread <= 2

    def pyramid(self) -> Pyramid:
        """Build the picture in the sizes that its file can show."""
        target = target_of(self.pixels, self.background)
        whole = Level(self.backend, Frame(*self.size), target, self.objective.visibility)
        return Pyramid.from_whole(whole, self.settings.pyramid, self.rate.expected_gaussians())

    def coding(self, quantum: float) -> Coding:
        """Parameters with which a quantum codes this picture."""
        return Coding(*self.size, quantum, self.grey, is_short=self.rate.is_short)

    def stream(self, gaussians: Gaussians, quantum: float) -> StreamV2:
        """Code Gaussians."""
        own = self.background, self.grey, self.with_shear, self.rate.is_short
        return StreamV2.from_gaussians(gaussians, self.size, quantum, *own)
