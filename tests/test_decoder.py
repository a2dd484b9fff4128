"""Bytes to pixels: golden pixels, the same on every instruction set and for every number of threads; limits."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod import BitstreamError, decode, info
from sgmethod.bitstream.container import parse
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.decoder import draw, draw_whole
from sgmethod.native import native
from sgmethod.scene import Gaussians, Scene
from sgmethod.view import View
from tests.native.harness.golden import GOLDEN, is_golden

ISAS = range(native.best_isa() + 1)


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_pixels(name: str) -> None:
    """Their pictures or hashes were written when the files were made."""
    pixels = decode(GOLDEN[name])
    assert pixels.dtype == np.uint8
    assert pixels.flags.c_contiguous
    assert is_golden(name, pixels)


@pytest.mark.parametrize("name", sorted(GOLDEN.keys() - {"v2-busy"}))  # the definition would draw it for seconds
@pytest.mark.parametrize("scale", [0.4, 1.0, 2.3])
def test_pictures_and_views_are_those_of_the_definition(name: str, scale: float) -> None:
    """Without texture, which the test vectors hold. Seen: 1 level, in 1 of 6,720 samples."""
    scene = parse(GOLDEN[name]).scene()
    width, height = scene.width, scene.height
    for region in None, (width // 3, height // 2, (width + 2) // 3, (height + 3) // 4):
        view = View(scale, region, texture=False)
        expected = defined(view.apply(scene))
        found = decode(GOLDEN[name], view=view)
        assert found.shape == expected.shape
        difference = np.abs(found - expected)
        assert difference.max() <= 1
        assert np.mean(difference > 0) < 0.001


def defined(scene: Scene) -> NDArray[np.int64]:
    """Levels [H, W, 3], or [H, W, 4] with alpha."""
    torch = pytest.importorskip("torch", reason="the definition needs PyTorch")
    from tests.definitions import drawing

    size = scene.origin[0] + scene.width, scene.origin[1] + scene.height
    drawn = scene.gaussians.rows((scene.gaussians.factors[:, ::2] > 0).all(1))
    values = [torch.from_numpy(array).double() for array in drawn.arrays]
    draw_exactly = drawing.render_pyramid if scene.pyramid else drawing.render
    picture = draw_exactly(values[0], values[1], values[2], size, scene.cutoff).numpy().transpose(1, 2, 0)
    shown = picture[scene.origin[1] :, scene.origin[0] :] + np.array(scene.background) / 255
    levels = np.floor(255 * shown.clip(0, 1) + 0.5).astype(int)
    return levels if scene.alpha is None else np.dstack([levels, defined(scene.alpha)[..., :1]])


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_what_is_laid_out_while_it_is_decoded_is_the_same(threads: int, set_threads: Callable[[int], None]) -> None:
    set_threads(threads)
    for data in GOLDEN.values():
        stream = parse(data)
        assert np.array_equal(draw_whole(stream), draw(stream.scene()))
    for name in ("v2-color", "v2-texture"):
        stream = parse(GOLDEN[name])
        for prefix in np.linspace(0.01, 0.99, 50).tolist():
            expected = draw(View(texture=False).apply(stream.scene(prefix)))
            assert np.array_equal(draw_whole(stream, prefix, texture=False), expected)


def test_more_gaussians_than_expected_are_laid_out_too() -> None:
    """Equal ones take less than a bit each."""
    n = 2000
    many = Gaussians(*(np.tile(np.float32([row]), (n, 1)) for row in ((20, 20), (3, 0, 3), (0.02, 0.02, 0.02))))
    stream = StreamV2.from_gaussians(many, (64, 64), 0.25, (0, 0, 0), False)
    assert 8 * len(stream.payload) < 9 * n
    assert np.array_equal(draw_whole(stream), draw(stream.scene()))
    assert len(stream.gaussians()) == n


def test_the_limit_of_gaussians() -> None:
    """Those of alpha count too; the message has the limit that was given."""
    data = GOLDEN["v2-alpha"]  # 9, and 15 of alpha
    assert info(data, 24).gaussians == 24
    for most in (23, 8):
        with pytest.raises(BitstreamError, match=f"limit of {most} Gaussians"):
            info(data, most)


def test_coarse_levels_of_a_narrow_picture_take_little_memory() -> None:
    """16 x 1,048,560 pixels take 50 MB, and the coarse levels below one wide Gaussian 120 MB: their rows are as wide as
    their samples."""
    script = (
        "import re, numpy as np\n"
        "from sgmethod.native import native\n"
        "peak = lambda: int(re.search(r'VmHWM:\\s*(\\d+) kB', open('/proc/self/status').read())[1]) // 1024\n"
        "before, pixels = peak(), np.empty((1 << 20, 16, 3), np.uint8)\n"
        "gaussian = np.full((1, 2), 8, np.float32), np.float32([[1e4, 0, 1e4]])\n"
        "raster = native.Rasterization(*gaussian, 16, 1 << 20, native.CUTOFF_V2, pyramid=True)\n"
        "raster.render_bytes(np.ones((1, 3), np.float32), pixels)\n"
        "print(peak() - before)\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert int(run.stdout) < 200  # seen: 155
