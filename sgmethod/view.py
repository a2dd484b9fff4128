"""Views: a picture, or part of it, drawn directly at the requested size, since Gaussians have no pixels.

Enlarging draws the same functions on a finer grid. Reducing needs a low-pass filter against aliasing: at scale s, each
Gaussian's variance grows by (1 - s^2) PIXEL_VARIANCE output pixels squared, with the same total weight
(docs/format.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from numbers import Integral

import numpy as np

from sgmethod.arguments import AnyFloat, AnyInt, checked_integer, finite_number
from sgmethod.errors import ViewError
from sgmethod.native import native
from sgmethod.scene import Gaussians, Scene, Texture

PIXEL_VARIANCE = 1 / 12  # variance of a box one pixel wide
MIN_SCALE, MAX_SCALE = 1 / 64, 64.0
# Output pixels; coordinates stay below, for single precision. A multiple of the width of every level's samples.
MAX_COORDINATE = 1 << 16
MAX_SIDE = 1 << 20  # of an output, in pixels
NO_CUTOFF = 50.0  # sigma at which nothing is left of a Gaussian without cut-off


def fitted_scale(scale: float, width: int, height: int) -> float:
    """Return the scale at which a part of width x height pixels gets a size. Raises ViewError if it is out of range."""
    if MIN_SCALE <= scale <= MAX_SCALE:
        return scale
    factor = int(MAX_SCALE)
    (min_w, max_w), (min_h, max_h) = ((-(-side // factor), side * factor) for side in (width, height))
    raise ViewError(f"width can be {min_w} to {max_w}, and height {min_h} to {max_h}")


@dataclass(frozen=True, init=False)
class View:
    """The part of a picture to draw, and its size.

    scale: output pixels per pixel of the picture; region: (x, y, width, height) in pixels of the picture, None for all
    of it; prefix: fraction of the file to decode, above 0 and up to 1 (profile rd only: its files begin with the
    largest Gaussians); texture: whether to draw the file's texture, if it has any.
    Raises ViewError for values out of range.
    """

    scale: float = 1.0
    region: tuple[int, int, int, int] | None = None
    prefix: float = 1.0
    texture: bool = True

    def __init__(
        self,
        scale: AnyFloat = 1.0,
        region: Iterable[AnyInt] | None = None,
        prefix: AnyFloat = 1.0,
        texture: bool = True,
    ) -> None:
        number, part = finite_number(scale), finite_number(prefix)
        if number is None or not MIN_SCALE <= number <= MAX_SCALE:
            raise ViewError(f"scale must be between {MIN_SCALE} and {MAX_SCALE:g}, got {scale!r}")
        if part is None or not 0 < part <= 1:
            raise ViewError(f"prefix must be above 0 and at most 1, got {prefix!r}")
        own = {"scale": number, "region": _checked_region(region), "prefix": part, "texture": bool(texture)}
        for name, value in own.items():
            object.__setattr__(self, name, value)

    @property
    def is_whole(self) -> bool:
        """Whether the view is the whole picture at its own size."""
        return self.scale == 1 and self.region is None

    def area(self, width: int, height: int) -> tuple[int, int, int, int]:
        """Return (x, y, width, height) of the part drawn. Raises ViewError unless it lies within the picture."""
        x, y, w, h = self.region or (0, 0, width, height)
        if x < 0 or y < 0 or w < 1 or h < 1 or x + w > width or y + h > height:
            raise ViewError(f"the region {x},{y},{w},{h} is not inside the picture of {width} x {height} pixels")
        return x, y, w, h

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return width and height of the output in pixels, each at least 1. Raises ViewError."""
        _, _, w, h = self.area(width, height)
        size = max(round(w * self.scale), 1), max(round(h * self.scale), 1)
        if max(size) > MAX_SIDE:
            raise ViewError(f"a view may have at most {MAX_SIDE:,} pixels a side, not {max(size):,}")
        return size

    def within(self, size: tuple[int, int], width: AnyInt | None, height: AnyInt | None) -> View:
        """Scale the same part to fit into width and height; None means no limit.

        size: width and height of the picture. Raises ViewError, also if the view already has a scale.
        """
        _, _, *part = self.area(*size)
        limits = [(limit, side) for limit, side in zip((width, height), part, strict=True) if limit is not None]
        if not limits:
            return self
        if self.scale != 1:
            raise ViewError("scale cannot be combined with width or height")
        scales = [
            checked_integer(limit, "a width or height", 1, MAX_COORDINATE, ViewError) / side for limit, side in limits
        ]
        return replace(self, scale=fitted_scale(min(scales), part[0], part[1]))

    def apply(self, scene: Scene) -> Scene:
        """Convert a scene to output pixels, low-passed if that reduces it. Raises ViewError like area()."""
        texture = scene.texture if self.texture else None
        if self.is_whole:
            return scene if texture is scene.texture else replace(scene, texture=None)
        x, y, w, h = self.area(scene.width, scene.height)
        width, height = self.size(scene.width, scene.height)
        # Rounding makes the two differ slightly, so that the output's edges are exactly the region's.
        scale = width / w, height / h
        # Samples of a pyramid's levels depend on coordinates: a part keeps its own, to look as in the whole picture.
        origin = (int(x * scale[0]) % MAX_COORDINATE, int(y * scale[1]) % MAX_COORDINATE) if scene.pyramid else (0, 0)
        widening = PIXEL_VARIANCE / variance(scene.cutoff)
        gaussians = _resized(scene.gaussians, (x, y), origin, scale, widening)
        if texture is not None:
            texture = _resized_texture(texture, (x, y), origin, scale)
        alpha = None if scene.alpha is None else self.apply(scene.alpha)
        drawn = replace(scene, gaussians=gaussians, width=width, height=height, origin=origin)
        return replace(drawn, texture=texture, alpha=alpha)


def _checked_region(region: Iterable[AnyInt] | None) -> tuple[int, int, int, int] | None:
    if region is None:
        return None
    numbers = list(region) if isinstance(region, Iterable) else []
    if [isinstance(n, Integral) for n in numbers] != [True] * 4:
        raise ViewError(f"a region is four whole numbers (x, y, width, height), not {region!r}")
    x, y, width, height = map(int, numbers)
    return x, y, width, height


def variance(cutoff: float) -> float:
    """Variance of the weight exp(-sigma) - exp(-cutoff), relative to the Gaussian without cut-off."""
    floor = math.exp(-cutoff)
    return (1 - floor * (1 + cutoff + cutoff**2 / 2)) / (1 - floor * (1 + cutoff))


def _resized_texture(
    texture: Texture, part: tuple[int, int], origin: tuple[int, int], scale: tuple[float, float]
) -> Texture:
    """Convert a texture to output pixels, each octave on the level where it is about as large as in the picture."""
    sx, sy = scale
    corner = origin[0] - part[0] * sx, origin[1] - part[1] * sy
    shift = (math.frexp(2 * sx * sy)[1] - 1) // 2  # the largest whole number with 4^shift <= 2 sx sy
    return replace(texture, cell=(texture.cell[0] * sx, texture.cell[1] * sy), corner=corner, shift=shift)


def _resized(
    gaussians: Gaussians, part: tuple[int, int], origin: tuple[int, int], scale: tuple[float, float], widening: float
) -> Gaussians:
    """Convert Gaussians to output pixels; the corner of the part moves to the origin."""
    l1, _, l3 = gaussians.factors.T
    drawn = (l1 > 0) & (l3 > 0)  # the others are invisible, but widening would show them
    sx, sy = scale
    means = (gaussians.means[drawn].astype(np.float64) - part) * scale + origin
    l1, l2, l3 = (gaussians.factors[drawn].astype(np.float64) * (sx, sy, sy)).T
    wide_x, wide_y = (max(1 - s * s, 0.0) * widening for s in scale)
    n1 = np.sqrt(l1 * l1 + wide_x)
    slant = l2 / n1
    n2, n3 = l1 * slant, np.sqrt(l3 * l3 + wide_y + slant * slant * wide_x)
    weight = (l1 * l3) / (n1 * n3)
    factors = np.stack([n1, n2, n3], 1).astype(np.float32)
    colors = (gaussians.colors[drawn] * weight[:, None]).astype(np.float32)
    return Gaussians(means.astype(np.float32), factors, colors)


def recut(gaussians: Gaussians, cutoff: float, new_cutoff: float | None = None) -> Gaussians:
    """Convert Gaussians cut off at sigma = cutoff to the closest ones cut off at new_cutoff.

    Each is the cut-off of a profile, or NO_CUTOFF. The default is that of profile rd.
    """
    new_cutoff = native.CUTOFF_V2 if new_cutoff is None else new_cutoff
    if cutoff == new_cutoff:
        return gaussians
    wider, gain = recut_factors(cutoff, new_cutoff)
    return Gaussians(gaussians.means, gaussians.factors * np.float32(wider), gaussians.colors * np.float32(gain))


def recut_factors(cutoff: float, new_cutoff: float) -> tuple[float, float]:
    """Return what recut() multiplies factors and colours by."""
    # Least-squares widening for cut-off CUTOFF_V2 at the same integral. The root mean square of the difference is 5 %
    # and 6 % of the Gaussian's.
    wider_by = {native.CUTOFF_V2: 1.0, native.MAX_CUTOFF: 1.094, NO_CUTOFF: 1.108}
    wider = wider_by[cutoff] / wider_by[new_cutoff]
    return wider, _integral(cutoff) / (_integral(new_cutoff) * wider**2)


def _integral(cutoff: float) -> float:
    """Integral of the weight exp(-sigma) - exp(-cutoff), relative to the Gaussian without cut-off."""
    return 1 - math.exp(-cutoff) * (1 + cutoff)
