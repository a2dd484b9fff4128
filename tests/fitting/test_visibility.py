"""The error as the eye sees it: one definition, and everything that keeps to it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from skimage import data

from sgmethod import View, decode, encode
from sgmethod.backend.protocol import Visibility
from sgmethod.fitting.objective import COARSE
from sgmethod.fitting.visibility import VisibleShare, error, of_detail, weigh
from sgmethod.native import native
from sgmethod.numerics import quiet
from sgmethod.scene import FloatArray
from tests.backend.cases import single
from tests.support.pictures import mirrored


def visibility(width: int, height: int, seed: int = 0) -> Visibility:
    """That changes little from one pixel to the next, by a factor of four in all; some pixels are hidden."""
    y, x = np.mgrid[:height, :width]
    levels = native.VISIBLE * 2.0 ** np.sin(x / 17 + y / 23 + seed)
    levels[2::5, 1::3] = 0
    return Visibility(np.asarray(np.round(levels), np.int16))


def seen(planes: FloatArray, visible: Visibility) -> float:
    """The definition: of an error [3, H, W], summed."""
    luma = np.tensordot(np.array(native.SEEN_LUMA), planes, 1)
    squares = np.square(planes).sum(0)
    counts = native.SEEN_COLOR * squares + luma**2 if visible.by_eye else squares
    return float((counts * visible.values / native.VISIBLE).sum())


def means_of_squares(planes: FloatArray, side: int) -> FloatArray:
    """Means over squares of planes [3, H, W], which count as 0 beyond."""
    _, height, width = planes.shape
    padded = np.pad(planes, ((0, 0), (0, -height % side), (0, -width % side)))
    squares = padded.reshape(3, padded.shape[1] // side, side, padded.shape[2] // side, side)
    return np.kron(squares.mean((2, 4)), np.ones((side, side)))[:, :height, :width].astype(np.float32)


@pytest.mark.parametrize("size", [(1, 1), (17, 65), (100, 141)])
def test_coarse_errors_of_decoded_pictures_count_once_more(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(5)
    decoded, source = rng.integers(0, 256, (2, *size[::-1], 3), np.uint8)
    visible = Visibility(visibility(*size).values, coarse=2)
    planes = (decoded.astype(np.float32) - source).transpose(2, 0, 1)
    coarse = means_of_squares(np.where(visible.values > 0, planes, np.float32(0)), native.COARSE_SIDE)
    wanted = seen(planes, visible) + visible.coarse * seen(coarse, visible)
    assert error(visible, decoded, source) == pytest.approx(wanted, rel=1e-6)


def test_squares_of_amplitudes_are_what_is_seen() -> None:
    planes = np.random.default_rng(6).normal(0, 1, (3, 20, 30)).astype(np.float32)
    visible = visibility(30, 20)
    wanted = seen(planes, visible)
    for rows in (planes[:, :13].copy(), 0), (planes[:, 13:].copy(), 13):
        weigh(visible, *rows)
        wanted -= np.square(rows[0]).sum()
    assert wanted == pytest.approx(0, abs=1e-3)
    a, b = np.random.default_rng(7).integers(0, 256, (2, 20, 30, 3), np.uint8)
    difference = (a.astype(np.float32) - b).transpose(2, 0, 1)
    assert error(visible, a, b) == pytest.approx(seen(difference, visible), rel=1e-5)
    grey = np.full((3, 20, 30), 0.5, np.float32)  # counts as its square does
    assert seen(grey, Visibility(np.full((20, 30), native.VISIBLE, np.int16))) == pytest.approx(
        float(np.square(grey).sum()), rel=0.01
    )


@pytest.mark.filterwarnings("error")
def test_what_is_no_number_has_a_share_all_the_same() -> None:
    """A start that was spoiled has such Gaussians, and the share decides which are dropped."""
    means = [[20.0, 10.0], [math.nan, 10.0], [math.inf, 10.0], [20.0, 10.0], [20.0, 10.0]]
    factors = [[width, 0.0, 3.0] for width in (3.0, 3.0, 3.0, math.nan, math.inf)]
    found = quiet(VisibleShare(visibility(40, 30)).look_up)(single(means, factors, np.ones((5, 3))))
    assert np.isfinite(found).all()
    assert (found > 0).tolist() == [True, True, True, False, True]


def test_detail_hides_errors() -> None:
    pixels = np.full((96, 128, 3), 128, np.uint8)
    pixels[:, 64:] = np.random.default_rng(8).integers(0, 256, (12, 8, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    visible = of_detail(pixels).values
    assert visible.shape == (96, 128)
    assert visible[:, :40].min() > 2 * visible[:, 80:].max()
    assert (of_detail(pixels[:1, :1]).values == native.VISIBLE).all()
    assert Visibility(visible[:95, :127]).half.values.shape == (48, 64)


PHOTO = np.ascontiguousarray(data.astronaut()[40:200, 140:300])


def test_visual_tuning_lowers_what_is_seen_within_the_same_bytes() -> None:
    """In the mean of mirror images, because chance moves a file by 3 %."""
    ratios = []
    for image in mirrored(PHOTO):
        visible = replace(of_detail(image), coarse=COARSE)
        both = {tune: encode(image, bpp=0.4, tune=tune) for tune in ("psnr", "visual")}
        errors = {tune: error(visible, decode(e.data, view=View(texture=False)), image) for tune, e in both.items()}
        ratios.append(errors["visual"] / errors["psnr"])
        assert all(e.stats.bpp <= 0.4 for e in both.values())
        assert both["visual"].stats.psnr < both["psnr"].stats.psnr
        assert both["visual"].trace[-1].psnr == pytest.approx(both["visual"].stats.psnr, abs=1e-3)
    assert np.mean(ratios) < 0.97


@pytest.mark.parametrize("budget", [{"bytes": 700}, {"quality": 40}, {"gaussians": 60}])
def test_other_budgets(budget: dict[str, float]) -> None:
    stats = encode(PHOTO[:96, :96], tune="visual", effort=2, **budget).stats  # type: ignore[arg-type]
    assert stats.bytes <= budget.get("bytes", math.inf)
    assert stats.gaussians <= budget.get("gaussians", math.inf)
    assert stats.psnr > 18


def test_odd_pictures() -> None:
    decoded = decode(encode(PHOTO[:64, :80, 1], bpp=1, tune="visual", effort=1).data)
    assert (decoded == decoded[:, :, :1]).all()
    flat = np.full((50, 70, 3), (10, 200, 90), np.uint8)
    assert (decode(encode(flat, bpp=1, tune="visual", effort=1).data) == flat).all()
    for shape in ((1, 1, 3), (1, 9, 3), (5, 2, 3), (3, 40, 3)):
        pixels = np.random.default_rng(9).integers(0, 256, shape, np.uint8)
        encoded = encode(pixels, bytes=200, tune="visual", effort=1)
        assert encoded.stats.bytes <= 200
        assert decode(encoded.data).shape == shape
