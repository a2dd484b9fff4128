"""The picture that Gaussians are fitted to, at its own size and at half of it, and so on.

Few Gaussians learn as much from few pixels. Means and factors stay in pixels of the whole picture on every level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import takewhile

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import TARGET_WHITE, Backend, Frame, Target, Visibility
from sgmethod.fitting.bands import Rows
from sgmethod.fitting.visibility import amplitudes
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.settings.rd import PyramidSettings


def target_of(pixels: NDArray[np.uint8], background: tuple[int, int, int] = (0, 0, 0)) -> Target:
    """The sum that Gaussians on a background should reach, [3, H, W], for pixels [H, W, 3]: TARGET_WHITE is white."""
    target = np.empty((3, *pixels.shape[:2]), np.int16)
    for plane, channel, below in zip(target, pixels.transpose(2, 0, 1), background, strict=True):
        np.subtract(channel, below, out=plane, dtype=np.int16)
        plane *= TARGET_WHITE // 255
    return target


@dataclass(frozen=True)
class Level:
    """One size of the picture: its target, and what each pixel's error counts."""

    backend: Backend
    frame: Frame
    target: Target
    visibility: Visibility | None = None

    @property
    def values(self) -> int:
        """Samples of the target."""
        return self.target.size

    @property
    def pixels(self) -> int:
        """Of this level."""
        return self.frame.height * self.frame.width

    def halved(self) -> Level:
        """The level of half the size."""
        f, even = self.frame, self.target
        if f.height % 2 or f.width % 2:
            even = np.pad(even, ((0, 0), (0, f.height % 2), (0, f.width % 2)), mode="edge")
        sums = np.add(even[:, 0::2, 0::2], even[:, 1::2, 0::2], dtype=np.int32)
        sums += even[:, 0::2, 1::2]
        sums += even[:, 1::2, 1::2]
        sums += 2
        sums >>= 2
        _, height, width = sums.shape
        visibility = None if self.visibility is None else self.visibility.halved()
        frame = replace(f, height=height, width=width, spacing=2 * f.spacing)
        return replace(self, frame=frame, target=sums.astype(np.int16), visibility=visibility)

    def image(self) -> FloatArray:
        """The target as floats [3, H, W], in which 1 is white."""
        return self.target.astype(np.float32) / np.float32(TARGET_WHITE)

    def gradients(self, gaussians: Gaussians) -> tuple[float, Gaussians]:
        """Mean squared error as it counts, and its gradient by each parameter."""
        return self.backend.gradients(gaussians, self.frame, self.target, self.visibility)

    def missing(self, gaussians: Gaussians) -> Rows:
        """Target less picture, drawn when it is asked for rows."""

        def rows(first: int, end: int) -> FloatArray:
            return self.backend.residual(gaussians, self.frame, self.target[:, first:end], first)

        return rows

    def residual(self, gaussians: Gaussians) -> Rows:
        """The same, scaled so that its squares are what the error counts."""
        visibility, missing = self.visibility, self.missing(gaussians)
        if visibility is None:
            return missing
        return lambda first, end: amplitudes(visibility, missing(first, end), first, end)

    def solve_colors(
        self, shapes: Gaussians, steps: int, others: Gaussians | None = None, damping: float = 1e-2
    ) -> Gaussians:
        """The shapes with colours near the least-squares solution: the image is linear in them.

        Conjugate gradients from zero on the normal equations, preconditioned by the Gaussians' energies
        pi l1 l3, of which `damping` is added to the diagonal. The target is this level's, less others.
        """
        n, f = len(shapes), shapes.factors
        energy = np.maximum(np.float32(math.pi / self.frame.spacing**2) * f[:, :1] * f[:, 2:], np.float32(1e-12))
        black = Gaussians(shapes.means, f, np.zeros((n, 3), np.float32))
        _, gradients = self.gradients(black if others is None else others.with_more(black))
        residual = gradients.colors[-n:] * np.float32(-self.values / 2)  # each one's product with the residual
        if self.visibility is not None:  # gram() and the colours that solve it know nothing of how colours count
            residual = residual @ np.linalg.inv(self.visibility.color).astype(np.float32)
        colors = np.zeros((n, 3), np.float32)
        direction = z = residual / energy
        rz = (residual * z).sum(0)
        for _ in range(steps):
            product = self.backend.gram(Gaussians(shapes.means, f, direction), self.frame, self.visibility)
            product += np.float32(damping) * energy * direction
            alpha = rz / np.maximum((direction * product).sum(0), np.float32(1e-30))
            colors += alpha * direction
            residual = residual - alpha * product
            z = residual / energy
            rz, previous = (residual * z).sum(0), rz
            direction = z + rz / np.maximum(previous, np.float32(1e-30)) * direction
        return Gaussians(shapes.means, f, colors)


@dataclass(frozen=True)
class Pyramid:
    """Levels of one picture, the whole first.

    finest: that Gaussians are fitted to in the end, the whole unless there is too little time for it; coarser: levels
    beyond it that keep most of the contrast. On others thin lines and checkerboards have gone, and Gaussians would
    unlearn them.
    """

    levels: tuple[Level, ...]
    finest: Level
    coarser: tuple[Level, ...]
    settings: PyramidSettings

    @classmethod
    def of(cls, whole: Level, settings: PyramidSettings) -> Pyramid:
        """The pyramid of a whole picture."""
        levels = [whole]
        while len(levels) <= settings.halvings:
            if min(levels[-1].frame.height, levels[-1].frame.width) < settings.smallest_side:
                break
            levels.append(levels[-1].halved())
        least = settings.contrast_kept * _contrast(whole.target)
        detailed = takewhile(lambda level: _contrast(level.target) >= least, levels)
        return cls(tuple(levels), whole, tuple(list(detailed)[1:]), settings)

    @property
    def whole(self) -> Level:
        """The picture at its own size."""
        return self.levels[0]

    def from_level(self, finest: Level) -> Pyramid:
        """The same, with another finest level."""
        coarser = tuple(level for level in self.coarser if level.frame.spacing > finest.frame.spacing)
        return replace(self, finest=finest, coarser=coarser)

    def smallest(self, gaussians: int) -> Level:
        """The coarsest level that is fine enough for this many Gaussians."""
        enough = self.settings.pixels_per_gaussian * gaussians
        return [self.finest, *(level for level in self.coarser if level.pixels >= enough)][-1]


def _contrast(target: Target) -> float:
    """The variance of a picture, summed over its channels."""
    return float(sum(np.square(cv2.meanStdDev(plane)[1]).item() for plane in target))
