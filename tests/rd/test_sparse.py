"""Sparse pictures: the fit sees the islands in a picture's background, and nothing of them is lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from sgmethod import decode, encode
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Descent, Moments
from sgmethod.budget import Budget
from sgmethod.fitting.islands import Islands, moved
from sgmethod.rd.sparse import whole_of
from sgmethod.scene import Gaussians, Pixels
from sgmethod.settings.shared import Tune
from tests.rd.short import asked, short
from tests.support.pictures import photo

GREY = (128, 128, 128)


def dots(number: int, side: int = 600) -> Pixels:
    """White pixels on grey."""
    pixels = np.full((side, side, 3), GREY, np.uint8)
    pixels[tuple(np.random.default_rng(2).integers(0, side, (2, number)))] = 255
    return pixels


class Watched(Kernels):
    """Kernels that note the pixels that each call for steps looks at."""

    def __init__(self) -> None:
        self.pixels: list[int] = []

    def steps(self, gaussians: Gaussians, moments: Moments, descent: Descent, rates: Sequence[float]) -> list[float]:
        self.pixels.append(descent.frame.width * descent.frame.height)
        return super().steps(gaussians, moments, descent, rates)


@pytest.mark.parametrize("number", [1, 30])
@pytest.mark.parametrize("tune", ["psnr", "visual"])
def test_steps_look_at_islands_only(number: int, tune: Tune) -> None:
    """One dot used to take as many pixels as the whole picture has, 12 s at four megapixels."""
    backend = Watched()
    asked(dots(number), Budget("bytes", 300), tune, settings=short(40), backend=backend).encode()
    assert max(backend.pixels) <= number * 12 * 12 * 1.5  # 144 and 4,320 were seen


@pytest.mark.parametrize("options", [{"tune": "psnr"}, {}], ids=["psnr", "visual"])
def test_a_dot_does_not_vanish(options: Any) -> None:
    """At 30 bytes, there was none: all went into the page's grey, which a short file rounds to 132."""
    beside = []
    for side in (600, 700, 800, 1000):  # which of them a few steps of colour favour is chance
        pixels = dots(1, side)
        drawn = decode(encode(pixels, bytes=30, **options).data).astype(int)
        y, x = np.argwhere(pixels[..., 0] == 255)[0]
        assert abs(drawn[y, x] - 255).max() <= 12  # 5 was seen
        drawn[y, x] = GREY
        beside.append(abs(drawn - 128).max())
    assert np.mean(beside) <= 12  # 9 was seen


def test_errors_are_those_of_the_whole_picture() -> None:
    pixels = dots(5)
    sparse = asked(pixels, Budget("bytes", 300))
    level, whole = sparse.levels.finest, whole_of(sparse.problem, sparse.backend)
    assert level.pixels < whole.pixels
    places = np.argwhere(pixels[..., 0] == 255)[:, ::-1].astype(np.float32) + 0.5
    gaussians = Gaussians(places, np.tile(np.float32([0.6, 0, 0.6]), (5, 1)), np.full((5, 3), 0.3, np.float32))
    found = level.backend.error(gaussians, level.frame, level.target)
    assert found == pytest.approx(Kernels().error(gaussians, whole.frame, whole.target), rel=1e-5)
    _, in_atlas = level.gradients(gaussians)
    _, right = whole.gradients(gaussians)
    for one, other in zip(in_atlas.arrays, right.arrays, strict=True):
        np.testing.assert_allclose(level.values * one, whole.values * other, rtol=1e-3, atol=1e-3)


def test_islands_go_to_the_atlas_and_back() -> None:
    pixels = dots(40, 203)
    islands = Islands.from_pixels(pixels, GREY)
    assert islands is not None
    planes = pixels.transpose(2, 0, 1)
    atlas = islands.laid(planes, 128)
    assert (atlas == 255).sum() == (planes == 255).sum()  # each island once
    np.testing.assert_array_equal(islands.put_back(atlas, np.full_like(planes, 128)), planes)
    places = np.argwhere(pixels[..., 0] == 255)[:, ::-1].astype(np.float32) + 0.5
    there = moved(places, islands.to_atlas)
    assert (atlas[(0, *there.astype(int).T[::-1])] == 255).all()
    np.testing.assert_array_equal(moved(there, islands.to_picture), places)


def test_a_plain_picture_has_none() -> None:
    assert Islands.from_pixels(np.full((20, 30, 3), GREY, np.uint8), GREY) is None


def test_a_photograph_is_fitted_whole() -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    assert asked(pixels, Budget("bytes", 300)).levels.finest.islands is None


def test_a_photograph_in_a_blank_area_is_drawn_well() -> None:
    """Fitted as an island, its wide Gaussians smeared the area around it: 32 points, not 82."""
    padded = np.full((600, 800, 3), 255, np.uint8)
    padded[200:296, 300:428] = photo("kodim05-crop")[:96, :128]
    stats = encode(padded, bytes=2500, tune="fidelity", measure=True).stats
    assert stats.ssimulacra2 > 60
