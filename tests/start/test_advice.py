"""Advice on pictures that Gaussians do not suit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw
from skimage import data

import sgmethod
from sgmethod.errors import ImageError
from sgmethod.io.pictures import encode_picture
from sgmethod.start import advice as module
from sgmethod.start.advice import advice, is_drawn


def page() -> np.ndarray:
    """Lines of text, black on white."""
    picture = Image.new("RGB", (240, 160), "white")
    for y in range(8, 150, 14):
        ImageDraw.Draw(picture).text((8, y), "Words of a page, in lines: 0123456789", "black")
    return np.asarray(picture)


@pytest.mark.parametrize(
    "name", ["astronaut", "coffee", "chelsea", "rocket", "brick", "grass", "retina", "camera", "moon"]
)
def test_a_photograph_gets_no_advice(name: str) -> None:
    pixels = getattr(data, name)()
    pixels = np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels
    assert not is_drawn(pixels)
    assert advice(pixels, 10**9, 0.0) is None


def test_a_page_of_text_gets_the_better_file(monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_drawn(page())
    assert "lossless WebP takes" in (advice(page(), 10**6, 30.0) or "")
    with_alpha = np.dstack([page(), np.full((160, 240), 255, np.uint8)])
    assert "lossless WebP" in (advice(with_alpha, 10**6, 30.0) or "")
    assert advice(with_alpha, 20, 30.0) is None

    def large_webp(pixels: np.ndarray, kind: str, options: dict[str, Any]) -> bytes:
        return bytes(10**6) if kind == "WebP" else encode_picture(pixels, kind, options)

    monkeypatch.setattr(module, "encode_picture", large_webp)
    assert ": AVIF has " in (advice(page(), 5000, 10.0) or "")
    assert advice(page(), 5000, 60.0) is None  # ours is better
    assert advice(page(), 20, 10.0) is None  # there is none so small


def test_no_advice_without_the_encoders(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> bytes:
        raise ImageError("this Pillow cannot write WebP")

    monkeypatch.setattr(module, "encode_picture", none)
    assert advice(page(), 10**6, 30.0) is None


def test_the_figures_have_the_advice() -> None:
    assert sgmethod.encode(page(), bpp=1, effort=1, time_limit_s=0.2).stats.advice
