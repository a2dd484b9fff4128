"""Placement of the initial Gaussians, guided by structure (paper, section III-B) or, for comparison, random."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sgmethod.scene import FloatArray, Gaussians
from sgmethod.settings.shared import StartSettings
from sgmethod.start import structure
from sgmethod.start.structure import Structure

MIN_START_SCALE_PX = 0.5
GRADIENT_FLOOR = 1e-3  # keeps a flat region's density uniform; a quarter of a grey level per pixel
LARGEST_LOCAL_SCALE = 3.0  # times the mean scale of the region


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


def allocate_by_number(complexity: FloatArray, n: int, ratio: tuple[float, float, float]) -> NDArray[np.int64]:
    """Numbers of Gaussians per region, summing to n, regardless of area.

    Three categories have equally many regions, and a share is spread evenly over regions. Profile rd starts this way:
    with its few Gaussians, counting area gains nothing.
    """
    order = np.argsort(-complexity, kind="stable")
    counts = np.zeros(len(order), np.int64)
    ranks = np.arange(len(order))
    for category, share in zip(reversed(np.array_split(ranks[::-1], 3)), ratio, strict=True):
        if len(category):
            counts[category] = int(n * share) // len(category)
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

    Unless the settings say otherwise, they are round, each with its share of the picture's area as a disc, and have the
    colours of the pixels at their centres.
    """
    height, width = image.shape[:2]
    if settings.structure_guided:
        found = structure.analyse(image, min(max(n // settings.gaussians_per_region, 9), height * width), settings)
        ratio = dynamic_ratio(n, height * width, settings)
        if settings.shared_by_area:
            counts = allocate(found.complexity, found.area, n, ratio)
        else:
            counts = allocate_by_number(found.complexity, n, ratio)
        if settings.follows_gradient:
            return _by_gradient(image, found, counts, rng)
        means = _evenly(found, counts, rng)
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


def _by_gradient(image: FloatArray, found: Structure, counts: NDArray[np.int64], rng: np.random.Generator) -> Gaussians:
    """Profile rd's start: denser and smaller where the gradient is strong, and along edges."""
    means, scales = _scatter(found, counts, rng)
    below = _pixels_below(means, image.shape[:2])
    return Gaussians(means, _along_edges(scales, found.tensor[below]), image[below])


def _scatter(found: Structure, counts: NDArray[np.int64], rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Means [n, 2] and scales [n] in pixels, sampled within each region by gradient magnitude (stratified).

    A Gaussian's scale is the radius of a disc with the area it has to cover, 1 / density.
    """
    width = found.labels.shape[1]
    pixels = np.argsort(found.labels.ravel(), kind="stable")
    starts = np.concatenate([[0], np.cumsum(found.area)])
    weight = found.gradient.ravel() + GRADIENT_FLOOR
    means, scales = [], []
    for region in np.flatnonzero(counts):
        n = counts[region]
        inside = pixels[starts[region] : starts[region + 1]]
        density = weight[inside] / weight[inside].sum()
        quantiles = (np.arange(n) + rng.random(n)) / n
        chosen = np.minimum(np.searchsorted(np.cumsum(density), quantiles), len(inside) - 1)
        even = math.sqrt(len(inside) / (math.pi * n))
        scales.append(np.minimum(1 / np.sqrt(math.pi * n * density[chosen]), LARGEST_LOCAL_SCALE * even))
        means.append(np.stack([inside[chosen] % width, inside[chosen] // width], 1) + rng.random((n, 2)))
    return np.concatenate(means).astype(np.float32), np.concatenate(scales).astype(np.float32)


def _along_edges(scales: FloatArray, tensor: FloatArray) -> FloatArray:
    """Cholesky factors [n, 3] of ellipses of the given scales, elongated along coherent edges, at most e to 1."""
    xx, xy, yy = tensor.T
    across = 0.5 * np.arctan2(2 * xy, xx - yy)
    coherence = np.hypot(xx - yy, 2 * xy) / (xx + yy + 1e-6)
    stretch = np.exp(coherence)
    thin, long = scales**2 / stretch, scales**2 * stretch
    c, s = np.cos(across), np.sin(across)
    l1 = np.sqrt(thin * c * c + long * s * s)
    l2 = (thin - long) * c * s / l1
    l3 = np.sqrt(np.maximum(thin * s * s + long * c * c - l2 * l2, 0))
    l1, l3 = np.maximum(l1, MIN_START_SCALE_PX), np.maximum(l3, MIN_START_SCALE_PX)
    return np.stack([l1, l2, l3], 1).astype(np.float32)
