"""Damaged and hostile files: BitstreamError, or pixels of the size that the header says; nothing else.

Two times 10,000 mutations of golden streams in a run, always the same ones. Few would get past the
checksum, so most of them get the one that fits.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sgmethod import BitstreamError, decode, info
from sgmethod.bitstream.container import serialise
from sgmethod.bitstream.v1 import Group, StreamV1
from tests.harness.data import golden, with_checksum

MAX_PIXELS = 1 << 18  # a header can claim 4 gigapixels
MAX_CPU_S = 2.0  # 0.03 s is the worst seen on one of two cores


GOLDEN = list(golden(1).values())
FIELDS = [(2, 1), (3, 2), (5, 2), (7, 1), (8, 1)]  # offset and size of the header's fields
TABLES_AT, CODEBOOKS_AT, GROUPS_AT = 9, 49, 145
FLOATS = [
    struct.pack(">f", value)
    for value in (0, -0.0, 1e-45, 1e-38, 1e-20, -1.0, 65_536, 1e9, -1e9, 1e19, 2e38, -2e38, 3.4e38, -3.4e38)
] + [bytes.fromhex(text) for text in ("7f800000", "ff800000", "7fc00000", "ffffffff")]
HALVES = [bytes.fromhex(text) for text in ("0000", "0001", "7bff", "fbff", "7c00", "fc00", "7e00")]

places = st.floats(0, 1, exclude_max=True)
numbers = st.integers(0, 2**32 - 1)


def put(data: bytes, at: int, value: bytes) -> bytes:
    return data[:at] + value + data[at + len(value) :]


def flip(data: bytes, place: float, _: int) -> bytes:
    at = int(place * 8 * len(data))
    return put(data, at // 8, bytes([data[at // 8] ^ 128 >> at % 8])) if data else data


def overwrite(data: bytes, place: float, number: int) -> bytes:
    return put(data, int(place * len(data)), struct.pack(">I", number)[: 1 + number % 4])


def cut(data: bytes, place: float, _: int) -> bytes:
    return data[: int(place * (len(data) + 1))]


def remove(data: bytes, place: float, number: int) -> bytes:
    at = int(place * len(data))
    return data[:at] + data[at + 1 + number % 16 :]


def insert(data: bytes, place: float, number: int) -> bytes:
    at = int(place * (len(data) + 1))
    return data[:at] + struct.pack(">I", number) * (1 + number % 3) + data[at:]


def duplicate(data: bytes, place: float, number: int) -> bytes:
    at = int(place * len(data))
    return data[:at] + data[at : at + 1 + number % 64] * (2 + number % 3) + data[at:]


def header_field(data: bytes, place: float, number: int) -> bytes:
    """A field of the header at an end of its range or of its bytes, or anywhere."""
    at, size = FIELDS[int(place * len(FIELDS))]
    values = [0, 1, 2, 16, 17, 2 ** (8 * size) - 1, 2 ** (8 * size - 1), number % 2 ** (8 * size)]
    return put(data, at, (values[number % len(values)] % 2 ** (8 * size)).to_bytes(size, "big"))


def picture_size(data: bytes, place: float, number: int) -> bytes:
    """Another width or height, so that all else still fits it or is too much for it."""
    sides = [1, 7, 16, 17, 64, 65, 300, 4096, 65_535, 1 + number % 65_535]
    return put(data, 3 + 2 * int(place * 2), sides[number % len(sides)].to_bytes(2, "big"))


def table_value(data: bytes, place: float, number: int) -> bytes:
    """A value of the tables that is huge, tiny, zero or none."""
    if number % 4:
        return put(data, TABLES_AT + 4 * int(place * 10), FLOATS[number // 4 % len(FLOATS)])
    return put(data, CODEBOOKS_AT + 2 * int(place * 48), HALVES[number // 4 % len(HALVES)])


def group_field(data: bytes, place: float, number: int) -> bytes:
    """A bitwidth, or a number of Gaussians, of one of the groups."""
    at = GROUPS_AT + 4 * int(place * 16)
    if number % 2:
        return put(data, at, bytes([number // 2 % 18]))
    counts = [0, 1, 63, 64, 65, 2**16, 2**24 - 1, number // 2 % 2**24]
    return put(data, at + 1, counts[number // 2 % len(counts)].to_bytes(3, "big"))


Mutator = Callable[[bytes, float, int], bytes]
DAMAGE: list[Mutator] = [overwrite, cut, remove, insert, duplicate, header_field, group_field]
CONTENTS: list[Mutator] = [flip, picture_size, table_value, table_value]


def crowded() -> bytes:
    """Enough Gaussians for larger ones to overlap beyond the limit."""
    rng = np.random.default_rng(0)
    n = 3000
    positions, factors = rng.integers(0, 4096, (n, 2)), rng.integers(0, 256, (n, 3))
    group = Group(
        8, positions.astype(np.uint16), factors.astype(np.uint16), rng.integers(0, 8, (n, 2)).astype(np.uint8)
    )
    ranges = np.array([[0, 500], [0, 200], [1, 5], [-3, 3], [1, 5]], np.float32)
    codebooks = rng.normal(0, 0.2, (2, 8, 3)).astype(np.float16)
    return serialise(StreamV1("paper", 500, 200, 12, ranges[:2], ranges[2:], codebooks, (group,)))


def outcome(data: bytes) -> str:
    """What becomes of the bytes, in a word: why they are refused, or that they are drawn."""
    began = time.process_time()
    try:
        pixels = decode(data, max_pixels=MAX_PIXELS)
    except BitstreamError as error:
        found = "overlap" if "overlap" in str(error) else "limit" if "limit" in str(error) else "refused"
    else:
        width, height = struct.unpack_from(">HH", data, 3)
        assert pixels.shape == (height, width, 3)
        assert pixels.dtype == np.uint8
        assert info(data).bytes == len(data)
        found = "drawn"
    assert time.process_time() - began < MAX_CPU_S
    return found


def explore(seeds: list[bytes], mutators: list[Mutator], fits: st.SearchStrategy[bool]) -> Counter[tuple[bool, str]]:
    """Run mutations of one to three steps; what became of them, by whether the checksum was made to fit."""
    seen: Counter[tuple[bool, str]] = Counter()
    steps = st.lists(st.tuples(st.sampled_from(mutators), places, numbers), min_size=1, max_size=3)

    @given(st.sampled_from(seeds), steps, fits)
    def mutate(data: bytes, steps: list[tuple[Mutator, float, int]], fits: bool) -> None:
        for mutator, place, number in steps:
            data = mutator(data, place, number)
        seen[fits, outcome(with_checksum(data) if fits else data)] += 1

    mutate()
    assert seen.total() >= settings().max_examples
    return seen


@pytest.mark.thorough
def test_mutations_of_golden_streams() -> None:
    """Any damage; half of the files get the checksum that fits them."""
    seen = explore(GOLDEN, [*DAMAGE, *CONTENTS], st.booleans())
    assert seen[True, "drawn"] > settings().max_examples / 50
    assert seen[True, "refused"] > settings().max_examples / 5
    assert seen[True, "limit"] > 0


@pytest.mark.thorough
def test_mutations_of_contents() -> None:
    """Files of the right length whose values are hostile, so that most are drawn."""
    seen = explore([*GOLDEN, crowded()], CONTENTS, st.just(True))
    assert seen[True, "drawn"] > settings().max_examples / 5
    assert seen[True, "overlap"] > 0
