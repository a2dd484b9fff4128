"""What the native renderer bears, and what it refuses; tests/drawing has what it draws."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from sgmethod.native import native
from tests.backend.cases import SIZE, scattered

ABSURD = """
import itertools, numpy as np
from sgmethod.native import native
sizes = (1e-38, 1e-30, 1e-18, 1e-9, 1.0, 1e9, 1e18, 1e19, 1e20, 1e30, 3e38)
ends = (-3e38, -1e20, -1e9, 8.0, 1e9, 1e20, 3e38)
geometry = itertools.chain(
    itertools.product((8.0,), (8.0,), sizes, (*(-s for s in sizes), 0.0, *sizes), sizes),
    itertools.product(ends, ends, (1.0, 1e20), (0.0, 1e20), (1.0, 1e20)),
)
image, out = np.empty((3, 70, 40), np.float32), [np.empty((1, k), np.float32) for k in (2, 3, 3)]
color = np.ones((1, 3), np.float32)
for (x, y, l1, l2, l3), pyramid in itertools.product(geometry, (False, True)):
    mean, factor = np.float32([[x, y]]), np.float32([[l1, l2, l3]])
    raster = native.Rasterization(mean, factor, 40, 70, max_pairs=100, pyramid=pyramid)
    raster.render(color, image)
    assert np.isfinite(image).all() and image.min() >= 0, (x, y, l1, l2, l3)
    assert image.max() <= (1.03 if pyramid else 1), (x, y, l1, l2, l3)
    raster.backward(color, image, *out)
"""


def test_absurd_but_finite_geometry_does_no_harm() -> None:
    done = subprocess.run([sys.executable, "-c", ABSURD], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_too_many_pairs_are_refused() -> None:
    means, factors, _ = scattered(80, 0).arrays
    with pytest.raises(OverflowError, match="too many pairs"):
        native.Rasterization(means, factors, *SIZE, max_pairs=len(means))


def test_other_shapes_and_types_are_refused() -> None:
    means, factors, colors = torch.ones(4, 2), torch.ones(4, 3), torch.ones(4, 3)
    picture = torch.empty(3, 70, 40)
    for arguments in ((means[:3], factors, 40, 70), (means, factors[:3], 40, 70), (means, factors, 0, 70)):
        with pytest.raises(ValueError, match=r"differ in number|must have pixels"):
            native.Rasterization(*arguments)
    for arguments in ((factors, factors, 40, 70), (means, means, 40, 70), (means[0], factors, 40, 70)):
        with pytest.raises(TypeError):
            native.Rasterization(*arguments)
    with pytest.raises(ValueError, match="instruction set"):
        native.Rasterization(means, factors, 40, 70, isa=native.best_isa() + 1)
    raster = native.Rasterization(means, factors, 40, 70)
    for call, arguments in (
        (raster.render, (colors[:3], picture)),
        (raster.render, (colors, torch.empty(3, 69, 40))),
        (raster.render_bytes, (colors, torch.empty(70, 41, 3, dtype=torch.uint8))),
        (raster.backward, (colors, picture, means[:3], factors, colors)),
        (raster.backward, (colors, torch.empty(3, 70, 39), means, factors, colors)),
        (raster.squared_error, (colors, np.empty((3, 70, 39), np.int16), means, factors, colors)),
    ):
        with pytest.raises(ValueError, match=r"one colour|one row|another size"):
            call(*arguments)
    for call, arguments in (
        (raster.render, (colors, picture[:1])),
        (raster.render, (colors, picture[0])),
        (raster.render_bytes, (colors, torch.empty(70, 40, 4, dtype=torch.uint8))),
        (raster.backward, (colors, picture, factors, factors, colors)),
        # An output that is no contiguous array of the right type would be converted, and the result be lost.
        (raster.render, (colors, torch.zeros(3, 70, 40, dtype=torch.float64))),
        (raster.render, (colors, torch.zeros(3, 70, 80)[:, :, ::2])),
        (raster.render_bytes, (colors, torch.zeros(70, 40, 3, dtype=torch.int32))),
        (raster.backward, (colors, picture, torch.zeros(4, 2).double(), factors, colors)),
        (raster.backward, (colors, picture, torch.zeros(4, 4)[:, ::2], factors, colors)),
    ):
        with pytest.raises(TypeError):
            call(*arguments)
