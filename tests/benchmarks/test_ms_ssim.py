"""MS-SSIM against numbers of the package pytorch-msssim 1.0.0: ms_ssim(x, y, data_range=255) in float64.

The package rounds its window's weights to float32: with its weights the two agree to 2e-14, with exact ones to 4e-7 on
the pictures here and 2e-6 on noisy photographs, the worst seen.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.ms_ssim import MS_SSIM_SIDE, ms_ssim
from tests.metrics.test_metrics import disturbed, picture

AGREEMENT = 2e-6


@pytest.mark.parametrize(
    ("height", "width", "strength", "expected"),
    [
        (192, 256, 20, 0.978675725),
        (192, 256, 120, 0.810118029),
        (161, 161, 40, 0.894900216),  # the smallest, and odd at every scale
        (203, 331, 40, 0.949299314),
        (330, 171, 5, 0.998592977),
    ],
)
def test_ms_ssim_agrees_with_the_published_package(height: int, width: int, strength: int, expected: float) -> None:
    a = picture(height, width)
    b = disturbed(a, strength)
    assert ms_ssim(a, b) == pytest.approx(expected, abs=AGREEMENT)
    assert ms_ssim(b, a) == pytest.approx(expected, abs=AGREEMENT)
    for kind in (np.float64, np.float32):
        assert ms_ssim((a / 255).astype(kind), (b / 255).astype(kind)) == pytest.approx(expected, abs=AGREEMENT)


def test_ms_ssim_at_its_ends() -> None:
    waves = picture(200, 180)
    for pixels in (waves, np.zeros((161, 170, 3), np.uint8), np.full((161, 170, 3), 255, np.uint8)):
        assert ms_ssim(pixels, pixels) == pytest.approx(1, abs=1e-6)
    assert ms_ssim(waves, 255 - waves) == 0.0  # and not nan
    assert MS_SSIM_SIDE == 161
    for shape in ((160, 400), (400, 160), (1, 4096)):
        assert ms_ssim(picture(*shape), picture(*shape)) is None


def test_other_pairs_are_refused() -> None:
    pixels = picture(161, 170)
    with pytest.raises(ValueError, match="one shape and type"):
        ms_ssim(pixels, pixels / 255)
    with pytest.raises(ValueError, match="H, W, C"):
        ms_ssim(pixels[..., 0], pixels[..., 0])
