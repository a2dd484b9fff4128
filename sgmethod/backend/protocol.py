"""The interface of a backend, and the plain data passed in and out.

Means and factors are always in pixels of the whole picture, whatever the frame's own size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import halved
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.settings.shared import OptimiserSettings

Target = NDArray[np.int16]  # [3, H, W], the sum that Gaussians should reach; TARGET_WHITE is white
TARGET_WHITE = native.TARGET_WHITE
VISIBLE = native.VISIBLE  # a visibility of 1
COARSE_SIDE = native.COARSE_SIDE  # pixels of the whole picture
CUTOFF, MAX_CUTOFF = native.CUTOFF_V2, native.MAX_CUTOFF  # sigma at which a Gaussian ends; a profile may have a wider
# Distance of a centre beyond the picture, in scales of the Gaussian. Files allow two cells of the grid, at least 1.68.
GRID_REACH = 1.6
TILE_HEIGHT = native.TILE_HEIGHT
TEXTURE_OCTAVES, TEXTURE_CELL = native.TEXTURE_OCTAVES, native.TEXTURE_CELL
TEXTURE_STRENGTHS = native.TEXTURE_STRENGTHS
SEEN_COLOR, SEEN_LUMA = native.SEEN_COLOR, native.SEEN_LUMA
NO_LIMIT = 1 << 40  # bytes
thread_count, release_memory = native.thread_count, native.release_memory
seen_difference = native.seen_difference
to_amplitudes = native.to_amplitudes


@dataclass(frozen=True)
class Frame:
    """The grid of pixels to draw on.

    width, height: of the frame; cutoff: sigma at which a Gaussian ends; pyramid: wide Gaussians are drawn on coarser
    levels; spacing: side of one of the frame's pixels, in pixels of the whole picture.
    """

    width: int
    height: int
    cutoff: float = CUTOFF
    pyramid: bool = True
    spacing: int = 1


@dataclass(frozen=True)
class Visibility:
    """Weights of the pixels' errors.

    values: int16 [H, W], VISIBLE for 1; by_eye: an error e in red, green and blue counts e^T color e, so that luma
    counts more than colour; otherwise all three channels count alike; coarse: weight with which the mean error of each
    square of COARSE_SIDE pixels of the whole picture counts once more, in errors, gradients and steps alone.
    """

    values: NDArray[np.int16]
    by_eye: bool = True
    coarse: float = 0.0

    @property
    def color(self) -> NDArray[np.float64]:
        """Weights [3, 3] of products of two channels' errors."""
        return SEEN_COLOR * np.eye(3) + np.outer(SEEN_LUMA, SEEN_LUMA) if self.by_eye else np.eye(3)

    @cached_property
    def half(self) -> Visibility:
        """The visibility at half the size, by means of four."""
        return replace(self, values=halved(self.values))


@dataclass(frozen=True)
class Moments:
    """The optimiser's averages for N Gaussians: first, second [N, 8]; bias [N, 2], powers of beta."""

    first: FloatArray
    second: FloatArray
    bias: FloatArray

    @classmethod
    def none(cls, n: int) -> Moments:
        """Initial moments of n Gaussians."""
        return cls(np.zeros((n, 8), np.float32), np.zeros((n, 8), np.float32), np.ones((n, 2), np.float32))

    def copy(self) -> Moments:
        """Return a deep copy."""
        return Moments(self.first.copy(), self.second.copy(), self.bias.copy())

    def rows(self, index: NDArray[np.intp]) -> Moments:
        """Return the moments at `index`, in its order."""
        return Moments(self.first[index], self.second[index], self.bias[index])

    def with_more(self, count: int) -> Moments:
        """Return these moments followed by initial moments for `count` new Gaussians."""
        new = Moments.none(count)
        pairs = (self.first, new.first), (self.second, new.second), (self.bias, new.bias)
        return Moments(*(np.concatenate(pair) for pair in pairs))


@dataclass(frozen=True)
class Coding:
    """Parameters of the quantisation of Gaussians to a file's integers.

    width, height: of the picture; grey, upright: chroma or shear is left out; is_short: the file is a short one.
    """

    width: int
    height: int
    quantum: float
    grey: bool = False
    upright: bool = False
    is_short: bool = False

    @property
    def parameters(self) -> native.RdParameters:
        """The same parameters for the kernels."""
        size = self.width, self.height
        return native.RdParameters(*size, self.quantum, self.grey, self.upright, is_short=self.is_short)


@dataclass(frozen=True)
class RefineLimits:
    """Limits of a search over a file's integers.

    price: squared error, summed over the target, that a bit must be worth; sweeps: most passes over all Gaussians;
    seconds: no sweep begins later; max_bytes: of the payload; spacing: of the target's frame.
    """

    price: float
    sweeps: int
    seconds: float
    max_bytes: int
    spacing: int = 1


@dataclass(frozen=True)
class Descent:
    """The sum that the steps of a fit minimise, and the settings with which they do.

    It is the error on a frame, plus `price` for each bit at a quantum: squared error, as a mean over the `values` of
    the picture. width, height: of the picture.
    """

    frame: Frame
    target: Target
    visibility: Visibility | None
    quantum: float
    price: float
    width: int
    height: int
    settings: OptimiserSettings

    @property
    def values(self) -> int:
        """Samples of the picture."""
        return 3 * self.width * self.height


class Backend(Protocol):
    """The eight functions of a backend. Errors are squared, 1 being white, and weighted by a visibility if given."""

    def residual(
        self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0, *, half: bool = False
    ) -> FloatArray:
        """Target minus drawn Gaussians, [3, rows, W], for the rows of a target that begin at first_row.

        half: reduced to half the size, by all_halved(); first_row is a multiple of TILE_HEIGHT.
        """

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        """Mean squared error over pixels and channels."""

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        """Mean squared error, and its gradient by every parameter."""

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        """Inner product [N, 3] of each Gaussian with the picture of all, weighted by visibility.values only."""

    def keep_in_range(self, gaussians: Gaussians, width: int, height: int) -> None:
        """Clamp Gaussians, in place, to values that every file of a picture of this size can represent."""

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        """Move Gaussians in place by a step of the optimiser for each rate, down the gradient of error and price.

        Returns the mean squared error before each step, as gradients() weighs it, or nothing, if that takes time.
        """

    def rounded(self, gaussians: Gaussians, coding: Coding) -> Gaussians:
        """Gaussians as a decoder will see them, with colour 0 if they round to nothing."""

    def refine(
        self, gaussians: Gaussians, coding: Coding, target: Target, limits: RefineLimits, visibility: Visibility | None
    ) -> bytes:
        """Search for a payload that minimises squared error plus price times bits.

        The rounded integers change one Gaussian at a time where that lowers the sum. Then the Gaussians that gain least
        for their bits are dropped until the payload fits.
        """
