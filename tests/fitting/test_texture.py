"""Texture from a seed: what the decoder draws, and where the encoder asks for it."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw

import sgmethod
from sgmethod import Budget, View, decode, encode
from sgmethod.bitstream import container
from sgmethod.bitstream.texture import Codes, cells
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.texture import BLOCK, MAX_LEVELS, SHOWN, estimate, grain
from sgmethod.metrics import psnr
from sgmethod.native import native
from sgmethod.rd.rate_control import EXACT_DB, Coded
from sgmethod.rd.search import TEXTURE_SHARE
from sgmethod.scene import Gaussians
from tests.backend.cases import single
from tests.support.data import golden_path
from tests.support.pictures import photo

Pixels = NDArray[np.uint8]
SIZE = WIDTH, HEIGHT = 300, 200
UNLIMITED = patch("sgmethod.fitting.texture.MAX_LEVELS", 1000.0)
STRENGTHS = [0.0, *(2 ** ((code - 1) / 2) / 2 for code in range(1, native.TEXTURE_STRENGTHS))]  # levels of 8 bits


def some_gaussians(n: int = 300) -> Gaussians:
    rng = np.random.default_rng(7)
    factors = np.exp(rng.uniform(-0.5, 3, (n, 1)) + rng.normal(0, 0.3, (n, 3)))
    return single(rng.uniform(0, 1, (n, 2)) * SIZE, factors, rng.normal(0, 0.1, (n, 3)))


def file_of(
    codes: Codes | None, gaussians: Gaussians | None = None, *, grey: bool = False, size: tuple[int, int] = SIZE
) -> bytes:
    stream = StreamV2.from_gaussians(
        gaussians or Gaussians.empty(0), size, 0.02, (128, 128, 128) if grey else (140, 120, 110), grey
    )
    return container.serialise(replace(stream, texture=codes))


def codes_of(octave_0: int, octave_1: int, size: tuple[int, int] = SIZE) -> Codes:
    """The same strength everywhere."""
    codes = np.zeros((native.TEXTURE_OCTAVES, *cells(*size)), np.uint8)
    codes[0], codes[1] = octave_0, octave_1
    return codes


def varied(seed: int = 1) -> Codes:
    rng = np.random.default_rng(seed)
    return rng.integers(0, 12, (native.TEXTURE_OCTAVES, *cells(*SIZE))).astype(np.uint8)


@pytest.fixture(scope="module")
def textured() -> bytes:
    return file_of(varied(), some_gaussians())


def test_it_can_be_left_out(textured: bytes) -> None:
    plain = decode(file_of(None, some_gaussians()))
    assert np.array_equal(decode(textured, view=View(texture=False)), plain)
    assert np.array_equal(sgmethod.SgFile(textured).pixels(texture=False), plain)
    assert np.abs(decode(textured).astype(int) - plain).mean() > 2  # 4.6 seen
    half = View(0.5, (10, 20, 200, 100))
    without = decode(textured, view=replace(half, texture=False))
    assert np.array_equal(without, decode(file_of(None, some_gaussians()), view=half))


def test_the_same_on_every_instruction_set_and_for_every_number_of_threads(set_threads: Callable[[int], None]) -> None:
    gaussians, seen = some_gaussians(), set()
    for shift, isa, count in product((-1, 0, 2), range(native.best_isa() + 1), (1, 3)):
        set_threads(count)
        texture = native.Texture(varied(), 64.0, 60.0, 3.5, -7.0, shift)
        arrays = gaussians.means, gaussians.factors
        raster = native.Rasterization(*arrays, *SIZE, native.CUTOFF_V2, isa, pyramid=True, texture=texture)
        pixels = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        raster.render_bytes(gaussians.colors, pixels, (0.5, 0.4, 0.3))
        seen.add((shift, pixels.tobytes()))
    assert len(seen) == 3


def test_a_prefix_has_it_too(textured: bytes) -> None:
    part = decode(textured, view=View(prefix=0.4)).astype(int)
    plain = decode(textured, view=View(prefix=0.4, texture=False)).astype(int)
    whole = decode(textured).astype(int) - decode(textured, view=View(texture=False))
    inside = (part > 0) & (part < 255) & (plain > 60) & (plain < 195)
    assert np.abs((part - plain) - whole)[inside].max() <= 1


# --- the encoder


def levels_of(source: NDArray[np.float64]) -> Pixels:
    """A picture [H, W], or in colour, in 8 bits [H, W, 3]."""
    pixels = np.clip(np.round(source), 0, 255).astype(np.uint8)
    return np.repeat(pixels[:, :, None], 3, 2) if pixels.ndim == 2 else pixels


def estimated(source: NDArray[np.float64]) -> Codes | None:
    """For a picture of which the Gaussians draw no detail."""
    pixels = levels_of(source)
    with UNLIMITED:
        return estimate(pixels, cv2.GaussianBlur(pixels, (0, 0), 6))


def noise(spread: float, size: tuple[int, int] = SIZE) -> NDArray[np.float64]:
    return np.random.default_rng(3).normal(0, spread, size[::-1])


def drawn_spread(spread: float) -> float:
    """What noise of this spread comes back with."""
    codes = estimated(128 + noise(spread))
    assert codes is not None
    return float(decode(file_of(codes))[:, :, 0].std())


def test_noise_is_given_back_by_its_strength() -> None:
    for spread in (2.0, 3.0, 6.0, 20.0):
        assert drawn_spread(spread) == pytest.approx(spread, rel=0.2)
    level, loud = (estimate(levels_of(128 + noise(n)), levels_of(128 + noise(0))) for n in (1, 40))
    assert level is not None and loud is not None
    assert 0.7 < STRENGTHS[int(np.median(level[0]))] * SHOWN[0] < 1.2
    assert STRENGTHS[int(loud.max())] * min(SHOWN) < 1.3 * MAX_LEVELS  # else it is all that is seen
    faint = estimated(STRAIGHT + noise(0.8))  # sky without it has bands
    assert faint is not None
    assert 0.3 < STRENGTHS[int(np.median(faint[0]))] < 0.8


def lettering() -> NDArray[np.float64]:
    image = Image.new("L", SIZE, 255)
    for row in range(0, HEIGHT, 14):
        ImageDraw.Draw(image).text((4, row), "The quick brown fox jumps over the lazy dog. " * 2, fill=0)
    return np.asarray(image, float)


def drawing() -> NDArray[np.float64]:
    image = Image.new("L", SIZE, 230)
    draw = ImageDraw.Draw(image)
    for k in range(12):
        draw.line((20 * k, 0, 300 - 9 * k, 200), fill=20 * k, width=1 + k % 3)
    draw.ellipse((60, 40, 150, 120), fill=90)
    return np.asarray(image, float)


def after_jpeg(picture: NDArray[np.float64], ink: float, paper: float) -> NDArray[np.float64]:
    """A picture of 0 and 255, and what lies between, on another ground."""
    file = io.BytesIO()
    Image.fromarray(np.round(ink + picture * (paper - ink) / 255).astype(np.uint8)).save(file, "JPEG", quality=75)
    return np.asarray(Image.open(file), float)


STRAIGHT = np.linspace(20, 220, WIDTH) + np.zeros((HEIGHT, 1))
DRAWINGS = {
    "flat": np.full((HEIGHT, WIDTH), 77.0),
    "gradient": STRAIGHT,
    "lettering": lettering(),
    "drawing": drawing(),
    "lettering in JPEG": after_jpeg(lettering(), 0, 255),
    "light lettering in JPEG": after_jpeg(lettering(), 220, 40),
    "drawing in JPEG": after_jpeg(drawing(), 0, 255),
    "pixel": np.full((1, 1), 9.0),
}


@pytest.mark.parametrize("picture", DRAWINGS.values(), ids=DRAWINGS)
def test_drawings_get_none_and_hide_no_grain(picture: NDArray[np.float64]) -> None:
    assert estimated(picture) is None
    assert not hidden_of(picture).any()


def test_it_ends_where_the_noise_ends() -> None:
    """Meadow below, sky above: the cells of the sky have none."""
    picture = STRAIGHT.copy()
    picture[128:] += noise(15)[128:]
    codes = estimated(picture)
    assert codes is not None
    assert codes[:, :2].max() == 0
    assert codes[0, 2:].min() >= 6


# --- grain, which the fit does not see


def hidden_of(picture: NDArray[np.float64], left: float = 1.0) -> NDArray[np.float64]:
    """Levels of 8 bits [H, W, 3] that are hidden of a picture [H, W], or in colour, of which the fit leaves a part."""
    pixels = levels_of(picture)
    missing = left * (pixels - cv2.GaussianBlur(pixels, (0, 0), 6).astype(np.float32)).transpose(2, 0, 1) / 255
    found = grain(pixels, lambda first, end: missing[:, first:end])
    assert found.shape == missing.shape
    return np.asarray(found.transpose(1, 2, 0) / (native.TARGET_WHITE / 255))


def detail_of(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    half = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(picture - cv2.resize(half, picture.shape[::-1], interpolation=cv2.INTER_LINEAR))


def test_grain_is_hidden_where_the_fit_leaves_it() -> None:
    picture = 128 + noise(12)
    hidden = hidden_of(picture)[:, :, 0]
    assert np.corrcoef(hidden.ravel(), detail_of(picture).ravel())[0, 1] > 0.97
    assert 0.9 < hidden.std() / detail_of(picture).std() < 1.05
    assert not hidden_of(picture, left=0.5).any()
    assert not hidden_of(128 + noise(2)).any()  # too faint


def test_what_stands_out_of_the_grain_stays() -> None:
    """A dark stem in the grass."""
    picture = 128 + noise(8)
    picture[:, 150:153] = 20
    stem, grass = (np.s_[8:-8, 150:153], np.s_[8:-8, 60:120])
    parts = [hidden_of(picture)[where][..., 0].std() / detail_of(picture)[where].std() for where in (stem, grass)]
    assert parts[0] < 0.35 and parts[1] > 0.9


@pytest.mark.parametrize("size", [(1, 1), (1, 200), (130, 1), (65, 67), (64, 64)])
def test_grain_of_pictures_of_any_size(size: tuple[int, int]) -> None:
    assert np.abs(hidden_of(128 + noise(20, size))).max() < 128


def test_colour_loses_grain_like_grey() -> None:
    picture = np.stack([128 + noise(12), 90 + 0.5 * noise(12), np.full((HEIGHT, WIDTH), 40.0)], 2)
    red, green, blue = hidden_of(picture).transpose(2, 0, 1)
    assert red.std() > 5
    assert green == pytest.approx(0.5 * red, abs=1.0)
    assert not blue.any()


def test_few_dots_are_left_on_a_lawn() -> None:
    """Tuned for PSNR, the brightest grains become dots; for the eye they do not."""
    slope = np.linspace(50, 150, 192) + np.zeros((192, 1))  # or it would be nothing but noise
    lawn = slope + 20 * np.random.default_rng(5).standard_t(4, slope.shape)
    pixels = np.repeat(np.clip(lawn, 0, 255).astype(np.uint8)[:, :, None], 3, 2)

    def dots(tune: str) -> int:
        drawn = decode(sgmethod.encode(pixels, bpp=0.2, tune=tune).data, view=View(texture=False))
        return int((np.abs(detail_of(drawn[:, :, 0].astype(float))) > 15).sum())

    assert dots("visual") < 0.1 * dots("psnr")


def test_tuning_for_the_eye_writes_it_within_the_budget() -> None:
    pixels = photo("kodim05-crop")
    for size in (300, 900):
        encoded = sgmethod.encode(pixels, bytes=size, tune="visual")
        assert encoded.stats.bytes == len(encoded.data) <= size
        fields = sgmethod.info(encoded.data)
        assert 0 < fields.bits["texture"] <= 8 * TEXTURE_SHARE * size
        smooth = decode(encoded.data, view=View(texture=False))
        assert psnr(smooth, pixels) > psnr(decode(encoded.data), pixels) == encoded.stats.psnr


def test_tuning_for_psnr_writes_none() -> None:
    for budget in (Budget("bytes", 900), Budget("psnr", 18)):
        fields = sgmethod.info(sgmethod.encode(photo("kodim05-crop"), budget, tune="psnr").data)
        assert (fields.bits["texture"], fields.to_dict()["texture"]) == (0, False)


def test_what_cannot_be_is_refused() -> None:
    codes = varied()
    for wrong in (codes[:1], codes + 200):
        with pytest.raises(ValueError, match=r"code|strength"):
            native.Texture(np.ascontiguousarray(wrong), 64.0, 64.0)
    for cell in (0.0, -3.0, np.nan, np.inf, 1e12):
        with pytest.raises(ValueError, match="cells"):
            native.Texture(codes, 64.0, cell)
    with pytest.raises(ValueError, match="pyramid"):
        native.Rasterization(
            *(np.zeros((1, n), np.float32) for n in (2, 3)), 9, 9, texture=native.Texture(codes, 64.0, 64.0)
        )


def test_files_are_compared_without_their_texture() -> None:
    data = golden_path("v2-texture.sg").read_bytes()
    stream, smooth = container.parse(data), decode(data, view=View(texture=False))
    assert isinstance(stream, StreamV2)
    assert psnr(decode(data), smooth) < EXACT_DB
    objective = Objective.from_pixels(smooth, "visual")
    assert Coded(stream, objective).psnr == EXACT_DB


@pytest.mark.parametrize("octave", [0, 1])
def test_the_strength_of_noise_is_found_again(octave: int) -> None:
    size = (512, 512)
    pixels = decode(file_of(codes_of(9 * (octave == 0), 9 * (octave == 1), size), grey=True, size=size))
    with UNLIMITED:
        found = estimate(pixels, np.full_like(pixels, 128))
    assert found is not None and (found[octave] == 9).all()


@pytest.mark.parametrize("thin", [1, BLOCK - 1, BLOCK])
def test_strips_thinner_than_a_block_get_none(thin: int) -> None:
    """A long one would be padded to many times its size."""
    for size in ((thin, 100), (100, thin)):
        objective = Objective.from_pixels(np.zeros((*size, 3), np.uint8), "visual")
        target = objective.moving_target(np.zeros((3, *size), np.int16), 1, 0)
        assert (objective.replaces_grain, target.hides) == (thin == BLOCK, thin != BLOCK)


@pytest.mark.parametrize(("options", "has_texture"), [({}, True), ({"tune": "fidelity"}, False)])
def test_texture_can_be_left_out_of_a_file(options: dict[str, Any], has_texture: bool) -> None:
    grass = np.random.default_rng(0).normal(100, 25, (96, 96, 1)).clip(0, 255).astype(np.uint8).repeat(3, 2)
    file = encode(grass, bpp=0.3, effort=2, **options).data
    assert np.array_equal(decode(file), decode(file, view=View(texture=False))) != has_texture
