"""SSIMULACRA 2: how close two pictures look, by Jon Sneyers (libjxl's tools/ssimulacra2.cc).

The figures equal those of the package ssimulacra2 0.3, which are up to 1.3 below libjxl's, in a tenth of its time: rows
are compared in bands, in float32.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sgmethod.io.colour import from_srgb
from sgmethod.numerics import quiet
from sgmethod.threads import in_parallel

Plane = NDArray[np.float32]

SMALLEST_SIDE = 8  # pixels; undefined for smaller pictures and levels
LEVELS = 6
BAND = 1 << 15  # pixels compared at a time, about: few enough to stay in the cache
LEAST_ROWS = 40  # of a band, as its margins are computed twice
SAMPLED = 1 << 20  # pixels of a level that are enough for an estimate: within 0.3 points of all, at 4 to 12 megapixels
# Wang, Bovik, Sheikh and Simoncelli, "Image quality assessment", 2004, section III.C.
WINDOW_SIZE, WINDOW_SIGMA = 11, 1.5
MARGIN = WINDOW_SIZE // 2
C2 = 0.0009

# From linear light to the responses of cones, and from their cube roots to X, Y and B, offset to be positive.
CONES = np.array([[0.3, 0.622, 0.078], [0.23, 0.692, 0.078], [0.24342268924547819, 0.20476744424496821, 0.0]])
CONES[2, 2] = 1 - CONES[2].sum()
BIAS = 0.0037930732552754493
TO_CONES = np.column_stack([CONES, np.full(3, BIAS)])
TO_XYB = np.array([[7.0, -7.0, 0.0, 0.42], [0.5, 0.5, 0.0, 0.01 - np.cbrt(BIAS)], [-0.5, -0.5, 1.0, 0.55]])

# For X, Y and B, by level: structure, ringing, blur; then the fourth roots of their fourth moments.
WEIGHTS = np.array(
    [
        *(0.0, 0.0007376606707406586, 0.0, 0.0, 0.0007793481682867309, 0.0),
        *(0.0, 0.0004371155730107379, 0.0, 1.1041726426657346, 0.00066284834129271, 0.00015231632783718752),
        *(0.0, 0.0016406437456599754, 0.0, 1.8422455520539298, 11.441172603757666, 0.0),
        *(0.0007989109436015163, 0.000176816438078653, 0.0, 1.8787594979546387, 10.94906990605142, 0.0),
        *(0.0007289346991508072, 0.9677937080626833, 0.0),
        *(0.00014003424285435884, 0.9981766977854967, 0.00031949755934435053),
        *(0.0004550992113792063, 0.0, 0.0, 0.0013648766163243398, 0.0, 0.0),
        *(0.0, 0.0, 0.0, 7.466890328078848, 0.0, 17.445833984131262),
        *(0.0006235601634041466, 0.0, 0.0, 6.683678146179332, 0.00037724407979611296, 1.027889937768264),
        *(225.20515300849274, 0.0, 0.0, 19.213238186143016, 0.0011401524586618361, 0.001237755635509985),
        *(176.39317598450694, 0.0, 0.0, 24.43300999870476, 0.28520802612117757, 0.0004485536923833408),
        *(0.0, 0.0, 0.0, 34.77906344483772, 44.835625328877896, 0.0),
        *(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        *(0.0, 0.0008680556573291698, 0.0, 0.0, 0.0, 0.0),
        *(0.0, 0.0005313191874358747, 0.0, 0.00016533814161379112, 0.0, 0.0),
        *(0.0, 0.0, 0.0, 0.0004179171803251336, 0.0017290828234722833, 0.0),
        *(0.0020827005846636437, 0.0, 0.0, 8.826982764996862, 23.19243343998926, 0.0),
        *(95.1080498811086, 0.9863978034400682, 0.9834382792465353),
        *(0.0012286405048278493, 171.2667255897307, 0.9807858872435379),
        *(0.0, 0.0, 0.0, 0.0005130064588990679, 0.0, 0.00010854057858411537),
    ]
)

# The least SSIMULACRA 2 of each word, as its author names them.
WORDS = ((90, "no visible loss"), (70, "high"), (50, "medium"), (30, "low"))


def quality_word(score: float) -> str:
    """Return what a SSIMULACRA 2 means in a word or three."""
    return next((word for least, word in WORDS if score >= least), "very low")


@quiet
def ssimulacra2(picture: NDArray[Any], source: NDArray[Any], *, sampled: bool = False) -> float | None:
    """SSIMULACRA 2 of a picture [H, W, 3], uint8 sRGB; None if a side is below SMALLEST_SIDE pixels.

    100 for the source itself, 90 for no visible loss, 70 for high quality, 50 for medium, 30 for low, below 0 for the
    worst. If sampled, an estimate from some of the rows, in a third of the time at 12 megapixels. Raises ValueError for
    pictures of different shapes.
    """
    most = SAMPLED if sampled else source.size
    if picture.shape != source.shape or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(f"pictures must have one shape [H, W, 3], got {list(picture.shape)} and {list(source.shape)}")
    if min(source.shape[:2]) < SMALLEST_SIDE:
        return None
    levels = [_difference(source, picture, most)]
    while len(levels) < LEVELS and min(source.shape[:2]) > 2 * (SMALLEST_SIDE - 1):
        source, picture = _halved(source), _halved(picture)
        levels.append(_difference(source, picture, most))
    found = np.stack(levels, axis=1)  # [3, levels, 6]
    return _score(float(WEIGHTS[: found.size] @ found.reshape(-1)))


def _score(difference: float) -> float:
    x = 0.9562382616834844 * difference
    x = 2.326765642916932 * x - 0.020884521182843837 * x**2 + 6.248496625763138e-05 * x**3
    return float(100 - 10 * max(x, 0.0) ** 0.6276336467831387)


def _difference(source: NDArray[Any], picture: NDArray[Any], most: int) -> NDArray[np.float64]:
    """Figures [3, 6] of one level, to be weighted by WEIGHTS. Pictures: uint8 sRGB or linear float32, [H, W, 3].

    A level of more than `most` pixels is compared in every other band, every third and so on.
    """
    height, width = source.shape[:2]
    rows = max(BAND // width, LEAST_ROWS)
    starts = range(0, height, rows * max(round(width * height / most), 1))

    def of_band(start: int) -> NDArray[np.float64]:
        seen = np.arange(start - MARGIN, min(start + rows, height) + MARGIN)
        seen = np.where(seen < 0, -1 - seen, np.where(seen >= height, 2 * height - 1 - seen, seen))
        return _sums(_xyb(source[seen]), _xyb(picture[seen]))

    sums: NDArray[np.float64] = np.sum(in_parallel(of_band, starts), axis=0)
    compared = sum(min(start + rows, height) - start for start in starts)
    means: NDArray[np.float64] = sums / (width * compared)
    means[:, 3:] **= 0.25
    return means


def _sums(x: Plane, y: Plane) -> NDArray[np.float64]:
    """Sums [3, 6] over a band with margins of structure, ringing and blur, and of their fourth powers.

    Computed in place, because fresh memory costs more than the arithmetic.
    """
    mean_x, mean_y, product = _window(x), _window(y), x * y
    structure = _window(product)
    np.square(x, out=product)
    product += np.square(y)
    variances = _window(product)
    # Only the sum of the variances is needed. In this order a picture is exactly equal to itself.
    here = product[: len(mean_x)]
    structure -= np.multiply(mean_x, mean_y, out=here)
    structure *= np.float32(2)
    structure += np.float32(C2)
    means = np.square(mean_x)
    means += np.square(mean_y, out=here)
    variances -= means
    variances += np.float32(C2)
    structure /= variances
    np.subtract(mean_x, mean_y, out=here)
    np.subtract(np.float32(1), np.square(here, out=here), out=here)
    structure *= here
    np.subtract(np.float32(1), structure, out=structure)
    edges, of_source = _edges(y, mean_y), _edges(x, mean_x)
    edges /= of_source
    edges -= np.float32(1)
    blur = np.minimum(edges, 0, out=of_source)
    parts = np.maximum(structure, 0, out=structure), np.maximum(edges, 0, out=edges), blur
    return np.concatenate([np.abs(_sum(parts)), _sum([_fourth(part) for part in parts])], axis=1)


def _edges(plane: Plane, mean: Plane) -> Plane:
    """Compute 1 + |plane - mean| in the mean's memory."""
    np.subtract(plane[MARGIN:-MARGIN], mean, out=mean)
    np.abs(mean, out=mean)
    mean += np.float32(1)
    return mean


def _fourth(plane: Plane) -> Plane:
    return np.square(np.square(plane, out=plane), out=plane)


def _sum(planes: Sequence[Plane]) -> NDArray[np.float64]:
    """Sum each plane over its pixels: [3, N]."""
    from sgmethod.opencv import cv2

    return np.array([cv2.sumElems(plane)[:3] for plane in planes]).T


def _xyb(pixels: NDArray[Any]) -> Plane:
    """Convert a picture [H, W, 3] to the eye's opponent colours, offset to be positive."""
    from sgmethod.opencv import cv2

    cones = cv2.transform(_linear(pixels), TO_CONES)
    return np.asarray(cv2.transform(cv2.pow(cones, 1 / 3, cones), TO_XYB), np.float32)


def _linear(pixels: NDArray[Any]) -> Plane:
    """Convert uint8 sRGB to linear light, float32 [H, W, 3]; float32 is linear already."""
    from sgmethod.opencv import cv2

    if pixels.dtype == np.float32:
        return pixels
    table = from_srgb(np.arange(256) / 255)
    return np.asarray(cv2.LUT(pixels, table.astype(np.float32)), np.float32)


def window_weights() -> NDArray[np.float64]:
    """Weights [WINDOW_SIZE] of a Gaussian window along one axis, which sum to 1."""
    offsets = np.arange(WINDOW_SIZE) - WINDOW_SIZE // 2
    weights = np.exp(-(offsets**2) / (2 * WINDOW_SIGMA**2))
    return np.asarray(weights / weights.sum())


def _window(plane: Plane) -> Plane:
    """Gaussian-weighted means, with zeros left and right of the picture; margins above and below are cut off."""
    from sgmethod.opencv import cv2

    weights = window_weights()
    filtered = cv2.sepFilter2D(plane, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(filtered[MARGIN:-MARGIN], np.float32)


def _halved(pixels: NDArray[Any]) -> Plane:
    """Reduce to half the size by means over 2 x 2 pixels in linear light; at odd sides, over the pixels there are."""
    from sgmethod.backend.planes import halved

    height, width = pixels.shape[:2]
    half = np.empty((-(-height // 2), -(-width // 2), 3), np.float32)
    rows = max(BAND // width, 1)

    def halve_band(start: int) -> None:
        half[start : start + rows] = halved(_linear(pixels[2 * start : 2 * (start + rows)]))

    in_parallel(halve_band, range(0, len(half), rows))
    return half
