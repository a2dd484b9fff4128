"""A target that moves during the fit, as a function of how far the picture is from it.

The eye sees coarse errors more than fine ones. With K e the mean of an error e over small squares, (e + K e)^T V e
counts in place of e^T V e. Its gradient, V (e + K e), is that of an error against a target that lies K e further off.
So the target is moved every few steps, and kernels see nothing of it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import TARGET_WHITE, Target
from sgmethod.fitting.bands import Rows, bands
from sgmethod.scene import FloatArray
from sgmethod.settings.rd import MovingTargetSettings


class MovingTarget:
    """A target, [3, H, W], which never moves unless a subclass says how.

    now: as it was last moved; hides: grain was hidden already, or never will be.
    """

    hides = True

    def __init__(self, target: Target) -> None:
        self.now = self._original = target

    def is_due(self, _step: int, _has_grown: bool) -> bool:
        """Whether to follow() before this step; has_grown: the growth of this run is over."""
        return False

    def follow(self, error: Rows) -> None:
        """Move. error: the original target less the picture, by rows."""

    def hide(self, grain: Target) -> None:
        """Take this much off the target from now on, [3, H, W]."""


class AheadOfCoarseError(MovingTarget):
    """Runs ahead of recent coarse errors, for the eye, less the grain that is hidden.

    Only once the growth of a run is over: growth would take the difference for error, add wide Gaussians and leave fine
    errors alone.
    """

    hides = False

    def __init__(self, target: Target, shrink: int, settings: MovingTargetSettings) -> None:
        """shrink: coarse errors are means over squares of this side, in samples of the target."""
        super().__init__(target)
        self._settings, self._shrink = settings, shrink
        self._grain: Target | None = None
        self._by: FloatArray | None = None  # at a fraction of the size

    def is_due(self, step: int, has_grown: bool) -> bool:
        """As MovingTarget.is_due."""
        return has_grown and step % self._settings.every == 0

    def hide(self, grain: Target) -> None:
        """As MovingTarget.hide."""
        self._grain, self.hides = grain, True

    def follow(self, error: Rows) -> None:
        """As MovingTarget.follow."""
        s, shrink, (_, height, width) = self._settings, self._shrink, self._original.shape
        coarse = np.empty((3, -(-height // shrink), -(-width // shrink)), np.float32)
        for first, end in bands(height, width):
            here = slice(first // shrink, -(-end // shrink))
            for plane, to in zip(error(first, end), coarse[:, here], strict=True):
                to[...] = cv2.resize(plane, to.shape[::-1], interpolation=cv2.INTER_AREA)
        np.clip(coarse, -s.furthest, s.furthest, out=coarse)
        self._by = coarse if self._by is None else self._by + np.float32(s.rate) * (coarse - self._by)
        if self.now is self._original:
            self.now = np.empty_like(self._original)
        moved = np.rint(self._by * TARGET_WHITE).astype(np.int16)
        for plane, by, to in zip(self._original, moved, self.now, strict=True):
            np.add(plane, cv2.resize(by, (width, height), interpolation=cv2.INTER_LINEAR), out=to)
        if self._grain is not None:
            self.now -= self._grain


class BeyondBlackAndWhite(MovingTarget):
    """Wherever the picture is beyond black or white, which decoding clamps; for alpha.

    So an edge need not end where it comes to black or white, which a Gaussian finds hard. Where it is steep, a margin
    beyond is asked for. Values much further out would show in reductions, which are drawn smaller before they are
    clamped.
    """

    def __init__(self, target: Target, background: int, settings: MovingTargetSettings) -> None:
        """background: the grey level that the target is above."""
        super().__init__(target)
        s = self._settings = settings
        level = np.clip((target[0] + TARGET_WHITE // 510) // (TARGET_WHITE // 255) + background, 0, 255).astype(
            np.uint8
        )
        ends = [(level == 0).astype(np.float32), (level == 255).astype(np.float32)]
        margin = s.margin + s.of_slope * np.minimum(_slope(level), s.most_slope)
        # From the target to the nearest and the furthest that the picture may be beyond it.
        self._low = ends[1] * margin - ends[0] * s.overshoot
        self._high = ends[1] * s.overshoot - ends[0] * margin

    def is_due(self, step: int, _has_grown: bool) -> bool:
        """As MovingTarget.is_due."""
        return step % self._settings.overshoot_every == 0

    def follow(self, error: Rows) -> None:
        """As MovingTarget.follow."""
        _, height, width = self._original.shape
        moved_target = np.empty_like(self._original)
        for first, end in bands(height, width):
            here = slice(first, end)
            beyond = np.clip(-error(first, end)[0], self._low[here], self._high[here])
            moved = np.rint(beyond * TARGET_WHITE).astype(np.int16)
            np.add(self._original[:, here], moved, out=moved_target[:, here])
        self.now = moved_target


def _slope(level: NDArray[np.uint8]) -> FloatArray:
    """The largest change from pixel to pixel near each of them, 1 being white."""
    x, y = (
        cv2.Scharr(level, cv2.CV_32F, *by, scale=1 / (32 * 255), borderType=cv2.BORDER_REPLICATE)
        for by in ((1, 0), (0, 1))
    )
    return np.asarray(cv2.dilate(np.hypot(x, y), np.ones((3, 3), np.uint8)), np.float32)
