"""Pictures that are hard to code, which keep a few rules: no failure, no budget exceeded, nothing clipped, a PSNR that
is reachable is reached, and more bytes are never much worse. Slow: 240 whole encodes."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from sgmethod import Budget, Encoded, encode
from sgmethod.budget import BudgetKind
from sgmethod.native import native

pytestmark = pytest.mark.thorough

Pixels = NDArray[np.uint8]
AIMS = (20, 30, 45, 60)  # dB
SIZES = (18, 64, 100, 150, 220, 300, 450, 600, 900, 2000, 6000)
ROUNDED_DB = 58.9  # as good as rounding to 8 bits allows
MAX_STEPS = 1300  # of an encode with the default effort; 787 but for two rounds while a PSNR is missed
Y, X = np.mgrid[:48, :64]


def grey(levels: Any) -> Pixels:
    return np.repeat(np.asarray(levels, np.uint8)[..., None], 3, axis=2)


def text() -> Pixels:
    image = Image.new("L", (64, 48), 255)
    for row in range(0, 48, 12):
        ImageDraw.Draw(image).text((2, row), "Quick brown", fill=0)
    return grey(image)


STIFF: dict[str, Pixels] = {
    "text": text(),
    "checkerboard": grey(255 * ((X + Y) % 2))[:40, :40],  # nothing of it is left at half the size
    "squares": grey(255 * ((X // 2 + Y // 2) % 2))[:40, :48],
    "noise": np.random.default_rng(3).integers(0, 256, (24, 32, 3), np.uint8),
    "columns": np.array([[255, 0, 0], [0, 0, 255]], np.uint8)[X % 2][:32, :40],
    "zone plate": grey(127.5 + 127.5 * np.cos(np.pi * ((X - 23.5) ** 2 + (Y - 19.5) ** 2) / 48))[:40, :48],
    "lines": grey(np.where((3 * X + Y) % 24 < 3, 30, 255)),
    "row": np.random.default_rng(5).integers(0, 256, (1, 120, 3), np.uint8),
    "column": np.random.default_rng(5).integers(0, 256, (120, 1, 3), np.uint8),
}
# A fit that misses half of the squares or lines, by chance, is up to 17 dB worse than one of fewer bytes; which of them
# does depends on the instruction set. A second fit of every picture would find the better file, for twice the time.
MOST_WORSE = 7  # of 99 sizes; seen: 4
MOST_MISSED = 2  # of 36 targets; seen: 2, by 4 dB
each_picture = pytest.mark.parametrize("name", STIFF)


@cache
def encoded(name: str, kind: BudgetKind, value: float) -> Encoded:
    return encode(STIFF[name], Budget(kind, value), tune="psnr")


@each_picture
def test_budgets_and_steps_are_kept(name: str) -> None:
    clipped = native.rd_clipped_values()
    for size in SIZES:
        assert len(encoded(name, "bytes", size).data) <= size
    every = [encoded(name, "bytes", size) for size in SIZES] + [encoded(name, "psnr", aim) for aim in AIMS]
    assert max(file.stats.steps for file in every) <= MAX_STEPS
    assert native.rd_clipped_values() == clipped


def test_more_bytes_are_hardly_ever_worse() -> None:
    worse = []
    for name in STIFF:
        best = 0.0
        for size in SIZES:
            db = encoded(name, "bytes", size).stats.psnr
            if db < min(best, ROUNDED_DB) - 0.5:
                worse.append((name, size))
            best = max(best, db)
    assert len(worse) <= MOST_WORSE, worse


def test_a_psnr_that_is_reachable_is_hardly_ever_missed() -> None:
    missed = []
    for name in STIFF:
        reachable = max(encoded(name, "bytes", size).stats.psnr for size in SIZES)
        missed += [(name, aim) for aim in AIMS if encoded(name, "psnr", aim).stats.psnr < aim <= reachable]
    assert len(missed) <= MOST_MISSED, missed


@each_picture
def test_other_budgets_are_kept(name: str) -> None:
    clipped = native.rd_clipped_values()
    for most in (1, 30):
        assert encode(STIFF[name], gaussians=most, tune="visual").stats.gaussians <= most
    for size in (18, 60, 400):  # some of it for texture
        assert len(encode(STIFF[name], bytes=size, tune="visual").data) <= size
    assert native.rd_clipped_values() == clipped


@pytest.mark.parametrize("size", [(1, 2), (3, 3), (1, 17), (5, 7), (64, 1)])
def test_tiny_pictures_use_what_they_are_given(size: tuple[int, int]) -> None:
    """A pixel needs as many bytes as a Gaussian has, not as many as samples."""
    pixels = np.random.default_rng(8).integers(0, 256, (*size, 3), np.uint8)
    assert encode(pixels, bytes=100_000, tune="psnr").stats.psnr > 30


def test_a_checkerboard_of_single_pixels_gains_from_each_byte() -> None:
    found = [encoded("checkerboard", "bytes", size).stats.psnr for size in (300, 600, 2000, 6000)]
    for fewer, more in pairwise(found):
        assert more > fewer + 3
    assert found[-1] > 40


@pytest.mark.parametrize(("name", "kind", "value"), [("squares", "bytes", 400), ("lines", "psnr", 35)])
def test_the_trace_goes_on_to_the_end(name: str, kind: BudgetKind, value: float) -> None:
    """Each phase counts its own steps."""
    trace = encoded(name, kind, value).trace
    assert all(before.step <= after.step for before, after in pairwise(trace) if before.phase == after.phase)
    assert trace[-1].step == trace[-1].steps
