"""The picture that Gaussians are fitted to, at full size, half size, and so on.

While there are few Gaussians, they learn as much from a reduced picture. Means and factors stay in pixels of the whole
picture on every level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import halved
from sgmethod.backend.protocol import TARGET_WHITE, VISIBLE, Backend, Frame, Target, Visibility
from sgmethod.fitting.bands import Rows, bands, parallel_rows
from sgmethod.fitting.islands import AtlasBackend, Islands, moved
from sgmethod.fitting.visibility import weigh
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray, Gaussians
from sgmethod.threads import in_parallel

# Adds back the Laplacian lost to a blur with a variance of 1 / 16 along each axis.
SHARPEN = np.array([[0, -1, 0], [-1, 36, -1], [0, -1, 0]], np.float32) / 32
DAMPING = 0.01  # of colours by least squares
SMALLEST_SIDE = 32  # pixels; smaller pictures are not halved
# Pixels per Gaussian: while there are few, for most steps, and for the last steps and the file's integers.
PIXELS_WHILE_FEW, PIXELS_PER_GAUSSIAN, PIXELS_IN_THE_END = 20.0, 100.0, 250.0
CONTRAST_KEPT = 0.7  # part of the picture's variance; smaller pictures that keep less are not used
SQUARE = 4  # pixels along a side: less than a Gaussian that many can be afforded of


class Histogram:
    """Statistics of the levels of an image [H, W, 3].

    mean: the mean colour; background: the colour of more than half of the image, such as a page's white, if it is
    as near to the image's parts as the mean (has_majority), else the mean, as for a checkerboard;
    spread: the largest difference between the levels of a channel.
    """

    def __init__(self, pixels: NDArray[np.uint8]) -> None:
        number = pixels.shape[0] * pixels.shape[1]
        counts = _counts(pixels)
        commonest = counts.argmax(1)
        red, green, blue = (round(float(c)) for c in counts @ np.arange(256) / number)
        self.mean = self.background = red, green, blue
        self.has_majority = bool(
            counts.max(1).min() > number / 2
            and cv2.countNonZero(cv2.inRange(pixels, commonest, commonest)) > number / 2
        )
        if self.has_majority:
            self.has_majority = _distance(pixels, commonest) <= _distance(pixels, np.array(self.mean))
        if self.has_majority:
            red, green, blue = commonest.tolist()
            self.background = red, green, blue
        self.spread = int(max(np.ptp(np.flatnonzero(of_channel)) for of_channel in counts))


def _distance(pixels: NDArray[np.uint8], colour: NDArray[Any]) -> float:
    """Mean distance of a colour from squares of an image, each counting as its mean."""
    size = -(-pixels.shape[1] // SQUARE), -(-pixels.shape[0] // SQUARE)
    squares = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    return float(np.abs(squares.astype(np.int16) - colour.astype(np.int16)).mean())


def _counts(pixels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Count each channel's levels in an image [H, W, 3]; returns [3, 256]."""

    def counts_of(band: tuple[int, int]) -> list[NDArray[Any]]:
        return [cv2.calcHist([pixels[slice(*band)]], [c], None, [256], [0, 256]).ravel() for c in range(3)]

    return np.asarray(np.sum(in_parallel(counts_of, bands(*pixels.shape[:2])), axis=0, dtype=np.float64))


def target_of(pixels: NDArray[np.uint8], background: tuple[int, int, int] = (0, 0, 0)) -> Target:
    """Convert pixels [H, W, 3] to the sum that Gaussians on a background should reach, [3, H, W]."""
    target = np.empty((3, *pixels.shape[:2]), np.int16)

    def strip(first: int, end: int) -> None:
        for plane, channel, below in zip(target, pixels.transpose(2, 0, 1), background, strict=True):
            np.subtract(channel[first:end], below, out=plane[first:end], dtype=np.int16)
            plane[first:end] *= TARGET_WHITE // 255

    parallel_rows(strip, len(pixels))
    return target


@dataclass(frozen=True)
class Level:
    """One size of the picture: its target, and the weights of the pixels' errors.

    islands: those of the picture if it is their atlas.
    """

    backend: Backend
    frame: Frame
    target: Target
    visibility: Visibility | None = None
    islands: Islands | None = None

    @property
    def values(self) -> int:
        """Number of the target's samples."""
        return self.target.size

    @property
    def pixels(self) -> int:
        """Number of this level's pixels."""
        return self.frame.height * self.frame.width

    def atlas(self, islands: Islands, background: Target) -> Level:
        """Return the atlas of this whole picture's islands as a level. background: the target [3, 1, 1] elsewhere."""
        share, beside = islands.pixels / self.pixels, float(np.square(background / TARGET_WHITE).mean())
        backend = AtlasBackend(self.backend, islands, share, beside, self.target, self.visibility)
        frame, target = Frame(islands.width, islands.height), islands.laid(self.target, background)
        visibility = self.visibility and replace(self.visibility, values=islands.laid(self.visibility.values, VISIBLE))
        return Level(backend, frame, target, visibility, islands)

    def shapes(self, means: FloatArray, factors: FloatArray) -> Gaussians:
        """Return black Gaussians with these means [N, 2] and factors [N, 3] in this level's samples."""
        means, factors = means * np.float32(self.frame.spacing), factors * np.float32(self.frame.spacing)
        if self.islands is not None:
            means = moved(means, self.islands.to_picture)
        return Gaussians(means, factors, np.zeros((len(means), 3), np.float32))

    def halved(self, sharpened: bool = False) -> Level:
        """Return the level of half the size, by means of four samples.

        That blurs by a variance of 1/16 of the new pixels. SHARPEN undoes it, within this level's range of values: else
        Gaussians fitted on the smaller level only would be too wide and too faint for the whole picture.
        """
        f = self.frame
        frame = replace(f, height=-(-f.height // 2), width=-(-f.width // 2), spacing=2 * f.spacing)
        target = np.empty((3, frame.height, frame.width), np.int16)

        def halve(plane: int) -> None:
            small = halved(self.target[plane])
            if sharpened:
                low, high, *_ = cv2.minMaxLoc(self.target[plane])
                small = cv2.filter2D(small, -1, SHARPEN, borderType=cv2.BORDER_REPLICATE).clip(int(low), int(high))
            target[plane] = small

        in_parallel(halve, range(3))
        return replace(self, frame=frame, target=target, visibility=self.visibility and self.visibility.half)

    def image(self) -> FloatArray:
        """Return the target as floats [3, H, W], 1 being white."""
        return self.target.astype(np.float32) / np.float32(TARGET_WHITE)

    def gradients(self, gaussians: Gaussians) -> tuple[float, Gaussians]:
        """Weighted mean squared error, and its gradient by each parameter."""
        return self.backend.gradients(gaussians, self.frame, self.target, self.visibility)

    def missing(self, gaussians: Gaussians, *, half: bool = False) -> Rows:
        """Target minus drawn Gaussians, computed when rows are requested. half: reduced to half the size."""

        def rows(first: int, end: int) -> FloatArray:
            return self.backend.residual(gaussians, self.frame, self.target[:, first:end], first, half=half)

        return rows

    def residual(self, gaussians: Gaussians) -> Rows:
        """Target minus drawn Gaussians, scaled so that its squares are the weighted errors."""
        visibility, missing = self.visibility, self.missing(gaussians)
        if visibility is None:
            return missing

        def rows(first: int, end: int) -> FloatArray:
            planes = missing(first, end)
            weigh(visibility, planes, first)
            return planes

        return rows

    def solve_colors(self, shapes: Gaussians, steps: int, others: Gaussians | None = None) -> Gaussians:
        """Give shapes approximately least-squares colours; the image is linear in these.

        Conjugate gradients from zero on the normal equations, preconditioned by the Gaussians' energies pi l1 l3,
        of which DAMPING is added to the diagonal. The target is this level's, minus the Gaussians `others`.
        """
        n, f = len(shapes), shapes.factors
        energy = np.maximum(np.float32(math.pi / self.frame.spacing**2) * f[:, :1] * f[:, 2:], np.float32(1e-12))
        black = Gaussians(shapes.means, f, np.zeros((n, 3), np.float32))
        _, gradients = self.gradients(black if others is None else others.with_more(black))
        residual = gradients.colors[-n:] * np.float32(-self.values / 2)  # inner products with the residual
        if self.visibility is not None:  # gram() weighs pixels only, and leaves out the weights of channels
            residual = np.einsum("na,ab->nb", residual, np.linalg.inv(self.visibility.color).astype(np.float32))
        colors = np.zeros((n, 3), np.float32)
        direction = z = residual / energy
        rz = (residual * z).sum(0)
        for _ in range(steps):
            product = self.backend.gram(Gaussians(shapes.means, f, direction), self.frame, self.visibility)
            product += np.float32(DAMPING) * energy * direction
            alpha = rz / np.maximum((direction * product).sum(0), np.float32(1e-30))
            colors += alpha * direction
            residual = residual - alpha * product
            z = residual / energy
            rz, previous = (residual * z).sum(0), rz
            direction = z + rz / np.maximum(previous, np.float32(1e-30)) * direction
        return Gaussians(shapes.means, f, colors)


@dataclass(frozen=True)
class Pyramid:
    """Levels of one picture, finest first; the finest is used at the end of the fit.

    detailed: the levels that keep most of the contrast. The others have lost thin lines and checkerboards, which
    Gaussians would unlearn there.
    """

    levels: tuple[Level, ...]
    detailed: tuple[Level, ...]

    @classmethod
    def from_whole(cls, whole: Level, gaussians: int) -> Pyramid:
        """Build the pyramid of a picture, without levels finer than this many Gaussians can show."""
        levels = [whole]
        while min(levels[-1].frame.height, levels[-1].frame.width) >= SMALLEST_SIDE:
            sharpened = levels[-1].pixels >= 4 * PIXELS_PER_GAUSSIAN * gaussians
            levels.append(levels[-1].halved(sharpened))
        least = CONTRAST_KEPT * _contrast(whole.target)
        detailed = takewhile(lambda level: _contrast(level.target) >= least, levels)
        pyramid = cls(tuple(levels), tuple(detailed))
        return pyramid.from_level(pyramid.coarsest(PIXELS_IN_THE_END * gaussians))

    @property
    def finest(self) -> Level:
        """The finest level: the whole picture, unless Gaussians are few or time is short."""
        return self.levels[0]

    def from_level(self, finest: Level) -> Pyramid:
        """Return the pyramid without levels finer than `finest`."""
        spacing = finest.frame.spacing
        levels, detailed = (
            tuple(level for level in some if level.frame.spacing >= spacing) for some in (self.levels, self.detailed)
        )
        return replace(self, levels=levels, detailed=detailed)

    def coarsest(self, pixels: float) -> Level:
        """Return the coarsest detailed level with at least this many pixels, or the finest level if none has."""
        return [self.finest, *(level for level in self.detailed if level.pixels >= pixels)][-1]


def _contrast(target: Target) -> float:
    """Variance of a picture, summed over its channels."""
    return float(sum(in_parallel(lambda plane: np.square(cv2.meanStdDev(plane)[1]).item(), target)))
