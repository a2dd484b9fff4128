"""Views: any size, any part, part of the file."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import sgmethod
from sgmethod import BitstreamError, ViewError, decode, view
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.decoder import draw
from sgmethod.metrics import psnr
from sgmethod.native import native
from sgmethod.scene import Gaussians, Scene
from sgmethod.view import View
from tests.backend.cases import single
from tests.support.data import golden

WIDTH, HEIGHT = 200, 120


def scattered(n: int = 700) -> Gaussians:
    """A busy picture, many Gaussians as small as a pixel."""
    rng = np.random.default_rng(7)
    factors = np.exp(rng.uniform(np.log(0.4), 3, (n, 1)) + rng.normal(0, 0.4, (n, 3)))
    factors[:, 1] *= rng.choice([-1, 0, 1], n)
    return single(rng.uniform(-0.1, 1.1, (n, 2)) * (WIDTH, HEIGHT), factors, rng.normal(0, 0.25, (n, 3)))


@pytest.fixture(scope="module")
def data() -> bytes:
    return container.serialise(StreamV2.from_gaussians(scattered(), (WIDTH, HEIGHT), 0.01, (120, 110, 100), False))


def averaged(pixels: NDArray[np.uint8], by: int) -> NDArray[np.uint8]:
    height, width = pixels.shape[0] // by, pixels.shape[1] // by
    blocks = pixels.reshape(height, by, width, by, 3).astype(float)
    return np.round(blocks.mean((1, 3))).astype(np.uint8)


def test_the_plain_view_changes_nothing(data: bytes) -> None:
    assert np.array_equal(decode(data, view=View()), decode(data))
    assert np.array_equal(decode(data, view=View(1.0, (0, 0, WIDTH, HEIGHT))), decode(data))


REGIONS = [(0, 0, 1, 1), (13, 7, 52, 33), (65, 119, 1, 1), (0, 50, 66, 9)]


@pytest.mark.parametrize(
    ("name", "scale", "region"),
    [
        *itertools.product(("v2-busy", "v2-texture"), (1, 2, 3), REGIONS),  # of 200 x 120 and 66 x 200 pixels
        *itertools.product(("v2-busy", "v2-texture"), (0.5, 1.5), [(8, 20, 56, 60)]),
        ("v2-busy", 0.25, (40, 20, 80, 60)),
    ],
)
def test_a_region_is_a_crop(name: str, scale: float, region: tuple[int, int, int, int]) -> None:
    """Regions begin and end on whole pixels."""
    whole, part = (decode(golden(2)[name], view=View(scale, where)) for where in (None, region))
    x, y, w, h = (int(scale * v) for v in region)
    assert np.array_equal(part, whole[y : y + h, x : x + w])


# Seen: 46.5, 40.6 and 34.6 dB; 39.4, 32.3 and 26.3 without the low-pass.
@pytest.mark.parametrize(("by", "at_least_db", "gain_db"), [(2, 46, 6.5), (4, 40, 7.5), (8, 34, 7.5)])
def test_shrinking_agrees_with_averaging(
    data: bytes, monkeypatch: pytest.MonkeyPatch, by: int, at_least_db: float, gain_db: float
) -> None:
    expected = averaged(decode(data), by)
    filtered = psnr(decode(data, view=View(1 / by)), expected)
    if by == 2:  # by a box filter of another maker
        boxed = np.asarray(Image.fromarray(decode(data)).resize((WIDTH // 2, HEIGHT // 2), Image.Resampling.BOX))
        assert psnr(decode(data, view=View(0.5)), boxed) > 40
    monkeypatch.setattr(view, "PIXEL_VARIANCE", 0.0)
    plain = psnr(decode(data, view=View(1 / by)), expected)
    assert filtered > at_least_db
    assert filtered > plain + gain_db


@pytest.mark.parametrize(
    ("scale", "region", "size"),
    [
        (0.5, None, (100, 60)),
        (0.25, (0, 0, 7, 5), (2, 1)),
        (1 / 64, None, (3, 2)),
        (1 / 64, (5, 5, 3, 3), (1, 1)),
        (0.5, (0, 0, 5, 3), (2, 2)),  # halves go to the even number
        (8.0, (10, 10, 33, 2), (264, 16)),
        (64.0, (10, 10, 2, 3), (128, 192)),
        (1.003, None, (201, 120)),
    ],
)
def test_sizes(data: bytes, scale: float, region: tuple[int, int, int, int] | None, size: tuple[int, int]) -> None:
    asked = View(scale, region)
    assert asked.size(WIDTH, HEIGHT) == size
    assert decode(data, view=asked).shape == (size[1], size[0], 3)


def scene(gaussians: Gaussians, cutoff: float = native.MAX_CUTOFF) -> Scene:
    return Scene(gaussians, WIDTH, HEIGHT, (90, 90, 90), cutoff)


@pytest.mark.parametrize("cutoff", [native.MAX_CUTOFF, native.CUTOFF_V2])
def test_the_covariance_grows_by_what_is_missing(cutoff: float) -> None:
    gaussians = scattered()
    shrunk = View(0.25).apply(scene(gaussians, cutoff)).gaussians
    before, after = (np.zeros((len(gaussians), 2, 2)) for _ in range(2))
    for covariance, factors in ((before, gaussians.factors), (after, shrunk.factors)):
        lower = np.zeros_like(covariance)
        lower[:, 0, 0], lower[:, 1, 0], lower[:, 1, 1] = factors.T
        covariance[:] = lower @ lower.transpose(0, 2, 1)
    sigma = (np.arange(100_000) + 0.5) * cutoff / 100_000
    weight = np.exp(-sigma) - np.exp(-cutoff)
    share = (weight * sigma).sum() / weight.sum()  # of a whole Gaussian's variance that one that ends there has
    expected = before / 16 + (1 - 1 / 16) / 12 / share * np.eye(2)
    assert np.allclose(after, expected, rtol=1e-4, atol=1e-6)


def test_what_adds_nothing_stays_so() -> None:
    """Some files can hold scales below zero; widening must not bring them to life."""
    gaussians = scattered(60)
    gaussians.factors[::3, 0] *= -1
    gaussians.factors[1::3, 2] = 0
    visible = gaussians.rows(np.arange(2, 60, 3))
    for asked in (View(0.3), View(region=(5, 5, 100, 100))):
        with_them, without = (draw(asked.apply(scene(g))) for g in (gaussians, visible))
        assert np.array_equal(with_them, without)


def test_a_prefix_comes_nearer(data: bytes) -> None:
    whole = decode(data)
    found = [psnr(decode(data, view=View(prefix=p)), whole) for p in (0.02, 0.1, 0.3, 0.6, 0.9, 1.0)]
    assert found == sorted(found)
    assert found[-1] == math.inf
    assert decode(data, view=View(0.5, (0, 0, 40, 40), 0.3)).shape == (20, 20, 3)
    background = np.full_like(whole, (120, 110, 100))
    assert np.array_equal(decode(data, view=View(prefix=1e-6)), background)


@pytest.mark.parametrize(
    ("sides", "shape"),
    [((50, None), (30, 50, 3)), ((None, np.int32(240)), (240, 400, 3)), ((50, 15), (15, 25, 3)), ((9, 9), (5, 9, 3))],
)
def test_a_view_within_a_width_and_height(data: bytes, sides: tuple[Any, Any], shape: tuple[int, ...]) -> None:
    file = sgmethod.open(data)  # 200 x 120
    assert file.pixels(width=sides[0], height=sides[1]).shape == shape
    with pytest.raises(ViewError, match="scale cannot be combined"):
        file.pixels(0.5, width=sides[0], height=sides[1])
    with pytest.raises(ViewError, match="a width or height must be a whole number"):
        file.pixels(width=0)
    for side in ({"width": 3}, {"height": 1}, {"width": 20_000, "height": 10_000}):
        with pytest.raises(ViewError, match="width can be 4 to 12800, and height 2 to 7680"):
            file.pixels(**side)
    assert file.pixels(width=4).shape == (2, 4, 3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("scale", v) for v in (0, -1, 1 / 65, 64.1, math.nan, math.inf)),
        *(("prefix", v) for v in (0, -0.1, 1.01, math.nan)),
    ],
)
def test_refused_scales_and_prefixes(name: str, value: float) -> None:
    with pytest.raises(ViewError, match=name):
        View(**{name: value})


@pytest.mark.parametrize(
    "region",
    [(-1, 0, 5, 5), (0, -1, 5, 5), (0, 0, 0, 5), (0, 0, 5, 0), (0, 0, 201, 5), (0, 100, 5, 21), (200, 0, 1, 1)],
)
def test_refused_regions(data: bytes, region: tuple[int, int, int, int]) -> None:
    with pytest.raises(ViewError, match="region"):
        decode(data, view=View(region=region))


def test_a_view_beyond_the_limit(data: bytes) -> None:
    limit = WIDTH * HEIGHT
    assert decode(data, limit, View(8.0, (0, 0, 20, 10))).shape == (80, 160, 3)
    with pytest.raises(BitstreamError, match="limit"):
        decode(data, limit, View(1.01))
