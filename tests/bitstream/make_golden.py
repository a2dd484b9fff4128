"""Golden files of both versions: python -m tests.bitstream.make_golden [NAME ...]

Writes tests/data/v1/*.sg with the pictures that they decode to, and tests/data/v2/*.sg with the hashes of both in
hashes.json.

They pin the versions of the format and the decoder's pixels, so they are made anew only when the format gets another
version or a stream cannot show something that it should. An encoder that has changed is no reason.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from sgmethod import Budget, decode, encode
from sgmethod.bitstream import container
from sgmethod.bitstream.container import serialise
from sgmethod.bitstream.texture import cells
from sgmethod.bitstream.v1 import Group, StreamV1
from sgmethod.bitstream.v2 import StreamV2, coded_background
from sgmethod.io.files import write_atomically
from sgmethod.io.png import encode_png
from sgmethod.native import native
from sgmethod.scene import Gaussians
from tests.backend.cases import single
from tests.harness.data import golden_path
from tests.harness.pictures import photo

FloatArray = NDArray[np.float64]
Size = tuple[int, int]
HASHES = golden_path("v2-hashes.json")


def photograph(profile: str) -> bytes:
    """A small part of a photograph, upright, in some 60 Gaussians."""
    return encode(photo()[:56, :40], Budget("bytes", 600), profile).data


def every_bitwidth() -> bytes:
    """What no photograph has: all bitwidths, the ends of all codes, a range that runs backwards, negative l1,
    Gaussians far outside and far larger than the picture."""
    rng = np.random.default_rng(1)
    groups = []
    for bitwidth in range(1, 17):
        positions, factors = rng.integers(0, 2**9, (4, 2)), rng.integers(0, 2**bitwidth, (4, 3))
        positions[:2], factors[:2] = [[0, 2**9 - 1], [2**9 - 1, 0]], [[2**bitwidth - 1] * 3, [0] * 3]
        colors = rng.integers(0, 8, (4, 2))
        groups.append(Group(bitwidth, positions.astype(np.uint16), factors.astype(np.uint16), colors.astype(np.uint8)))
    return serialise(
        StreamV1(
            profile="baseline",
            width=33,
            height=70,
            position_bits=9,
            position_range=np.array([[-6, 40], [75, -5]], np.float32),
            factor_range=np.array([[-0.5, 30], [-6, 6], [0.1, 12]], np.float32),
            codebooks=rng.normal(0.05, 0.2, (2, 8, 3)).astype(np.float16),
            groups=tuple(groups),
        )
    )


def empty() -> bytes:
    """No Gaussians: black."""
    nothing = np.zeros((2, 2), np.float32), np.zeros((3, 2), np.float32), np.zeros((2, 8, 3), np.float16)
    return serialise(StreamV1("paper", 7, 5, 12, *nothing, ()))


def rd_photograph(budget: Budget, *, grey: bool = False) -> bytes:
    """A small part of a photograph in profile rd."""
    pixels = photo()[20:60, 30:78]
    return encode(pixels[..., 1] if grey else pixels, budget, "rd", tune="psnr").data


def rd_scattered(size: Size, n: int, *, upright: bool = False, is_short: bool = False) -> bytes:
    """What no photograph has: every class of size, needles, colours beyond white, Gaussians far outside, some in one
    place."""
    rng = np.random.default_rng(n)
    means = rng.uniform(-0.5, 1.5, (n, 2)) * size
    means[: n // 6] = means[:1]
    means[n // 6 : n // 5] *= 1e6
    aspect = rng.normal(0, 1, n)
    factors = np.exp(np.linspace(-2, 10, n)[:, None] + np.stack([aspect, rng.normal(0, 1.5, n), -aspect], 1))
    factors[:, 1] *= 0 if upright else rng.choice([-1, 1], n)
    colors = rng.normal(0.1, 0.5, (n, 3)) / np.sqrt(factors[:, :1])
    return rd_coded(single(means, factors, colors), size, 0.05, is_short=is_short)


def rd_levels() -> bytes:
    """Ellipses from a pixel to wider than the picture, some around it."""
    size = (83, 70)
    return rd_coded(ellipses(48, size, 2, (0.7, 150), 5, margin=0.1), size, 0.02)


def rd_busy() -> bytes:
    """Far more Gaussians than the other files have, of all sizes that photographs have."""
    size = (200, 120)
    return rd_coded(ellipses(700, size, 9, (0.5, 12), 6), size, 0.05)


def rd_needles() -> bytes:
    """Needles at 45 degrees and near it, up to 800 times as long as wide, in the finest of files."""
    rng = np.random.default_rng(3)
    n, size = 12, (48, 40)
    minor, aspect = np.linspace(0.35, 0.6, n), np.geomspace(60, 800, n)
    angle = np.pi / 4 * rng.choice([-1, 1, 0.9, -1.1], n)
    angle[-1] = np.pi / 4
    needles = single(rng.uniform(0.2, 0.8, (n, 2)) * size, slanted(minor, aspect, angle), colors_of(n))
    return rd_coded(needles, size, 0.0)


def rd_texture(size: Size, n: int, *, grey: bool = False, is_short: bool = False) -> bytes:
    """Texture of every strength, over some Gaussians or none."""
    codes = np.arange(native.TEXTURE_OCTAVES * np.prod(cells(*size))).reshape(-1, *cells(*size)) % 16
    if n == 0:
        codes[1:] = 0
    background = coded_background((120, 120, 120), is_short)
    stream = StreamV2.of(ellipses(n, size, 6, (0.8, 40), 4), size, 0.02, background, grey, is_short=is_short)
    return serialise(replace(stream, texture=codes.astype(np.uint8)))


def rd_alpha(data: bytes, n: int) -> bytes:
    """A picture with alpha of n Gaussians that leave what decoding clamps; of none, the same everywhere."""
    picture = container.parse(data)
    assert isinstance(picture, StreamV2)
    size = picture.width, picture.height
    rng = np.random.default_rng(8)
    minor, aspect, angle = np.geomspace(0.8, 20, n), rng.uniform(1, 5, n), rng.uniform(0, np.pi, n)
    colors = np.repeat(rng.normal(0.5, 1, (n, 1)), 3, axis=1)
    gaussians = single(rng.uniform(0, 1, (n, 2)) * size, slanted(minor, aspect, angle), colors)
    background = coded_background((100, 100, 100), picture.is_short)
    alpha = StreamV2.of(gaussians, size, 0.04, background, grey=True, is_short=picture.is_short)
    return serialise(replace(picture, alpha=replace(alpha, upright=False)))


def ellipses(
    n: int, size: Size, seed: int, minor_px: tuple[float, float], most_aspect: float, margin: float = 0.0
) -> Gaussians:
    """Ellipses in all directions, with minor axes in a range. margin: how far around the picture, in parts of it."""
    rng = np.random.default_rng(seed)
    factors = slanted(np.geomspace(*minor_px, n), rng.uniform(1, most_aspect, n), rng.uniform(0, np.pi, n))
    return single(rng.uniform(-margin, 1 + margin, (n, 2)) * size, factors, colors_of(n) / 4)


def colors_of(n: int) -> FloatArray:
    return np.random.default_rng(4).normal(0, 0.25, (n, 3))


def slanted(minor: FloatArray, aspect: FloatArray, angle: FloatArray) -> FloatArray:
    """Factors [n, 3] of ellipses with a minor axis in pixels, and an angle of the major one in radians."""
    across, along = minor**2, (minor * aspect) ** 2
    xx = along * np.cos(angle) ** 2 + across * np.sin(angle) ** 2
    xy = (along - across) * np.cos(angle) * np.sin(angle)
    l1 = np.sqrt(xx)
    return np.stack([l1, xy / l1, minor**2 * aspect / l1], 1)


def rd_coded(gaussians: Gaussians, size: Size, quantum: float, *, is_short: bool = False) -> bytes:
    background = coded_background((120, 90, 60), is_short)
    return serialise(StreamV2.of(gaussians, size, quantum, background, grey=False, is_short=is_short))


GOLDEN: dict[str, Callable[[], bytes]] = {
    "v1-paper": lambda: photograph("paper"),
    "v1-baseline": lambda: serialise(replace(cast(StreamV1, container.parse(photograph("paper"))), profile="baseline")),
    "v1-every-bitwidth": every_bitwidth,
    "v1-empty": empty,
    "v2-color": lambda: rd_photograph(Budget("bytes", 300)),
    "v2-grey": lambda: rd_photograph(Budget("bytes", 300), grey=True),
    "v2-long": lambda: rd_photograph(Budget("bytes", 2000)),
    "v2-every-class": lambda: rd_scattered((41, 27), 150),
    "v2-upright": lambda: rd_scattered((30, 44), 60, upright=True),
    "v2-levels": rd_levels,
    "v2-needles": rd_needles,
    "v2-busy": rd_busy,
    "v2-texture": lambda: rd_texture((66, 200), 20),
    "v2-texture-alone": lambda: rd_texture((70, 9), 0, grey=True),
    "v2-alpha": lambda: rd_alpha(rd_texture((70, 41), 9), 15),
    "v2-short-alpha": lambda: rd_alpha(rd_texture((70, 41), 9, is_short=True), 15),
    "v2-empty": lambda: rd_scattered((7, 5), 0, is_short=True),
    "v2-pixel": lambda: rd_alpha(rd_scattered((1, 1), 1), 0),
}


def main(names: list[str]) -> None:
    hashes = json.loads(HASHES.read_text()) if HASHES.exists() else {}
    for name in names or GOLDEN:
        data = GOLDEN[name]()
        write_atomically(golden_path(f"{name}.sg"), data)
        if name.startswith("v1"):
            write_atomically(golden_path(f"{name}.png"), encode_png(decode(data)))
        else:
            parts = {"bytes": data, "pixels": decode(data).tobytes()}
            hashes[name] = {part: hashlib.sha256(content).hexdigest() for part, content in parts.items()}
    write_atomically(HASHES, (json.dumps(hashes, indent=2) + "\n").encode())


if __name__ == "__main__":
    main(sys.argv[1:])
