"""Golden streams: python tests/make_golden.py [NAME ...] writes tests/data/NAME.sg and the picture it decodes to.

They pin version 1 of the format and the decoder's pixels, so they are made anew only when the format gets another
version or a stream cannot show something that it should. An encoder that has changed is no reason.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from sgmethod import Budget, decode, encode
from sgmethod.bitstream import Group, Stream, serialise
from sgmethod.files import encode_png, write_atomically
from sgmethod.image import read_image

DATA = Path(__file__).parent / "data"


def photograph(profile: str) -> bytes:
    """A small part of a photograph, upright, in some 60 Gaussians."""
    pixels = read_image((DATA / "kodim23-crop.png").read_bytes())[:56, :40]
    return encode(np.ascontiguousarray(pixels), Budget("bytes", 600), profile).data


def every_bitwidth() -> bytes:
    """What no photograph has: all bitwidths, the ends of all codes, a range that runs backwards, negative l1,
    Gaussians far outside and far larger than the picture."""
    rng = np.random.default_rng(1)
    groups = []
    for bitwidth in range(1, 17):
        positions = rng.integers(0, 2**9, (4, 2))
        factors = rng.integers(0, 2**bitwidth, (4, 3))
        positions[:2], factors[:2] = [[0, 2**9 - 1], [2**9 - 1, 0]], [[2**bitwidth - 1] * 3, [0] * 3]
        colors = rng.integers(0, 8, (4, 2))
        groups.append(Group(bitwidth, positions.astype(np.uint16), factors.astype(np.uint16), colors.astype(np.uint8)))
    return serialise(
        Stream(
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
    return serialise(Stream("paper", 7, 5, 12, *nothing, ()))


GOLDEN = {
    "v1-paper": lambda: photograph("paper"),
    "v1-baseline": lambda: photograph("baseline"),
    "v1-every-bitwidth": every_bitwidth,
    "v1-empty": empty,
}


def main(names: list[str]) -> None:
    for name in names or GOLDEN:
        data = GOLDEN[name]()
        write_atomically(DATA / f"{name}.sg", data)
        write_atomically(DATA / f"{name}.png", encode_png(decode(data)))


if __name__ == "__main__":
    main(sys.argv[1:])
