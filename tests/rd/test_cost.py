"""Cost follows the file: a picture of more pixels than its Gaussians can show costs as if it had fewer."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod import Budget
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Descent, Frame, Moments, RefineLimits
from sgmethod.decoder import draw_whole
from sgmethod.fitting.level import Pyramid
from sgmethod.metrics import psnr
from sgmethod.rd.search import MAX_TRIES
from sgmethod.rd.sparse import whole_of
from sgmethod.scene import Gaussians
from tests.definitions.backend import step_by_step
from tests.rd.short import asked, short
from tests.support.pictures import photo

Pixels = NDArray[np.uint8]
CROP = photo()
BUDGET = Budget("bytes", 200)


class Counting(Kernels):
    """Counts the pixels of gradients, and those of the largest target that is refined."""

    def __init__(self) -> None:
        self.fitted = self.refined = self.refinings = 0

    steps = step_by_step

    def gradients(self, gaussians: Gaussians, frame: Frame, *rest: Any) -> tuple[float, Gaussians]:
        self.fitted += frame.width * frame.height
        return super().gradients(gaussians, frame, *rest)

    def refine(self, gaussians: Gaussians, coding: Any, target: Any, limits: RefineLimits, *rest: Any) -> bytes:
        self.refined = max(self.refined, target[0].size)
        self.refinings += 1
        return super().refine(gaussians, coding, target, limits, *rest)


def enlarged(times: int) -> Pixels:
    return np.asarray(cv2.resize(CROP, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC), np.uint8)


def test_pixels_beyond_what_the_file_shows_cost_nothing() -> None:
    costs, found = [], []
    for pixels in (CROP, enlarged(8)):
        backend = Counting()
        stream, _ = asked(pixels, BUDGET, backend=backend).encode()
        assert 1 <= backend.refinings <= MAX_TRIES + 1
        costs.append((backend.fitted, backend.refined))
        found.append(psnr(draw_whole(stream), pixels))
    (fitted, refined), (of_large, refined_of_large) = costs
    assert of_large < 1.7 * fitted  # 64 times as many pixels
    assert refined_of_large < 4.5 * refined
    assert found[1] > found[0] - 0.3


@pytest.mark.parametrize("tune", ["psnr", "visual"])
def test_the_finest_level_has_the_pixels_that_gaussians_need(tune: Any) -> None:
    levels = asked(enlarged(8), BUDGET, tune).begun().levels
    expected = levels.gaussians
    assert 4 * 400 * expected > levels.finest.pixels >= 400 * expected
    assert levels.optimiser.min_scale_px == 0.75 * levels.finest.frame.spacing
    whole = asked(CROP, Budget("bpp", 1), tune).begun().levels
    assert whole.finest.frame.spacing == 1


def test_a_reduced_level_asks_for_the_gaussians_of_the_whole() -> None:
    """Fitted to means alone, they would be wider by the blur of the means."""
    y, x = np.mgrid[:512, :512]
    pixels = np.repeat((250 * np.exp(-((x - 255.5) ** 2 + (y - 255.5) ** 2) / 2 / 6**2))[..., None], 3, 2)
    smooth = asked(np.asarray(np.rint(pixels), np.uint8), Budget("bytes", 64))
    whole = whole_of(smooth.problem, smooth.backend)
    level = Pyramid.from_whole(whole, smooth.rate.expected_gaussians()).finest  # not the atlas of its one island
    assert level.frame.spacing >= 4
    peak = level.image()[0].max() * 255 + smooth.problem.background[0]
    assert peak == pytest.approx(250 * np.exp(-(2**2 + 2**2) / 2 / 6**2), abs=2)  # 217 without sharpening


class Weighing(Kernels):
    """Notes how many bytes arrays take, at most, while the kernels step and refine."""

    def __init__(self) -> None:
        self.stepping = self.refining = 0

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        self.stepping = max(self.stepping, tracemalloc.get_traced_memory()[0])
        return super().steps(gaussians, moments, descent, rates)

    def refine(self, *given: Any) -> bytes:
        self.refining = max(self.refining, tracemalloc.get_traced_memory()[0])
        return super().refine(*given)


def test_few_arrays_of_the_whole_picture_are_held() -> None:
    """When refining begins, which needs most memory of its own: pixels, visibility and one target."""
    weighing, size = Weighing(), (640, 480)
    asked(CROP, BUDGET, "visual", settings=short(4)).encode()  # imports
    tracemalloc.start()
    try:
        asked(cv2.resize(CROP, size), Budget("bytes", 4000), "visual", settings=short(60), backend=weighing).encode()
    finally:
        tracemalloc.stop()
    stepping, refining = (held / (size[0] * size[1]) for held in (weighing.stepping, weighing.refining))
    assert stepping < 35  # bytes a pixel: 31 seen, and 39 when the grain and the target before were kept
    assert refining < 18  # 12 seen, and 27 when all that the fit had seen was kept
