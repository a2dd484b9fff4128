"""A second decoder, written from docs/paper-format.md alone: plain Python, slow, sharing nothing with sgmethod.

Each function follows one section of that text, in its order. What docs/format.md has too comes from its decoder.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

from tests.bitstream.plain_decoder_v2 import Gaussian, body_of, refuse_unless, round32


def parse(data: bytes) -> tuple[int, int, list[Gaussian]]:
    """Width, height and the Gaussians."""
    refuse_unless(len(data) >= 13, "too short")
    body = body_of(data, 1)
    refuse_unless(len(body) == len(data) - 6, "checksum")  # not the short one
    profile, width, height, position_bits, group_count = struct.unpack_from(">BHHBB", body)
    refuse_unless(profile <= 1, "profile")
    refuse_unless(width > 0 and height > 0, "size")
    refuse_unless(1 <= position_bits <= 16, "position_bits")
    refuse_unless(group_count <= 16, "groups")
    if group_count == 0:
        refuse_unless(len(body) == 7, "length")
        return width, height, []
    records_at = 143 + 4 * group_count
    refuse_unless(len(body) >= records_at, "length")
    tables = struct.unpack_from(">4f6f48e", body, 7)
    refuse_unless(all(math.isfinite(value) for value in tables), "tables")
    groups = [(body[at], int.from_bytes(body[at + 1 : at + 4], "big")) for at in range(143, records_at, 4)]
    refuse_unless(all(1 <= bitwidth <= 16 and n >= 1 for bitwidth, n in groups), "group list")
    refuse_unless(sum(n for _, n in groups) <= width * height, "more Gaussians than pixels")
    records = body[records_at:]
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
