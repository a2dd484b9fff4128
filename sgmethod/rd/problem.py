"""What an encode is given: the picture and how its file codes it, and what one run has at hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from sgmethod.backend.protocol import Coding
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.scene import Gaussians, Pixels


@dataclass(frozen=True)
class Problem:
    """A picture to encode, without alpha, and the form of its file.

    is_short: the file is a short one; with_shear: code shear even if no Gaussian has any, as the header of alpha has no
    flag for it.
    """

    objective: Objective
    is_short: bool = False
    with_shear: bool = False

    @property
    def pixels(self) -> Pixels:
        """The picture [H, W, 3]."""
        return self.objective.pixels

    @property
    def size(self) -> tuple[int, int]:
        """The picture's (width, height)."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @cached_property
    def background(self) -> tuple[int, int, int]:
        """Level of each channel below all Gaussians."""
        return coded_background(self.objective.histogram.background, self.is_short)

    @cached_property
    def grey(self) -> bool:
        """Whether chroma is left out."""
        return len(set(self.background)) == 1 and bool((self.pixels == self.pixels[:, :, :1]).all())

    @property
    def is_one_colour(self) -> bool:
        """Whether the picture is its background and needs no Gaussian."""
        return self.objective.histogram.spread == 0

    def coding(self, quantum: float) -> Coding:
        """Parameters with which a quantum codes this picture."""
        return Coding(*self.size, quantum, self.grey, is_short=self.is_short)

    def stream(self, gaussians: Gaussians, quantum: float) -> StreamV2:
        """Code Gaussians."""
        form = self.background, self.grey, self.with_shear, self.is_short
        return StreamV2.from_gaussians(gaussians, self.size, quantum, *form)


@dataclass(frozen=True)
class Session:
    """One run of the encoder: its time, and where it reports its progress."""

    deadline: Deadline
    recorder: Recorder
