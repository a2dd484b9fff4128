"""The golden files of version 2: their exact bytes and pixels, and that they show everything that the format has."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from sgmethod import decode
from sgmethod.bitstream.v2 import MIN_QUANTUM
from sgmethod.native import native
from tests.bitstream import plain_decoder_v2
from tests.bitstream.test_format_v2 import GOLDEN, stream_of
from tests.harness.data import golden_path

HASHES = json.loads(golden_path("v2-hashes.json").read_text())


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bytes_and_pixels(name: str) -> None:
    """Exact: tests/bitstream/make_golden.py wrote the hashes when the streams were made."""
    assert hashlib.sha256(GOLDEN[name]).hexdigest() == HASHES[name]["bytes"]
    assert hashlib.sha256(decode(GOLDEN[name]).tobytes()).hexdigest() == HASHES[name]["pixels"]


def levels_of(name: str) -> list[int]:
    factors = stream_of(name).gaussians().factors.astype(np.float64)
    return [plain_decoder_v2.level_of(*factor) for factor in factors]


def test_golden_streams_show_every_kind() -> None:
    assert GOLDEN.keys() == HASHES.keys()
    streams = [stream_of(name) for name in GOLDEN]
    assert {(s.grey, s.upright) for s in streams} == {(False, False), (True, False), (False, True), (True, True)}
    assert {(s.width, s.height, len(s.gaussians())) for s in streams} >= {(7, 5, 0), (1, 1, 1)}
    shown = {(s.is_short, s.texture is not None, s.alpha is not None) for s in streams}
    assert shown >= {(short, more, more) for short in (False, True) for more in (False, True)}
    assert {s.is_short for s in streams if len(s.gaussians()) == 0} == {False, True}


def test_golden_streams_show_every_size() -> None:
    factors = stream_of("v2-every-class").gaussians().factors.astype(np.float64)
    sizes = np.round(np.log2(factors[:, 0] * factors[:, 2]))  # a class is one in log2(s^2)
    assert set(sizes[sizes >= -2]) == set(range(-2, 29))
    assert set(levels_of("v2-every-class")) == set(range(plain_decoder_v2.TOP_LEVEL + 1))
    assert len(set(levels_of("v2-levels"))) > 5
    assert max(levels_of("v2-color")) > 1
    needles = stream_of("v2-needles")
    assert needles.quantum == MIN_QUANTUM
    _, l2, l3 = needles.gaussians().factors.T
    assert np.abs(l2 / l3).max() > 5 * 64  # seen: 400


def test_golden_streams_show_texture_and_alpha() -> None:
    streams = [stream_of(name) for name in GOLDEN]
    codes = [s.texture for s in streams if s.texture is not None]
    assert set(np.concatenate([c.ravel() for c in codes])) == set(range(native.TEXTURE_STRENGTHS))
    assert {bool(c[1].any()) for c in codes} == {False, True}  # the highest level of a picture without Gaussians
    alphas = [s.alpha for s in streams if s.alpha is not None]
    assert {len(alpha.gaussians()) > 0 for alpha in alphas} == {False, True}
    shown = decode(GOLDEN["v2-alpha"])[..., 3]
    assert 0.1 < np.isin(shown, (0, 255)).mean() < 0.9  # what is clamped, and what is not
