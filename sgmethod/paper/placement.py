"""Placement of the initial Gaussians, guided by structure (paper, section III-B) or, for comparison, random."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sgmethod.paper import structure
from sgmethod.paper.settings import StartSettings
from sgmethod.paper.structure import Structure
from sgmethod.scene import FloatArray, Gaussians

MIN_START_SCALE_PX = 0.5


def dynamic_ratio(n: int, pixels: int, settings: StartSettings) -> tuple[float, float, float]:
    """Shares of the three categories of complexity, summing to 1 (equation 4).

    phi_i(n) = (1 - s) phi_i + s / 3 with phi normalised, s = clamp((n - n_0) / (N_t - n_0), 0, 1)^gamma and
    N_t = k pixels^alpha. The base is clamped, not the power: gamma is even. Where N_t <= n_0 the ratio turns
    uniform at n_0 at once.
    """
    threshold = settings.threshold_factor * pixels**settings.threshold_exponent
    span = threshold - settings.ratio_start
    base = (n - settings.ratio_start) / span if span > 0 else float(n > settings.ratio_start)
    s = min(max(base, 0.0), 1.0) ** settings.ratio_exponent
    total = sum(settings.ratio)
    a, b, c = ((1 - s) * phi / total + s / 3 for phi in settings.ratio)
    return a, b, c


def allocate(
    complexity: FloatArray, area: NDArray[np.int64], n: int, ratio: tuple[float, float, float]
) -> NDArray[np.int64]:
    """Numbers of Gaussians per region, summing to n.

    Regions in descending order of complexity form three categories of a third of the picture each; a region on the
    boundary belongs to both. A category's share is spread evenly over its area, so that the ratio 1:1:1 is a uniform
    start. Gaussians lost by rounding down go one by one to the most complex regions.
    """
    order = np.argsort(-complexity, kind="stable")
    ends = np.cumsum(area[order]) / area.sum()
    shares = np.interp(ends, np.linspace(0, 1, 4), [0, *np.cumsum(ratio)])  # cumulative, from the most complex region
    counts = np.floor(n * np.diff(shares, prepend=0) + 1e-9).astype(np.int64)  # 1e-9: whole numbers must not round down
    return _with_rest(counts, n, order)


def _with_rest(counts: NDArray[np.int64], n: int, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Complete counts by rank to a sum of n, first ranks first; return them by region. order: region of each rank."""
    rounds, left = divmod(n - int(counts.sum()), len(order))
    found = np.empty_like(order)
    found[order] = counts + rounds
    found[order[:left]] += 1
    return found


def place_by_structure(image: FloatArray, n: int, settings: StartSettings, rng: np.random.Generator) -> Gaussians:
    """Place n initial Gaussians on an image [H, W, 3] in [0, 1].

    They are round, each with its share of the picture's area as a disc, and have the colours of the pixels at their
    centres.
    """
    height, width = image.shape[:2]
    if settings.structure_guided:
        found = structure.analyse(image, min(max(n // settings.gaussians_per_region, 9), height * width), settings)
        ratio = dynamic_ratio(n, height * width, settings)
        means = _evenly(found, allocate(found.complexity, found.area, n, ratio), rng)
    else:
        means = (rng.random((n, 2)) * (width, height)).astype(np.float32)
    scale = max(math.sqrt(width * height / (math.pi * n)), MIN_START_SCALE_PX)
    factors = np.tile(np.array([scale, 0, scale], np.float32), (n, 1))
    return Gaussians(means, factors, image[_pixels_below(means, (height, width))])


def _pixels_below(means: FloatArray, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    whole = np.floor(means).astype(np.int64)
    return np.clip(whole[:, 1], 0, shape[0] - 1), np.clip(whole[:, 0], 0, shape[1] - 1)


def _evenly(found: Structure, counts: NDArray[np.int64], rng: np.random.Generator) -> FloatArray:
    """Means [n, 2] in pixels, uniformly distributed within each region."""
    width = found.labels.shape[1]
    pixels = np.argsort(found.labels.ravel(), kind="stable")
    region = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(found.area) - found.area
    chosen = pixels[first[region] + (rng.random(len(region)) * found.area[region]).astype(np.int64)]
    means = np.stack([chosen % width, chosen // width], 1) + rng.random((len(region), 2))
    return means.astype(np.float32)
