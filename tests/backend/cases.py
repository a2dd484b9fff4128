"""Small random cases on which backends are compared."""

from __future__ import annotations

from itertools import product

import numpy as np

from sgmethod.backend.protocol import CUTOFF, MAX_CUTOFF, TARGET_WHITE, VISIBLE, Frame, Target, Visibility
from sgmethod.scene import FloatArray, Gaussians

SIZE = (40, 35)  # of a frame: of several tiles, and not of whole ones
FRAMES = {
    f"{'pyramid' if pyramid else 'plain'}, spacing {spacing}": Frame(*SIZE, CUTOFF, pyramid, spacing)
    for pyramid, spacing in product((True, False), (1, 2))
} | {"wide cut-off": Frame(*SIZE, MAX_CUTOFF, pyramid=False)}
VISIBILITIES = ("none", "eye", "alpha", "coarse")


def scattered(n: int, seed: int, size: tuple[int, int] = SIZE) -> Gaussians:
    """Gaussians from a pixel to a whole picture in size, some around it."""
    rng = np.random.default_rng(seed)
    factors = np.exp(rng.uniform(-1, 3.5, (n, 1)) + rng.normal(0, 0.5, (n, 3)))
    factors[:, 1] *= rng.choice([-1, 0, 1], n)
    return single(rng.uniform(-0.1, 1.1, (n, 2)) * size, factors, rng.normal(0, 0.2, (n, 3)))


def single(*values: object) -> Gaussians:
    """Means, factors and colours in single precision."""
    return Gaussians(*(np.ascontiguousarray(array, np.float32) for array in values))


def over(frame: Frame, seed: int) -> Gaussians:
    return scattered(25, seed, (frame.width * frame.spacing, frame.height * frame.spacing))


def image(seed: int) -> FloatArray:
    """[3, H, W], smooth, with noise."""
    rng, (width, height) = np.random.default_rng(seed), SIZE
    y, x = np.mgrid[0:height, 0:width] / 10
    waves = np.stack([np.sin(x + y), np.cos(2 * x - y), np.sin(x * y)])
    return np.asarray(0.4 * waves + 0.1 * rng.standard_normal(waves.shape), np.float32)


def target(seed: int) -> Target:
    """That picture as a target."""
    return np.asarray(np.round(image(seed) * TARGET_WHITE), np.int16)


def visibility(kind: str, seed: int, size: tuple[int, int] = SIZE) -> Visibility | None:
    """What each pixel counts: from nothing to three times, by the eye; or up to once, under alpha."""
    if kind == "none":
        return None
    most = VISIBLE if kind == "alpha" else 3 * VISIBLE
    values = np.random.default_rng(seed).integers(0, most + 1, size[::-1])
    return Visibility(values.astype(np.int16), kind != "alpha", coarse=2.0 if kind == "coarse" else 0.0)


def worst(found: FloatArray, wanted: FloatArray) -> float:
    """The largest error, in parts of the largest value."""
    assert found.dtype == wanted.dtype == np.float32
    assert found.shape == wanted.shape
    return float(np.abs(found - wanted, dtype=np.float64).max(initial=0) / np.abs(wanted).max(initial=1e-30))
