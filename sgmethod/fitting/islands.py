"""Islands: the parts of a picture that differ from its background, for pictures that are nearly all background.

Reduced pictures lose stars, and a word on a page; on the whole picture, fitting even one Gaussian takes seconds. So the
islands are laid out side by side in a small atlas, and the fit sees only that. Gaussians stay in pixels of the whole
picture; each is moved to the atlas together with the island that it is in, or else nearest to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.protocol import (
    Backend,
    Coding,
    Descent,
    Frame,
    Moments,
    RefineLimits,
    Target,
    Visibility,
)
from sgmethod.opencv import cv2
from sgmethod.scene import FloatArray, Gaussians, Pixels

TILE = 4  # pixels; around an island lie one to two tiles of background


class Box(NamedTuple):
    """A rectangle of width x height pixels: its corner in the picture, and in the atlas."""

    x: int
    y: int
    width: int
    height: int
    atlas_x: int
    atlas_y: int

    @property
    def in_picture(self) -> tuple[slice, slice]:
        """Rows and columns of the picture."""
        return slice(self.y, self.y + self.height), slice(self.x, self.x + self.width)

    @property
    def in_atlas(self) -> tuple[slice, slice]:
        """Rows and columns of the atlas."""
        return slice(self.atlas_y, self.atlas_y + self.height), slice(self.atlas_x, self.atlas_x + self.width)


@dataclass(frozen=True, eq=False)
class Islands:
    """Islands of a picture, and their places in an atlas.

    width, height: of the atlas; to_atlas, to_picture: how far a Gaussian moves, by the tile of its centre in the
    picture or in the atlas, float32 [rows, columns, 2].
    """

    boxes: tuple[Box, ...]
    width: int
    height: int
    to_atlas: FloatArray
    to_picture: FloatArray

    @classmethod
    def from_pixels(cls, pixels: Pixels, background: tuple[int, int, int]) -> Islands | None:
        """Find the islands of a picture [H, W, 3]; None if all of it is background."""
        height, width = pixels.shape[:2]
        differs = cv2.bitwise_not(cv2.inRange(pixels, background, background))
        tiles = -(-height // TILE), -(-width // TILE)
        padded = np.zeros((tiles[0] * TILE, tiles[1] * TILE), np.uint8)
        padded[:height, :width] = differs
        land = padded.reshape(tiles[0], TILE, -1).max(1).reshape(*tiles, TILE).max(2)
        rectangles = _rectangles(np.asarray(cv2.dilate(land, np.ones((3, 3), np.uint8)), np.uint8))
        if not rectangles:
            return None
        boxes = _laid_out([_cut(rectangle, width, height) for rectangle in rectangles])
        atlas = max(b.atlas_x + b.width for b in boxes), max(b.atlas_y + b.height for b in boxes)
        corners = np.array([(b.x, b.y) for b in boxes], np.float32)
        in_atlas = np.array([(b.atlas_x, b.atlas_y) for b in boxes], np.float32)
        nearest = _nearest(tiles, [box.in_picture for box in boxes])
        back = _nearest((-(-atlas[1] // TILE), -(-atlas[0] // TILE)), [box.in_atlas for box in boxes])
        return cls(boxes, *atlas, (in_atlas - corners)[nearest], (corners - in_atlas)[back])

    @property
    def pixels(self) -> int:
        """Number of the atlas's pixels."""
        return self.width * self.height

    def laid(self, planes: NDArray[Any], between: NDArray[Any] | int) -> NDArray[Any]:
        """Lay planes [..., H, W] of the picture out in the atlas. between: values [..., 1, 1] between islands."""
        atlas = np.empty((*planes.shape[:-2], self.height, self.width), planes.dtype)
        atlas[...] = between
        for box in self.boxes:
            atlas[(..., *box.in_atlas)] = planes[(..., *box.in_picture)]
        return atlas

    def put_back(self, atlas: NDArray[Any], planes: NDArray[Any]) -> NDArray[Any]:
        """Return planes [..., H, W] of the picture with the islands of an atlas."""
        planes = planes.copy()
        for box in self.boxes:
            planes[(..., *box.in_picture)] = atlas[(..., *box.in_atlas)]
        return planes


def moved(means: FloatArray, by: FloatArray) -> FloatArray:
    """Move means [N, 2], each by what `by` [rows, columns, 2] says of its tile."""
    x, y = np.clip(means.T // TILE, 0, np.array(by.shape[1::-1])[:, None] - 1).astype(np.intp)
    return np.asarray(means + by[y, x], np.float32)


def _rectangles(land: NDArray[np.uint8]) -> list[tuple[int, int, int, int]]:
    """Rectangles (x, y, width, height) of tiles that cover all land [rows, columns] and do not touch each other."""
    land = land.copy()
    while True:
        found = cv2.connectedComponentsWithStats(land, connectivity=8)[2][1:, :4].tolist()
        before = np.count_nonzero(land)
        for x, y, width, height in found:
            land[y : y + height, x : x + width] = 1
        if np.count_nonzero(land) == before:
            return [(x, y, width, height) for x, y, width, height in found]


def _cut(rectangle: tuple[int, int, int, int], width: int, height: int) -> Box:
    """Convert a rectangle of tiles to pixels within a picture of width x height, at no place of an atlas yet."""
    x, y, across, down = (TILE * side for side in rectangle)
    return Box(x, y, min(across, width - x), min(down, height - y), 0, 0)


def _laid_out(boxes: list[Box]) -> tuple[Box, ...]:
    """Lay boxes out in rows, the highest first, in an atlas about as wide as high."""
    area = sum(box.width * box.height for box in boxes)
    widest = max(math.isqrt(area), *(box.width for box in boxes), 0)
    laid, x, y, row = [], 0, 0, 0
    for box in sorted(boxes, key=lambda box: -box.height):
        if x + box.width > widest:
            x, y, row = 0, y + row, 0
        laid.append(box._replace(atlas_x=x, atlas_y=y))
        x, row = x + -(-box.width // TILE) * TILE, max(row, -(-box.height // TILE) * TILE)
    return tuple(laid)


def _nearest(tiles: tuple[int, int], places: list[tuple[slice, slice]]) -> NDArray[np.intp]:
    """Index of the box nearest to each tile. places: pixels of the boxes."""
    index = np.full(tiles, -1, np.intp)
    for number, (rows, columns) in enumerate(places):
        index[rows.start // TILE : -(-rows.stop // TILE), columns.start // TILE : -(-columns.stop // TILE)] = number
    _, nearest = cv2.distanceTransformWithLabels(
        (index < 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    inside = index >= 0
    by_label = np.empty(nearest.max() + 1, np.intp)
    by_label[nearest[inside]] = index[inside]
    return np.asarray(by_label[nearest], np.intp)


@dataclass(frozen=True)
class AtlasBackend:
    """A Backend whose frames are of the atlas, while its Gaussians and their refining are of the whole picture.

    share: pixels of the atlas, as a part of the picture's; beside: mean squared error of the background, which the file
    may have rounded; target, visibility: those of the whole picture.
    """

    backend: Backend
    islands: Islands
    share: float
    beside: float
    target: Target
    visibility: Visibility | None

    def _in_atlas(self, gaussians: Gaussians) -> Gaussians:
        return replace(gaussians, means=moved(gaussians.means, self.islands.to_atlas))

    def residual(
        self, gaussians: Gaussians, frame: Frame, target: Target, first_row: int = 0, *, half: bool = False
    ) -> FloatArray:
        return self.backend.residual(self._in_atlas(gaussians), frame, target, first_row, half=half)

    def error(self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None) -> float:
        """Mean over the whole picture."""
        in_atlas = self.backend.error(self._in_atlas(gaussians), frame, target, visibility)
        return in_atlas * self.share + self.beside * (1 - self.share)

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        return self.backend.gradients(self._in_atlas(gaussians), frame, target, visibility)

    def gram(self, gaussians: Gaussians, frame: Frame, visibility: Visibility | None = None) -> FloatArray:
        return self.backend.gram(self._in_atlas(gaussians), frame, visibility)

    def keep_in_range(self, gaussians: Gaussians, width: int, height: int) -> None:
        self.backend.keep_in_range(gaussians, width, height)

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        errors: list[float] = []
        size = self.islands.width, self.islands.height
        in_atlas = replace(descent, price=descent.price / self.share, width=size[0], height=size[1])
        for rate in rates:  # one by one: how many come together depends on the time they take, and the file must not
            moving = self._in_atlas(gaussians)
            errors += self.backend.steps(moving, moments, in_atlas, [rate])
            gaussians.means[:] = moved(moving.means, self.islands.to_picture)
            self.backend.keep_in_range(gaussians, descent.width, descent.height)
        return errors

    def rounded(self, gaussians: Gaussians, coding: Coding) -> Gaussians:
        return self.backend.rounded(gaussians, coding)

    def refine(
        self, gaussians: Gaussians, coding: Coding, target: Target, limits: RefineLimits, visibility: Visibility | None
    ) -> bytes:
        whole = self.target if limits.spacing > 1 else self.islands.put_back(target, self.target)
        limits = replace(limits, price=limits.price * limits.spacing**2, spacing=1)
        return self.backend.refine(gaussians, coding, whole, limits, self.visibility)
