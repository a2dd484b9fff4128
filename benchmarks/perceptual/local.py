"""Compare local statistics of a picture with those of its source. A picture may be right on average, and yet show a few
isolated strokes on a washed-out surface.

A band is the picture blurred by a sigma of s pixels less the same blurred by 2 s: detail of about 2 s to 4 s pixels.
In each square of 48 pixels, the spread of a band is its standard deviation, and its kurtosis says how rare and high
its peaks are: 3 for Gaussian noise. The 40 % of squares with the least detail in the source are left out.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.pictures import Pixels

SIDE = 48  # pixels of a square
LEFT_OUT = 0.4  # of the squares
BLURS = {"fine": 1.0, "middle": 2.0}  # pixels: bands of 2 to 4 and of 4 to 8
PLANES = {"luma": (0,), "chroma": (1, 2)}  # of YCrCb (BT.601)
BANDS = tuple((part, band) for part in PLANES for band in BLURS)
FIGURES = tuple(f"{measure}_{part}_{band}" for part, band in BANDS for measure in ("spread", "kurtosis"))
Array = NDArray[np.float32]


def local_statistics(picture: Pixels, source: Pixels) -> dict[str, float | None]:
    """By the names of FIGURES, of pictures [H, W, 3]: the median of the spread over the source's, and the median
    kurtosis over the source's; 1 is best. None where the source has no detail in whole squares."""
    planes = [cv2.cvtColor(pixels, cv2.COLOR_RGB2YCrCb).astype(np.float32) for pixels in (picture, source)]
    found: dict[str, float | None] = {}
    for part, band in BANDS:
        pairs = [_compared(*(_band(plane[..., k], BLURS[band]) for plane in planes)) for k in PLANES[part]]
        spreads, ours, theirs = (np.concatenate(values) for values in zip(*pairs, strict=True))
        is_there = spreads.size > 0
        found[f"spread_{part}_{band}"] = float(np.median(spreads)) if is_there else None
        found[f"kurtosis_{part}_{band}"] = float(np.median(ours) / np.median(theirs)) if is_there else None
    return found


def _band(plane: Array, sigma: float) -> Array:
    return np.asarray(cv2.GaussianBlur(plane, (0, 0), sigma) - cv2.GaussianBlur(plane, (0, 0), 2 * sigma))


def _compared(band: Array, source: Array) -> tuple[Array, Array, Array]:
    """For the squares that count: the spread over the source's, and both kurtoses."""
    (spread, kurtosis), (wanted, known) = (_moments(_squares(plane)) for plane in (band, source))
    counts = wanted > np.quantile(wanted, LEFT_OUT) if wanted.size else np.zeros(0, bool)
    return spread[counts] / wanted[counts], kurtosis[counts], known[counts]


def _squares(plane: Array) -> Array:
    """The whole squares of a plane, [N, SIDE * SIDE]."""
    rows, columns = (side // SIDE for side in plane.shape)
    cut = plane[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
    return np.asarray(cut.transpose(0, 2, 1, 3).reshape(rows * columns, SIDE * SIDE))


def _moments(squares: Array) -> tuple[Array, Array]:
    """Standard deviation and kurtosis of each; that of a flat square is 0."""
    centred = squares - squares.mean(1, keepdims=True)
    variance = np.square(centred).mean(1)
    return np.sqrt(variance), (centred**4).mean(1) / np.maximum(np.square(variance), 1e-12)
