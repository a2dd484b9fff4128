"""Grain that Gaussians should not try to draw, and the strength of the texture that replaces it.

Only the brightest grains of grass or water are worth a Gaussian, and a few needles and dots on a smooth area look
broken. So the part of a cell's grain that the fit does not reach is removed from its target. The decoder adds noise
with the energy that is then missing, up to a spread of a few levels.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sgmethod.backend.planes import halved
from sgmethod.backend.protocol import TARGET_WHITE, TEXTURE_CELL, TEXTURE_OCTAVES, TEXTURE_STRENGTHS, Target
from sgmethod.bitstream.texture import Codes, cells
from sgmethod.fitting.bands import Rows, bands
from sgmethod.opencv import cv2
from sgmethod.scene import Pixels
from sgmethod.threads import in_parallel

Plane = NDArray[np.float32]
Value = TypeVar("Value", np.float32, np.float64)
BLOCK = 8  # pixels along a side of the blocks whose energies are compared within a cell
MAX_FLAT = 1 / 8  # most flat pixels in a block of noise
REACH = 9  # side of the square around a pixel in which its darkest (ink) and brightest (paper) levels are found
CONTRAST = 64  # least difference between ink and paper, in levels of 8 bits
LIKE = 1 / 6  # part of the contrast by which JPEG may move a pixel away from ink or paper
MAX_DRAWN = 1 / 2  # most pixels of ink or paper in a block of noise
SIDE = TEXTURE_CELL // BLOCK  # blocks along a side of a cell
SHOWN = (0.85, 0.38)  # spread found in noise of strength 1, by octave: tests/fitting/test_texture.py
# Grain is hidden gradually between the two values of each pair: not at all below, entirely above.
GRAIN_LEFT = (0.45, 0.7)  # part of a cell's detail that the fit misses
GRAIN_LEVELS = (4.0, 7.0)  # strength in levels of 8 bits: faint grain makes no needles
QUANTILE = 0.4  # of a cell's blocks, ordered by energy: the strength of its grain
FLOOR = 0.3  # levels of 8 bits: the spread between two rounded pictures
EXCESS = 8.0  # weight of texture that is too strong in a block, in multiples of that of too weak
MAX_LEVELS = 3.0  # of 8 bits, which the noise's spread approaches: louder, pebbles and leaves become noise
STEPS = 30  # towards the strengths of cells, which then move by less than a tenth of a code
TINY = 1e-3  # squared levels
# Weights [blocks of a cell, 9] in linear interpolation of the cell and its neighbours: of 3 cells, the middle one's.
ALONG = cv2.resize(np.eye(3), (3, 3 * SIDE), interpolation=cv2.INTER_LINEAR)[SIDE : 2 * SIDE]
SPREAD = np.kron(ALONG, ALONG)
MARGIN = 4  # rows, more than reduction and enlargement reach; even, so that rows keep their pairs


def estimate(source: Pixels, decoded: Pixels) -> Codes | None:
    """Texture codes [octaves, rows, columns] for a picture [H, W, 3] and its decoded Gaussians; None if all are 0.

    In each block, the noise gives the energy that the decoded picture lacks in an octave; in each cell, its spread
    approaches MAX_LEVELS. Blocks of drawings or lettering count as free of noise.
    """
    height, width = source.shape[:2]
    rows, columns = cells(width, height)
    missing = np.empty((TEXTURE_OCTAVES, rows * SIDE, columns * SIDE), np.float32)

    def measure(row: int) -> None:  # of one row of cells at a time, which takes little memory
        band, here = (slice(row * side, (row + 1) * side) for side in (TEXTURE_CELL, SIDE))
        wanted, drawn = (_padded(_luma(pixels[band]), columns) for pixels in (source, decoded))
        for octave, (whole, part) in enumerate(zip(_energies(wanted), _energies(drawn), strict=True)):
            missing[octave, here] = np.maximum(whole - part - FLOOR**2, 0)
        missing[:, here] *= _noisy(wanted)

    in_parallel(measure, range(rows))
    spreads = in_parallel(lambda one: MAX_LEVELS * np.tanh(_strengths(np.sqrt(one)) / MAX_LEVELS), missing)
    codes = _codes(np.stack([spread / shown for spread, shown in zip(spreads, SHOWN, strict=True)]))
    return codes if codes.any() else None


def grain(source: Pixels, residual: Rows) -> Target:
    """Grain to remove from the target, [3, H, W], for a picture [H, W, 3]; TARGET_WHITE is white.

    residual: of the current fit, by rows. Grain is detail of the finest octave. In each cell its strength is a
    low quantile of its energies in blocks, and each block is filtered as if that were noise (a Wiener filter): detail
    as strong as its surroundings is removed, detail that stands out is kept.
    """
    height, width = source.shape[:2]
    share = _hidden(source, residual)
    size = tuple(BLOCK * side for side in share.shape[::-1])
    share = _plane(cv2.resize(share * (TARGET_WHITE / 255), size, interpolation=cv2.INTER_LINEAR))
    hidden = np.empty((3, height, width), np.int16)

    def hide(band: tuple[int, int]) -> None:
        first, end = band
        top, bottom = max(first - MARGIN, 0), min(end + MARGIN, height)
        part = source[top:bottom]
        even = cv2.copyMakeBorder(part, 0, len(part) % 2, 0, width % 2, cv2.BORDER_REPLICATE)
        detail = _detail(_plane(even))[first - top : end - top, :width]
        for channel, to in zip(detail.transpose(2, 0, 1), hidden[:, first:end], strict=True):
            to[...] = np.rint(channel * share[first:end, :width])

    in_parallel(hide, bands(height, width))
    return hidden


def _hidden(source: Pixels, residual: Rows) -> Plane:
    """Share of each block's detail to remove, 0 to 1."""
    height, width = source.shape[:2]
    rows, columns = cells(width, height)
    energy, noisy = np.empty((2, rows * SIDE, columns * SIDE), np.float32)
    strength = np.empty((rows, columns), np.float32)

    def measure(row: int) -> None:
        first, here = row * TEXTURE_CELL, slice(row * SIDE, (row + 1) * SIDE)
        end = min(first + TEXTURE_CELL, height)
        luma = _padded(_luma(source[first:end]), columns)
        energy[here], noisy[here] = _energy(_detail(luma)), _noisy(luma)
        missing = 255 * _luma(np.ascontiguousarray(residual(first, end).transpose(1, 2, 0)))
        part = np.minimum(_energy(_detail(_padded(missing, columns))) / (energy[here] + TINY), 1)
        found = np.quantile(_by_cell(noisy[here] * energy[here])[0], QUANTILE, axis=1)
        found *= _rise(np.sqrt(found), GRAIN_LEVELS)
        found *= _rise(np.median(_by_cell(part)[0], axis=1), GRAIN_LEFT)
        strength[row] = found

    in_parallel(measure, range(rows))
    strength = _plane(cv2.resize(strength, energy.shape[::-1], interpolation=cv2.INTER_LINEAR))
    share = noisy * np.minimum(strength / (energy + TINY), 1)
    return _plane(cv2.GaussianBlur(share, (0, 0), 0.7))


def _rise(values: NDArray[Any], between: tuple[float, float]) -> NDArray[Any]:
    """Ramp from 0 to 1 between two values."""
    first, last = between
    return np.clip((values - first) / (last - first), 0, 1)


def _plane(values: NDArray[Any]) -> Plane:
    return np.asarray(values, np.float32)


def _luma(pixels: Pixels) -> Plane:
    return _plane(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))


def _padded(plane: Plane, columns: int) -> Plane:
    """Pad a plane to one row of whole cells, mirrored at the picture's edges."""
    below, beyond = TEXTURE_CELL - plane.shape[0], columns * TEXTURE_CELL - plane.shape[1]
    return _plane(cv2.copyMakeBorder(plane, 0, below, 0, beyond, cv2.BORDER_REFLECT))


def _noisy(luma: Plane) -> Plane:
    """Mask of blocks, 1 for possible noise, 0 for drawings.

    In drawings many neighbours are equal or, after JPEG, most pixels are still close to ink or paper.
    """
    darkest, brightest = _extremes(luma, 3)
    flat = brightest == darkest
    darkest, brightest = _extremes(luma, REACH)
    contrast = brightest - darkest
    drawn = (contrast >= CONTRAST) & (np.minimum(luma - darkest, brightest - luma) <= LIKE * contrast)
    return _plane((_share(flat) <= MAX_FLAT) & (_share(drawn) <= MAX_DRAWN))


def _extremes(luma: Plane, side: int) -> tuple[Plane, Plane]:
    """Minimum and maximum in the square around each pixel."""
    window = np.ones((side, side), np.uint8)
    return _plane(cv2.erode(luma, window)), _plane(cv2.dilate(luma, window))


def _share(where: NDArray[np.bool_]) -> Plane:
    """Share of each block's pixels where the mask is set."""
    return _plane(cv2.resize(_plane(where), None, fx=1 / BLOCK, fy=1 / BLOCK, interpolation=cv2.INTER_AREA))


def _detail(plane: Plane, coarse: Plane | None = None) -> Plane:
    """Detail of a plane with even sides that half the size cannot show. coarse: the plane at half the size."""
    coarse = halved(plane) if coarse is None else coarse
    return _plane(plane - cv2.resize(coarse, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR))


def _energy(detail: Plane, side: int = BLOCK) -> Plane:
    """Mean of the squared detail in each block."""
    return _plane(cv2.resize(detail * detail, None, fx=1 / side, fy=1 / side, interpolation=cv2.INTER_AREA))


def _by_cell(blocks: NDArray[Value]) -> NDArray[Value]:
    """Group blocks by cell, [rows, columns, blocks of a cell]."""
    rows, columns = (count // SIDE for count in blocks.shape)
    return blocks.reshape(rows, SIDE, columns, SIDE).transpose(0, 2, 1, 3).reshape(rows, columns, SIDE * SIDE)


def _energies(plane: Plane) -> Iterator[Plane]:
    """Energy of each octave of detail in each block."""
    for octave in range(TEXTURE_OCTAVES):
        coarse = halved(plane)
        yield _energy(_detail(plane, coarse), BLOCK >> octave)
        plane = coarse


def _strengths(spread: Plane) -> NDArray[np.float64]:
    """Strengths of cells, between which the decoder interpolates, for the spread that is missing in each block.

    This is a least-squares fit in which too much noise weighs more than too little: otherwise, the noise of foliage
    would spill over the sky beside it. The fit begins at a low quantile of a cell's blocks, and its steps multiply, so
    a cell where only some blocks have noise gets none, and no strength falls below 0.
    """
    strengths: NDArray[np.float64] = np.quantile(_by_cell(spread), QUANTILE, axis=2).astype(np.float64)
    for _ in range(STEPS):
        shown = cv2.resize(strengths, spread.shape[::-1], interpolation=cv2.INTER_LINEAR)
        weights = np.where(shown > spread, EXCESS, 1.0)
        strengths *= _gathered(weights * spread) / (_gathered(weights * shown) + TINY)
    return strengths


def _gathered(blocks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transpose of the linear interpolation from cells to blocks: sum blocks by their weights for each cell."""
    parts = _by_cell(blocks) @ SPREAD
    rows, columns = parts.shape[:2]
    sums = np.zeros((rows + 2, columns + 2))
    for n in range(9):
        y, x = divmod(n, 3)
        sums[y : y + rows, x : x + columns] += parts[..., n]
    for side in (sums, sums.T):  # beyond the edge, interpolation repeats the cells there
        side[1] += side[0]
        side[-2] += side[-1]
    return sums[1:-1, 1:-1]


def _codes(strengths: NDArray[Any]) -> Codes:
    """Code each strength: half a level is code 1, and each further code is a factor of sqrt(2)."""
    nearest = np.rint(2 * np.log2(np.maximum(strengths, 1e-3) / 0.5)) + 1
    codes: Codes = np.clip(nearest, 0, TEXTURE_STRENGTHS - 1).astype(np.uint8)
    return codes
