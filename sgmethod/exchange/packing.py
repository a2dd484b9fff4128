"""Gaussians that were made elsewhere -> an .sg file."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer, finite_number
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import NO_LIMIT, Coding, RefineLimits
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import MAX_QUANTUM, MIN_QUANTUM, StreamV2, is_upright
from sgmethod.budget import MAX_GAUSSIANS, Budget
from sgmethod.errors import BudgetError, GaussiansError, ImageError
from sgmethod.exchange.arrays import checked_array, checked_gaussians
from sgmethod.fitting.level import target_of
from sgmethod.io.image import Input, read_input
from sgmethod.native import native
from sgmethod.numerics import quiet
from sgmethod.rd.rate_control import error_per_bit
from sgmethod.scene import Gaussians

SWEEPS = 2  # of refining, over all Gaussians


@quiet
def pack(
    gaussians: Gaussians,
    width: AnyInt,
    height: AnyInt,
    *,
    bpp: AnyFloat | None = None,
    quantum: AnyFloat | None = None,
    background: Any = (0.0, 0.0, 0.0),
    image: Input | None = None,
) -> bytes:
    """Write Gaussians over a picture of width x height pixels to an .sg file.

    >>> file = sgmethod.open("photo.sg")
    >>> again = sgmethod.pack(file.gaussians(), *file.size, quantum=0.2, background=file.background)
    >>> sgmethod.info(again).gaussians <= sgmethod.info("photo.sg").gaussians
    True

    gaussians: NumPy arrays, tensors or nested lists. They add up on the background, and are drawn as
    sgmethod.torch.render() draws them. Gaussians that round to nothing or touch no pixel are left out.
    bpp: maximum bits per pixel of the file; quantum: how coarsely everything is rounded, 2^-10 to 16 (encode() uses
    about 0.15 at 0.25 bpp). Give exactly one of them.
    background: red, green and blue, 1 being full white, as a sequence, an array or a tensor; rounded to 8 bits.
    image: the picture, as encode() takes it. Rounded values are then refined one Gaussian at a time to be closer to it.

    Raises GaussiansError if no file can hold the Gaussians, BudgetError, and ImageError for a picture of another size.
    """
    width, height = (checked_integer(side, "a side", 1, native.MAX_SIDE, GaussiansError) for side in (width, height))
    own = reaching_pixels(checked_gaussians(gaussians), (width, height))
    if len(own) > min(width * height, MAX_GAUSSIANS):
        raise GaussiansError(f"{len(own)} Gaussians are more than a file of {width} x {height} pixels can hold")
    below = _levels(background)
    target = None if image is None else target_of(_pixels(image, width, height), below)
    packed = _Packing(own, (width, height), below, target)
    if (bpp is None) == (quantum is None):
        raise BudgetError("one of bpp and quantum is needed")
    if bpp is not None:
        return container.serialise(packed.within(Budget("bpp", bpp).max_bytes(width, height) or 0))
    number = finite_number(quantum)
    if number is None or not MIN_QUANTUM <= number <= MAX_QUANTUM:
        raise BudgetError(f"the quantum must be from {MIN_QUANTUM} to {MAX_QUANTUM:g}, got {quantum!r}")
    return container.serialise(packed.stream(number))


class _Packing:
    """Coding of Gaussians over a picture of size (width, height), refined on a target if there is one."""

    def __init__(
        self,
        gaussians: Gaussians,
        size: tuple[int, int],
        background: tuple[int, int, int],
        target: NDArray[np.int16] | None,
    ) -> None:
        self._gaussians, self._size, self._background, self._target = gaussians, size, background, target
        self._grey = len(set(background)) == 1 and bool((gaussians.colors == gaussians.colors[:, :1]).all())

    def stream(self, quantum: float, max_bytes: int = NO_LIMIT) -> StreamV2:
        """Code Gaussians with this quantum; if there is a target, refine them to at most max_bytes of payload."""
        quantum = StreamV2.coded_quantum(quantum)
        self._check_range(quantum)
        rounded = self._coded(self._gaussians, quantum)
        if self._target is None:
            return rounded
        limits = RefineLimits(error_per_bit(quantum), SWEEPS, math.inf, max_bytes)
        coding = Coding(*self._size, quantum, self._grey, rounded.upright)
        payload = Kernels().refine(self._gaussians, coding, self._target, limits, None)
        return replace(rounded, payload=payload)

    def _coded(self, gaussians: Gaussians, quantum: float) -> StreamV2:
        return StreamV2.from_gaussians(gaussians, self._size, quantum, self._background, self._grey)

    def within(self, max_bytes: int) -> StreamV2:
        """Code Gaussians with the finest quantum for a file of at most max_bytes."""
        limit = max_bytes - self._coded(Gaussians.empty(0), MAX_QUANTUM).file_bytes
        found = self.stream(self._quantum(limit, max_bytes), limit)
        if self._target is None or not found.payload:
            return found
        spared = limit * limit // len(found.payload)  # refining saves bytes, which buy a finer quantum
        return self.stream(self._quantum(spared, max_bytes), limit)

    def _quantum(self, limit: int, max_bytes: int) -> float:
        """Find about the finest quantum whose payload has at most `limit` bytes before refining."""

        def payload(quantum: float) -> int:
            return len(self._coded(self._gaussians, quantum).payload)

        if payload(MAX_QUANTUM) > limit:
            raise BudgetError(f"no file of these Gaussians fits into {max_bytes} bytes: take fewer, or more bpp")
        fine, coarse = MIN_QUANTUM, MAX_QUANTUM
        while coarse > 1.004 * fine:  # about a step of the quantum's code
            middle = math.sqrt(fine * coarse)
            fine, coarse = (fine, middle) if payload(middle) <= limit else (middle, coarse)
        return coarse

    def _check_range(self, quantum: float) -> None:
        """Raise GaussiansError for the first Gaussian with a value that would be clipped."""
        parameters = Coding(*self._size, quantum, self._grey, is_upright(self._gaussians.factors, False)).parameters

        def clipped(some: Gaussians) -> bool:
            return native.rd_quantise(parameters, *some.arrays, *Gaussians.empty(len(some)).arrays) > 0

        if not clipped(self._gaussians):
            return
        some = self._gaussians
        while len(some) > 1:
            first, second = (some.rows(half) for half in np.array_split(np.arange(len(some)), 2))
            some = first if clipped(first) else second
        numbers = ", ".join(str(values[0].tolist()) for values in some.arrays)
        raise GaussiansError(
            f"no file can hold a Gaussian with mean, factors and colour {numbers}: its size sqrt(l1 l3) must be about "
            "0.21 to 19,500 pixels, neither of l1 and l3 more than 8.9 million times the other, |l2| at most 4096 l3, "
            "its centre within about 1.6 sizes of the picture, and its colour at most 2^22 steps"
        )


def reaching_pixels(gaussians: Gaussians, size: tuple[int, int]) -> Gaussians:
    """Return the Gaussians that reach a pixel's centre in a picture of this size."""
    reach, (width, height) = math.sqrt(2 * native.CUTOFF_V2), size
    x, y = gaussians.means.T.astype(np.float64)
    l1, l2, l3 = gaussians.factors.T.astype(np.float64)
    column = np.clip(np.ceil(x - reach * l1 - 0.5), 0, width)
    last = np.clip(np.floor(x + reach * l1 - 0.5), -1, width - 1)
    touches = np.zeros(len(gaussians), np.bool_)
    waiting = np.flatnonzero(column <= last)
    while len(waiting):  # a column at a time, as most reach a pixel in their first or second
        dx = column[waiting] + 0.5 - x[waiting]
        middle = y[waiting] + l2[waiting] / l1[waiting] * dx
        half = l3[waiting] * np.sqrt(np.maximum(reach**2 - np.square(dx / l1[waiting]), 0))
        touches[waiting] = np.maximum(np.ceil(middle - half - 0.5), 0) <= np.minimum(
            np.floor(middle + half - 0.5), height - 1
        )
        column[waiting] += 1
        waiting = waiting[~touches[waiting] & (column[waiting] <= last[waiting])]
    return gaussians.rows(np.flatnonzero(touches))


def _levels(background: Any) -> tuple[int, int, int]:
    """Convert a background in parts of white to 8-bit levels."""
    parts = checked_array(background, np.float64)
    if parts.shape != (3,) or not ((parts >= 0) & (parts <= 1)).all():
        raise GaussiansError(f"a background is three numbers from 0 to 1, not {background!r}")
    red, green, blue = (round(255 * part) for part in parts.tolist())
    return red, green, blue


def _pixels(image: Input, width: int, height: int) -> NDArray[np.uint8]:
    pixels = read_input(image)
    if pixels.shape[:2] != (height, width):
        found = f"{pixels.shape[1]} x {pixels.shape[0]}"
        raise ImageError(f"the picture has {found} pixels, and {width} x {height} were asked for")
    return pixels
