"""What moves the target of a fit while it goes on, as far as the picture is from it."""

from __future__ import annotations

from typing import ClassVar, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.fitting.bands import Rows, bands
from sgmethod.fitting.eye import SHRINK
from sgmethod.native import native
from sgmethod.scene import FloatArray

Target = NDArray[np.int16]


class Lead(Protocol):
    """A target, unmoved and as it was last moved: [3, H, W], in which native.TARGET_WHITE is white."""

    EVERY: ClassVar[int]  # steps
    WHILE_GROWING: ClassVar[bool]
    unmoved: Target
    target: Target

    def follow(self, error: Rows) -> None:
        """Move the target; error: unmoved, it less the picture, by rows."""
        ...


class CoarseError:
    """Moved by its coarse error as that was lately, for the eye (eye.py), and by the grain that is hidden.

    Growth would take what moved the target for error, add wide Gaussians for it and leave fine errors alone.
    """

    EVERY: ClassVar[int] = 4
    WHILE_GROWING: ClassVar[bool] = False
    RATE = 0.15  # of the way to the error of now, at once: from 0.5 on, target and fit swing ever wider
    FURTHEST = 0.1  # 1 being white

    def __init__(self, target: Target) -> None:
        self.unmoved, self.target = target, target
        self.grain: Target | None = None  # [3, H, W]
        _, height, width = target.shape
        self.size = (-(-height // SHRINK), -(-width // SHRINK))
        self.by: FloatArray | None = None  # [3, *size]

    def follow(self, error: Rows) -> None:
        """As Lead.follow."""
        _, height, width = self.unmoved.shape
        coarse = np.empty((3, *self.size), np.float32)
        for first, end in bands(height, width):
            here = slice(first // SHRINK, -(-end // SHRINK))
            for plane, to in zip(error(first, end), coarse[:, here], strict=True):
                to[...] = cv2.resize(plane, to.shape[::-1], interpolation=cv2.INTER_AREA)
        np.clip(coarse, -self.FURTHEST, self.FURTHEST, out=coarse)
        self.by = coarse if self.by is None else self.by + np.float32(self.RATE) * (coarse - self.by)
        if self.target is self.unmoved:
            self.target = np.empty_like(self.unmoved)
        moved = np.rint(self.by * native.TARGET_WHITE).astype(np.int16)
        for plane, by, to in zip(self.unmoved, moved, self.target, strict=True):
            np.add(plane, cv2.resize(by, (width, height), interpolation=cv2.INTER_LINEAR), out=to)
        if self.grain is not None:
            self.target -= self.grain


class Overshoot:
    """Wherever the picture is beyond black or white, as decoding clamps it: what is there to be either may lie beyond.

    So an edge need not end where it comes to black or white, which a Gaussian finds hard. Where it is steep, a margin
    beyond is asked for. What is much further beyond would show in reductions, which are drawn smaller before they are
    clamped.
    """

    EVERY: ClassVar[int] = 2
    WHILE_GROWING: ClassVar[bool] = True
    MARGIN, OF_SLOPE = 0.02, 0.3  # of white, and of the steepest change from pixel to pixel nearby
    MOST_SLOPE = 0.67

    def __init__(self, target: Target, pixels: NDArray[np.uint8], most: float) -> None:
        """pixels [H, W, 3]: grey levels, of the target; most: how far beyond, 1 being white."""
        self.unmoved, self.target = target, target
        level = np.ascontiguousarray(pixels[..., 0])
        ends = [(level == 0).astype(np.float32), (level == 255).astype(np.float32)]
        margin = self.MARGIN + self.OF_SLOPE * np.minimum(_slope(level), self.MOST_SLOPE)
        # From the target to the nearest and the furthest that the picture may be beyond it.
        self.low, self.high = ends[1] * margin - ends[0] * most, ends[1] * most - ends[0] * margin

    def follow(self, error: Rows) -> None:
        """As Lead.follow."""
        _, height, width = self.unmoved.shape
        self.target = np.empty_like(self.unmoved)
        for first, end in bands(height, width):
            here = slice(first, end)
            beyond = np.clip(-error(first, end)[0], self.low[here], self.high[here])
            moved = np.rint(beyond * native.TARGET_WHITE).astype(np.int16)
            np.add(self.unmoved[:, here], moved, out=self.target[:, here])


def _slope(level: NDArray[np.uint8]) -> FloatArray:
    """The largest change from pixel to pixel near each of them, 1 being white."""
    x, y = (
        cv2.Scharr(level, cv2.CV_32F, *by, scale=1 / (32 * 255), borderType=cv2.BORDER_REPLICATE)
        for by in ((1, 0), (0, 1))
    )
    return np.asarray(cv2.dilate(np.hypot(x, y), np.ones((3, 3), np.uint8)), np.float32)
