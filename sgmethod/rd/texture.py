"""How strong texture should be: by what of the picture the Gaussians leave, where that looks like noise."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream.texture import Codes, cells
from sgmethod.native import native
from sgmethod.profiles import RdSettings

Pixels = NDArray[np.uint8]
Plane = NDArray[np.float32]
BLOCK = 8  # pixels along a side of the blocks whose energies are compared within a cell
MOST_FLAT = 1 / 8  # of the pixels of a block that may be noise
REACH = 9  # pixels along a side of the square around a pixel in which its ink and its paper are looked for
CONTRAST = 64  # levels of 8 bits between the two, at least
LIKE = 1 / 6  # of the contrast: as far from ink or paper as JPEG may leave what was drawn as one of them
MOST_DRAWN = 1 / 2  # of the pixels of a block that may be noise


def estimate(source: Pixels, decoded: Pixels, settings: RdSettings) -> Codes | None:
    """Codes of strengths [octaves, rows, columns] for a picture [H, W, 3] and what its Gaussians draw; None for none.

    In each cell, what is left of each octave is measured in blocks. Noise is in all of them alike, while edges leave
    much in some and nothing in others. So a low quantile of the blocks tells how much noise there is. Blocks of
    drawings or lettering have none.
    """
    height, width = source.shape[:2]
    rows, columns = cells(width, height)
    found = np.zeros((native.TEXTURE_OCTAVES, rows, columns), np.float32)
    for row in range(rows):  # one row of cells at a time, which takes little memory
        band = slice(row * native.TEXTURE_CELL, (row + 1) * native.TEXTURE_CELL)
        left = _padded(_plane(_luma(source[band]) - _luma(decoded[band])), columns)
        noisy = _noisy(_padded(_luma(source[band]), columns))
        for octave in range(native.TEXTURE_OCTAVES):
            coarse = cv2.resize(left, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            detail = left - cv2.resize(coarse, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR)
            found[octave, row] = _strength(_spread(detail, noisy, settings), settings.texture_gain[octave], settings)
            left = _plane(coarse)
    codes = _codes(found)
    return codes if codes.any() else None


def _plane(values: NDArray[Any]) -> Plane:
    return np.asarray(values, np.float32)


def _luma(pixels: Pixels) -> Plane:
    return _plane(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))


def _padded(plane: Plane, columns: int) -> Plane:
    """One row of whole cells, mirrored at the edges of the picture."""
    below, beyond = native.TEXTURE_CELL - plane.shape[0], columns * native.TEXTURE_CELL - plane.shape[1]
    return _plane(cv2.copyMakeBorder(plane, 0, below, 0, beyond, cv2.BORDER_REFLECT))


def _noisy(luma: Plane) -> Plane:
    """1 for each block that may be noise, and 0 for others: in a drawing neighbours are alike, and where JPEG has been
    at it, most pixels still are ink or paper."""
    darkest, brightest = _extremes(luma, 3)
    flat = brightest == darkest
    darkest, brightest = _extremes(luma, REACH)
    contrast = brightest - darkest
    drawn = (contrast >= CONTRAST) & (np.minimum(luma - darkest, brightest - luma) <= LIKE * contrast)
    return _plane((_share(flat) <= MOST_FLAT) & (_share(drawn) <= MOST_DRAWN))


def _extremes(luma: Plane, side: int) -> tuple[Plane, Plane]:
    """The least and the greatest in the square around each pixel."""
    window = np.ones((side, side), np.uint8)
    return _plane(cv2.erode(luma, window)), _plane(cv2.dilate(luma, window))


def _share(where: NDArray[np.bool_]) -> Plane:
    """Of the pixels of each block."""
    return _plane(cv2.resize(_plane(where), None, fx=1 / BLOCK, fy=1 / BLOCK, interpolation=cv2.INTER_AREA))


def _spread(detail: Plane, noisy: Plane, settings: RdSettings) -> Plane:
    """A low quantile of the spread in the blocks of each cell, beyond what nobody sees, in levels of 8 bits."""
    energy = noisy * cv2.resize(detail * detail, noisy.shape[::-1], interpolation=cv2.INTER_AREA)
    rows = energy.shape[0]  # of one row of cells, and so of each cell
    blocks = energy.reshape(rows, -1, rows).transpose(1, 0, 2).reshape(-1, rows * rows)
    energies = np.quantile(blocks, settings.texture_quantile, axis=1) - settings.texture_floor**2
    return _plane(np.sqrt(np.maximum(energies, 0)))


def _strength(spread: Plane, gain: float, settings: RdSettings) -> Plane:
    """How much of a spread comes back."""
    middle = settings.texture_middle
    strength = gain * middle * (spread / middle) ** settings.texture_power
    return _plane(np.minimum(strength, settings.texture_most * spread))


def _codes(strengths: Plane) -> Codes:
    """The nearest code of each strength: half a level is code 1, and each further one half a power of two more."""
    nearest = np.rint(2 * np.log2(np.maximum(strengths, 1e-3) / 0.5)) + 1
    codes: Codes = np.clip(nearest, 0, native.TEXTURE_STRENGTHS - 1).astype(np.uint8)
    return codes
