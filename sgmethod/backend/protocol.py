"""What the encoder asks of a backend, and the plain data that goes in and out.

Means and factors are always in pixels of the whole picture, whatever the frame's own size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import halved
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.settings.shared import OptimiserSettings

Target = NDArray[np.int16]  # [3, H, W], what Gaussians should add up to; TARGET_WHITE is white
TARGET_WHITE = native.TARGET_WHITE
VISIBLE = native.VISIBLE  # a visibility of 1
CUTOFF_V1, CUTOFF = native.CUTOFF_V1, native.CUTOFF_V2  # sigma at which a Gaussian ends, in versions 1 and 2
GRID_REACH = 1.6  # scales of a Gaussian beyond the picture; a centre may lie two cells out, which are at least 1.68
TILE_HEIGHT = native.TILE_HEIGHT
TEXTURE_OCTAVES, TEXTURE_CELL, TEXTURE_STRENGTHS = (
    native.TEXTURE_OCTAVES,
    native.TEXTURE_CELL,
    native.TEXTURE_STRENGTHS,
)
SEEN_COLOR, SEEN_LUMA = native.SEEN_COLOR, native.SEEN_LUMA
NO_LIMIT = 1 << 40  # bytes
thread_count, release_memory = native.thread_count, native.release_memory

Loss = Callable[[Gaussians], tuple[float, Gaussians]]


@dataclass(frozen=True)
class Frame:
    """Pixels that Gaussians are drawn on.

    width, height: of the frame; cutoff: sigma at which a Gaussian ends; pyramid: wide Gaussians are drawn on coarser
    levels; spacing: pixels of the whole picture along a side of one of the frame's.
    """

    width: int
    height: int
    cutoff: float = CUTOFF
    pyramid: bool = True
    spacing: int = 1


@dataclass(frozen=True)
class Visibility:
    """What each pixel's error counts: int16 [H, W], VISIBLE for 1; by_eye: luma counts more than colour (an error e of
    red, green and blue as e^T color e), or else all three channels alike."""

    values: NDArray[np.int16]
    by_eye: bool = True

    @property
    def color(self) -> NDArray[np.float64]:
        """[3, 3]."""
        return SEEN_COLOR * np.eye(3) + np.outer(SEEN_LUMA, SEEN_LUMA) if self.by_eye else np.eye(3)

    def halved(self) -> Visibility:
        """At half the size: means of four."""
        return Visibility(halved(self.values), self.by_eye)


@dataclass(frozen=True)
class Moments:
    """The optimiser's averages for N Gaussians: first, second [N, 8]; bias [N, 2], powers of beta."""

    first: FloatArray
    second: FloatArray
    bias: FloatArray

    @classmethod
    def none(cls, n: int) -> Moments:
        """Of Gaussians that have not moved yet."""
        return cls(np.zeros((n, 8), np.float32), np.zeros((n, 8), np.float32), np.ones((n, 2), np.float32))

    def copy(self) -> Moments:
        """The same values in memory of their own."""
        return Moments(self.first.copy(), self.second.copy(), self.bias.copy())

    def rows(self, index: NDArray[np.intp]) -> Moments:
        """Those of some Gaussians, in the order of index."""
        return Moments(self.first[index], self.second[index], self.bias[index])

    def with_more(self, count: int) -> Moments:
        """These, and those of `count` new Gaussians."""
        new = Moments.none(count)
        pairs = (self.first, new.first), (self.second, new.second), (self.bias, new.bias)
        return Moments(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Coding:
    """How integers of a file stand for Gaussians: picture size, quantum, whether chroma and shear are left out, and
    whether the file is a short one."""

    width: int
    height: int
    quantum: float
    grey: bool = False
    upright: bool = False
    is_short: bool = False

    @property
    def parameters(self) -> native.RdParameters:
        """For the entropy coder."""
        size = self.width, self.height
        return native.RdParameters(*size, self.quantum, self.grey, self.upright, is_short=self.is_short)


@dataclass(frozen=True)
class RefineLimits:
    """price: squared error, summed over the target, that a bit must be worth; sweeps: over all Gaussians, at most;
    seconds: after which no sweep begins; max_bytes: of the payload; spacing: of the target's frame."""

    price: float
    sweeps: int
    seconds: float
    max_bytes: int
    spacing: int = 1


class Backend(Protocol):
    """Ten functions. Errors are squared and in units of white; visibility weighs them where it is given."""

    def residual(self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0) -> FloatArray:
        """[3, rows, W]: the target's rows, of which first_row is the first, less the Gaussians drawn there."""
        ...

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        """Mean squared error over pixels and channels."""
        ...

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        """The same error, and its gradient by every parameter."""
        ...

    def regularised(self, frame: Frame, image: FloatArray, lambda_g: float) -> Loss:
        """MSE + lambda_g L_g (paper, section III-D) against image [3, H, W] as a function of Gaussians: the MSE, and
        the gradient of the sum."""
        ...

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        """[N, 3]: each Gaussian's inner product, weighed by the visibility alone, with the picture that all draw."""
        ...

    def step(
        self,
        gaussians: Gaussians,
        gradient: Gaussians,
        moments: Moments,
        settings: OptimiserSettings,
        rate: float,
        values: int,
    ) -> None:
        """Move Gaussians, in place, by one step of Adam in each one's own frame, and update the moments.

        A mean moves by L d and a factor by L S with S lower triangular, so a rate is the same relative change for a
        speck and for a wide ellipse. Steps are at most settings.newton_steps of Gauss-Newton's, whose matrix is taken
        for diagonal. rate: times all rates of the settings; values: samples of the picture whose mean is the loss.
        """
        ...

    def add_rate_gradient(self, gaussians: Gaussians, gradient: Gaussians, quantum: float, weight: float) -> None:
        """Add, in place, the gradient of weight times a smooth estimate of all Gaussians' bits: log2(1 + |value| /
        step) of each coded value, and log2(1 + m) for the size and both coordinates, with m the colour's length in
        steps."""
        ...

    def keep_in_range(self, gaussians: Gaussians, width: int, height: int) -> None:
        """Move Gaussians, in place, to where every file of a picture of this size can say them."""
        ...

    def rounded(self, gaussians: Gaussians, coding: Coding) -> Gaussians:
        """What a decoder will see of them; colour 0 where nothing is left."""
        ...

    def refine(
        self, gaussians: Gaussians, coding: Coding, target: Target, limits: RefineLimits, visibility: Visibility | None
    ) -> bytes:
        """The payload of the rounded Gaussians, integers changed one Gaussian at a time where that lowers squared error
        plus price times bits; then without those that gain least for their bits, until it fits."""
        ...
