"""Files to pixels: levels, views, thin pictures, hostile overlap, limits."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sgmethod
from sgmethod import BitstreamError, ViewError, decode, info
from sgmethod.bitstream.container import parse, serialise
from sgmethod.metrics import psnr
from sgmethod.paper.stream import PROFILE_CODES, Group, PaperStream
from sgmethod.view import View
from tests.support.data import golden

GOLDEN = golden(1)


def wide(n: int, width: int, height: int, *, scale_px: float, positions: tuple[float, float] = (0, 1)) -> bytes:
    """A file of n Gaussians of one scale; positions is the range of both coordinates, in pixels."""
    rng = np.random.default_rng(0)
    codes, factors = rng.integers(0, 4096, (n, 2), np.uint16), rng.integers(0, 64, (n, 3), np.uint16)
    group = Group(6, codes, factors, rng.integers(0, 8, (n, 2), np.uint8))
    factor_range = np.array([[scale_px] * 2, [-scale_px, scale_px], [scale_px] * 2], np.float32)
    codebooks = rng.normal(0, 1, (2, 8, 3)).astype(np.float16)
    return serialise(
        PaperStream(
            "paper", width, height, 12, np.array([positions] * 2, np.float32), factor_range, codebooks, (group,)
        )
    )


def test_levels_are_computed_in_double_and_rounded_once() -> None:
    stream = parse(GOLDEN["v1-every-bitwidth"])
    gaussians = stream.dequantised()
    at = 0
    for group in stream.groups:
        for k, (codes, bits, low, high) in enumerate(
            [(group.positions[:, i], stream.position_bits, *stream.position_range[i]) for i in range(2)]
            + [(group.factors[:, i], group.bitwidth, *stream.factor_range[i]) for i in range(3)]
        ):
            found = np.concatenate([gaussians.means, gaussians.factors], 1)[at : at + len(codes), k]
            for code, value in zip(codes.tolist(), found, strict=True):
                step = (float(high) - float(low)) / (2**bits - 1)
                assert value == np.float32(float(low) + code * step)
        at += len(group.positions)
    assert at == len(gaussians) == stream.gaussians


@pytest.mark.parametrize("size", [(1, 1), (1, 4096), (4096, 1), (65_535, 1), (1, 65_535)])
def test_thin_pictures(size: tuple[int, int]) -> None:
    pixels = decode(wide(1, *size, scale_px=40.0, positions=(0.5, 0.5)))
    assert pixels.shape == (size[1], size[0], 3)
    assert not pixels[-200:, -200:].any() or max(size) < 200  # the Gaussian is at the other end


def test_info() -> None:
    for data in GOLDEN.values():
        stream, fields = parse(data), info(data).to_dict()
        json.dumps(fields, allow_nan=False)
        assert fields["bytes"] == len(data)
        assert fields["bpp"] == 8 * len(data) / (stream.width * stream.height)
        assert fields["version"] == data[1] - 0xC0 == 1
        assert fields["checksum"] == data[-4:].hex()
        assert PROFILE_CODES[str(fields["profile"])] == data[2]
        for field in ("width", "height", "position_bits", "gaussians"):
            assert fields[field] == getattr(stream, field)
        bits = info(data).bits
        assert list(bits) == ["headers", "positions", "covariances", "colors"]
        assert sum(bits.values()) == 8 * len(data)
        assert fields["groups"] == [{"bitwidth": g.bitwidth, "gaussians": len(g.positions)} for g in stream.groups]


def test_the_limit_of_pixels() -> None:
    data = wide(1, 100, 50, scale_px=9.0)
    assert decode(data, max_pixels=5000).shape == (50, 100, 3)
    with pytest.raises(BitstreamError, match="limit of 4999"):
        decode(data, max_pixels=4999)
    huge = wide(1, 65_535, 65_535, scale_px=9.0)
    with pytest.raises(BitstreamError, match="65535 x 65535 pixels"):
        decode(huge)
    assert info(huge).width == 65_535


HOSTILE = {
    "every Gaussian covers 100 megapixels": wide(40_000, 10_000, 10_000, scale_px=1e5),
    "every Gaussian spans all columns, and is seen in few": wide(
        60_000, 65_535, 1_525, scale_px=1e6, positions=(-3.2e6, -3.1e6)
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_overlap_is_refused_before_it_costs(name: str, tmp_path: Path) -> None:
    """In a process of its own, whose memory tells: refusing takes less than the picture's 300 MB by far."""
    path = tmp_path / "hostile.sg"
    path.write_bytes(HOSTILE[name])
    script = (
        "import re, sys, time, sgmethod\n"
        "peak = lambda: int(re.search(r'VmHWM:\\s*(\\d+) kB', open('/proc/self/status').read())[1]) // 1024\n"
        "data, before, began = open(sys.argv[1], 'rb').read(), peak(), time.process_time()\n"
        "try:\n"
        "    sgmethod.decode(data)\n"
        "except sgmethod.BitstreamError as error:\n"
        "    print(peak() - before, time.process_time() - began, error)\n"
    )
    run = subprocess.run([sys.executable, "-c", script, path], capture_output=True, text=True, check=True, timeout=60)
    megabytes, cpu_s, why = run.stdout.split(maxsplit=2)
    assert "overlap" in why
    assert int(megabytes) < 60
    assert float(cpu_s) < 2


@pytest.mark.parametrize("name", sorted(GOLDEN))
def test_there_are_views_but_no_prefix(name: str) -> None:
    data = GOLDEN[name]
    whole = decode(data).astype(int)
    height, width = whole.shape[:2]
    part = decode(data, view=View(region=(1, 2, width - 2, height - 3)))
    assert np.abs(part - whole[2 : height - 1, 1 : width - 1]).max() <= 1
    assert decode(data, view=View(2.0)).shape == (2 * height, 2 * width, 3)
    with pytest.raises(ViewError, match="prefix"):
        decode(data, view=View(prefix=0.5))


def test_gaussians_are_the_nearest_of_the_shape_of_profile_rd() -> None:
    """Drawn as they are here, they make nearly the file's picture."""
    file = sgmethod.open(GOLDEN["v1-paper"])
    data = sgmethod.pack(file.gaussians(), *file.size, quantum=0.01, background=file.background)
    assert psnr(sgmethod.decode(data), file.pixels()) > 38  # seen: 38.29
