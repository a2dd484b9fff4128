"""A second decoder, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

Each function follows one section of that text, in its order.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

CUTOFF = 5.5

Gaussian = tuple[float, float, float, float, float, tuple[float, ...]]  # x, y, l1, l2, l3, colour
Region = tuple[int, int, int, int]  # x, y of the corner, width, height


class RefusedError(Exception):
    """The bytes are not a whole, intact file."""


def decode(data: bytes) -> tuple[int, int, bytes]:
    """Width, height and the samples: height rows of width pixels of red, green and blue."""
    width, height, gaussians = parse(data)
    samples = bytearray()
    for r in range(height):
        for c in range(width):
            samples += bytes(to_byte(value) for value in pixel(gaussians, r, c))
    return width, height, bytes(samples)


def refuse_unless(condition: bool, why: str) -> None:
    if not condition:
        raise RefusedError(why)


def parse(data: bytes) -> tuple[int, int, list[Gaussian]]:
    """Width, height and the Gaussians."""
    refuse_unless(len(data) >= 15, "too short")
    refuse_unless(data[0:3] == b"SGM", "magic")
    refuse_unless(data[3] == 1, "version")
    refuse_unless(struct.unpack_from(">I", data, 4)[0] == zlib.crc32(data[8:]), "checksum")
    profile, width, height, position_bits, group_count = struct.unpack_from(">BHHBB", data, 8)
    refuse_unless(profile <= 1, "profile")
    refuse_unless(width > 0 and height > 0, "size")
    refuse_unless(1 <= position_bits <= 16, "position_bits")
    refuse_unless(group_count <= 16, "groups")
    if group_count == 0:
        refuse_unless(len(data) == 15, "length")
        return width, height, []
    refuse_unless(len(data) >= 151 + 4 * group_count, "length")
    tables = struct.unpack_from(">4f6f48e", data, 15)
    refuse_unless(all(math.isfinite(value) for value in tables), "tables")
    groups = [(data[at], int.from_bytes(data[at + 1 : at + 4], "big")) for at in range(151, 151 + 4 * group_count, 4)]
    refuse_unless(all(1 <= bitwidth <= 16 and n >= 1 for bitwidth, n in groups), "group list")
    refuse_unless(sum(n for _, n in groups) <= width * height, "more Gaussians than pixels")
    records = data[151 + 4 * group_count :]
    bits = sum(n * (2 * position_bits + 3 * bitwidth + 6) for bitwidth, n in groups)
    refuse_unless(len(records) == (bits + 7) // 8, "length")
    gaussians = list(read_records(records, position_bits, groups, tables))
    padding = int.from_bytes(records, "big") & ((1 << (8 * len(records) - bits)) - 1)
    refuse_unless(padding == 0, "padding")
    return width, height, gaussians


def read_records(
    records: bytes, position_bits: int, groups: list[tuple[int, int]], tables: tuple[float, ...]
) -> Iterator[Gaussian]:
    string, at = "".join(format(byte, "08b") for byte in records), 0
    ranges = [(tables[i], tables[i + 1]) for i in range(0, 10, 2)]
    entries = [tables[i : i + 3] for i in range(10, 58, 3)]
    for bitwidth, n in groups:
        for _ in range(n):
            codes = []
            for bits in (position_bits, position_bits, bitwidth, bitwidth, bitwidth, 3, 3):
                codes.append(int(string[at : at + bits], 2))
                at += bits
            x, y = (level(codes[i], position_bits, *ranges[i]) for i in (0, 1))
            l1, l2, l3 = (level(codes[i], bitwidth, *ranges[i]) for i in (2, 3, 4))
            color = tuple(round32(a + b) for a, b in zip(entries[codes[5]], entries[8 + codes[6]], strict=True))
            yield x, y, l1, l2, l3, color


def level(code: int, bits: int, low: float, high: float) -> float:
    return round32(low + code * ((high - low) / (2**bits - 1)))


def round32(value: float) -> float:
    rounded: float = struct.unpack(">f", struct.pack(">f", value))[0]
    return rounded


def pixel(gaussians: list[Gaussian], r: int, c: int) -> list[float]:
    """The exact values of one pixel."""
    values = [0.0, 0.0, 0.0]
    for x, y, l1, l2, l3, color in gaussians:
        if l1 <= 0 or l3 <= 0:
            continue
        z1 = (c + 0.5 - x) / l1
        z2 = (r + 0.5 - y - l2 * z1) / l3
        sigma = (z1 * z1 + z2 * z2) / 2
        if sigma < CUTOFF:
            weight = math.exp(-sigma) - math.exp(-CUTOFF)
            for channel in range(3):
                values[channel] += color[channel] * weight
    return values


def to_byte(value: float) -> int:
    return math.floor(255 * min(max(value, 0.0), 1.0) + 0.5)


def view_size(region: Region, scale: float) -> tuple[int, int]:
    """Width and height of a view."""
    return max(round(region[2] * scale), 1), max(round(region[3] * scale), 1)


def resized(
    gaussians: list[Gaussian], region: Region, scale: float, cutoff: float, origin: tuple[int, int] = (0, 0)
) -> list[Gaussian]:
    """Gaussians in a view's pixels, with the region's corner at the origin."""
    left, top, w, h = region
    width, height = view_size(region, scale)
    sx, sy = width / w, height / h
    floor = math.exp(-cutoff)
    k = (1 - floor * (1 + cutoff + cutoff**2 / 2)) / (1 - floor * (1 + cutoff))
    vx, vy = max(1 - sx * sx, 0) / (12 * k), max(1 - sy * sy, 0) / (12 * k)
    shown = []
    for x, y, l1, l2, l3, color in gaussians:
        if l1 <= 0 or l3 <= 0:
            continue
        a, b, d = sx * l1, sy * l2, sy * l3
        n1 = math.sqrt(a * a + vx)
        n3 = math.sqrt(d * d + vy + (b / n1) ** 2 * vx)
        place = round32((x - left) * sx + origin[0]), round32((y - top) * sy + origin[1])
        less = tuple(round32(value * (a * d) / (n1 * n3)) for value in color)
        shown.append((*place, round32(n1), round32(a * (b / n1)), round32(n3), less))
    return shown
