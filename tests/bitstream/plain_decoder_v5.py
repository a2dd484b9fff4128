"""A second decoder of version 5, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

What is the same in version 4 comes from its decoder.
"""

from __future__ import annotations

import functools
import zlib

from tests.bitstream.plain_decoder import Region, refuse_unless
from tests.bitstream.plain_decoder_v4 import NUMBERS, File, Gaussian, Header, decoded, read_texture, viewed, word


class Bits:
    """The bits of a header, the most significant of a byte first."""

    def __init__(self, data: bytes) -> None:
        self.bits = "".join(f"{byte:08b}" for byte in data)
        self.at = 0

    def take(self, count: int) -> int:
        refuse_unless(self.at + count <= len(self.bits), "header")
        self.at += count
        return int("0" + self.bits[self.at - count : self.at], 2)

    def grown(self, count: int) -> int:
        """2^n plus n bits; n comes first."""
        n = self.take(count)
        return 2**n + self.take(n)

    def upper(self, bits: int, short_bits: int, is_short: bool) -> int:
        """A field, of which a short file has the upper bits."""
        if not is_short:
            return self.take(bits)
        value = self.take(short_bits)
        missing = bits - short_bits
        return value * 2**missing + value // 2 ** (short_bits - missing)

    def end(self) -> int:
        """In bytes."""
        refuse_unless(self.take(-self.at % 8) == 0, "padding")
        return self.at // 8


def read(data: bytes) -> File:
    refuse_unless(len(data) >= 7, "too short")
    refuse_unless(data[:2] == b"\xd3\xc5", "signature")
    is_short = data[2] >= 128
    end = len(data) - (1 if is_short else 4)
    checksum = zlib.crc32(data[:end])
    refuse_unless(int.from_bytes(data[end:], "big") == (checksum % 256 if is_short else checksum), "checksum")
    bits = Bits(data[2:end])
    flags = bits.take(5)
    grey, upright, has_texture, has_alpha = (bool(flags // 2**k % 2) for k in range(4))
    width, height = bits.grown(4), bits.grown(4)
    quantum = quantum_of(bits.upper(12, 8, is_short))
    levels = [bits.upper(8, 5, is_short) for _ in range(1 if grey else 3)]
    background = (levels[0], levels[-2 if len(levels) > 1 else 0], levels[-1])
    header = Header(grey, upright, width, height, quantum, background, NUMBERS, has_texture, has_alpha)
    alpha = None
    if has_alpha:
        quantum = quantum_of(bits.upper(12, 8, is_short))
        level = bits.upper(8, 5, is_short)
        alpha = Header(True, False, width, height, quantum, (level, level, level), NUMBERS), bits.grown(5) - 1
    codes, rest = read_texture(header, data[2 + bits.end() : end])
    states = 1 if is_short else 2
    if alpha is None:
        return File(header, codes, None, rest, states, banded)
    size = alpha[1]
    refuse_unless(len(rest) >= size, "alpha")
    return File(header, codes, (alpha[0], rest[:size]), rest[size:], states, banded)


def quantum_of(code: int) -> float:
    return (1 + code % 256 / 256) * 2.0 ** (3 - code // 256)


@functools.cache
def white(i: int, j: int) -> int:
    return word(0, i % 256, j % 256) - 128


@functools.cache
def detail(i: int, j: int, weights: tuple[int, ...]) -> int:
    """White noise less its mean around a place, times the sum of all weights."""
    reach = len(weights) // 2
    mean = sum(
        down * along * white(i + x - reach, j + y - reach)
        for y, down in enumerate(weights)
        for x, along in enumerate(weights)
    )
    return sum(weights) ** 2 * white(i, j) - mean


@functools.cache
def banded(octave: int, i: int, j: int) -> float:
    """Noise, where a strength is 1."""
    if octave == 1:
        return ((detail(i % 256, j % 256, (1, 2, 1)) + 16) // 32) / 29.7
    smooth = sum(
        down * along * detail((i + x - 1) % 256, (j + y - 1) % 256, (1, 4, 6, 4, 1))
        for y, down in enumerate((1, 6, 1))
        for x, along in enumerate((1, 6, 1))
    )
    return ((smooth + 8192) // 16384) / 34.1


def parse(data: bytes) -> tuple[Header, list[Gaussian]]:
    """The header and the Gaussians."""
    file = read(data)
    return file.header, file.gaussians()


def decode(data: bytes) -> tuple[int, int, bytes]:
    """Width, height and the samples: height rows of width pixels of red, green and blue, and alpha if there is any."""
    return decoded(read(data))


def view(data: bytes, scale: float, region: Region | None = None) -> tuple[int, int, bytes]:
    """Width, height and samples of a view."""
    return viewed(read(data), scale, region)
