"""Request: the pipeline's input."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from sgmethod.backend.protocol import Backend, Coding, Frame
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.islands import Islands
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
    recorder: Recorder
    seed: int = 0
    with_shear: bool = False

    @property
    def settings(self) -> RdSettings:
        """Those of its rate control, as far as there is time for them."""
        return self.rate.settings

    def with_settings(self, settings: RdSettings) -> Request:
        """Return the same with other settings."""
        return replace(self, rate=replace(self.rate, settings=settings))

    @property
    def histogram(self) -> Histogram:
        """Statistics of the picture's levels."""
        return self.objective.histogram

    @cached_property
    def background(self) -> tuple[int, int, int]:
        """Level of each channel below all Gaussians."""
        return coded_background(self.histogram.background, self.rate.is_short)

    @property
    def mean(self) -> tuple[int, int, int]:
        """The picture's mean colour, as a file can hold it."""
        return coded_background(self.histogram.mean, self.rate.is_short)

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
        return self.histogram.spread == 0

    @property
    def is_nearly_flat(self) -> bool:
        """Whether the background may miss no more than rounding to 8 bits does."""
        return self.histogram.spread <= 2

    def whole(self) -> Level:
        """Build the level of the whole picture."""
        target = target_of(self.pixels, self.background)
        return Level(self.backend, Frame(*self.size), target, self.objective.visibility)

    def pyramid(self, whole: Level | None = None) -> Pyramid:
        """Build the picture, or the sheet of its islands, in the sizes that its file can show."""
        return Pyramid.from_whole(whole or self.whole(), self.settings.pyramid, self.rate.expected_gaussians())

    def islands(self) -> Islands | None:
        """Find the parts of the picture that differ from its background; None without a colour of more than half."""
        if not self.histogram.has_majority:
            return None
        return Islands.from_pixels(self.pixels, self.histogram.background)

    def coding(self, quantum: float) -> Coding:
        """Parameters with which a quantum codes this picture."""
        return Coding(*self.size, quantum, self.grey, is_short=self.rate.is_short)

    def stream(self, gaussians: Gaussians, quantum: float) -> StreamV2:
        """Code Gaussians."""
        own = self.background, self.grey, self.with_shear, self.rate.is_short
        return StreamV2.from_gaussians(gaussians, self.size, quantum, *own)
