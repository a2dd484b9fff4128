"""Advice on pictures that Gaussians do not suit."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image
from skimage import data

import sgmethod
from sgmethod.cli.main import main
from sgmethod.errors import ImageError
from sgmethod.io.image import read_image_8_bit
from sgmethod.io.pictures import picture_file
from sgmethod.metrics import advice as module
from sgmethod.metrics.advice import Better, advice, better_file, is_drawn
from tests.support.pictures import page_of_text


def page() -> np.ndarray:
    return read_image_8_bit(page_of_text())


@pytest.mark.parametrize("name", ["astronaut", "coffee", "rocket", "grass", "retina", "moon"])
def test_a_photograph_gets_no_advice(name: str) -> None:
    pixels = getattr(data, name)()
    pixels = np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels
    assert not is_drawn(pixels)
    assert better_file(pixels, 10**9, 0.0) is None


def test_a_page_of_text_gets_the_better_file(monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_drawn(page())
    with_alpha = np.dstack([page(), np.full((160, 240), 255, np.uint8)])
    for pixels in (page(), with_alpha):
        lossless = better_file(pixels, 10**6, 30.0)
        assert lossless is not None
        assert (lossless.kind, lossless.psnr) == ("webp", math.inf)
    assert better_file(with_alpha, 20, 30.0) is None

    def large_webp(pixels: np.ndarray, kind: str, options: dict[str, Any]) -> bytes:
        return bytes(10**6) if kind == "WebP" else picture_file(pixels, kind, options)

    monkeypatch.setattr(module, "picture_file", large_webp)
    for kinds in (("webp", "avif"), ("avif",)):
        avif = better_file(page(), 5000, 10.0, kinds)
        assert avif is not None
        assert avif.kind == "avif"
        assert len(avif.data) <= 5000
    assert better_file(page(), 5000, 10.0, ("webp",)) is None
    assert better_file(page(), 5000, 60.0) is None  # ours is better
    assert better_file(page(), 20, 10.0) is None  # there is none so small


def test_advice_under_a_limit_of_pillow(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels = page()
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 9)
    assert better_file(pixels, 5000, 10.0, ("avif",)) is not None


def test_no_advice_without_the_encoders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "picture_file", Mock(side_effect=ImageError("this Pillow cannot write WebP")))
    assert better_file(page(), 10**6, 30.0) is None


def test_advice_in_words() -> None:
    assert advice(None, 1000, 30.0) == {"advice": None, "better": None}
    lossless = advice(Better("webp", bytes(900), math.inf), 1000, 30.0)
    assert lossless["better"] == "webp"
    assert (lossless["advice"] or "").endswith("line art: lossless WebP takes 900 bytes")
    avif = advice(Better("avif", bytes(990), 35.21), 1000, 28.4)
    assert (avif["advice"] or "").endswith(": AVIF has 35.2 dB in 990 bytes, this file 28.4 dB in 1,000")


def test_only_who_shows_advice_pays_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "page.png").write_bytes(page_of_text())
    line = ["encode", str(tmp_path / "page.png"), "--bpp", "1", "--effort", "1", "--time-limit", "0.2", "--json"]
    assert main(line) == 0
    output = capsys.readouterr()
    assert json.loads(output.out)["better"] == "webp"
    assert "sgmethod: advice: " in output.err
    monkeypatch.setattr(module, "picture_file", lambda *_: pytest.fail("it is never shown"))
    sgmethod.encode(page(), bpp=1, effort=1, time_limit_s=0.2)
    sgmethod.preview(page())
