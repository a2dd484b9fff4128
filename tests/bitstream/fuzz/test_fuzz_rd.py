"""Damaged and hostile files of profile rd, versions 3 to 5: BitstreamError, or pixels of the size that the header
says; nothing else.

A changed bit changes all that follows in an entropy-coded payload, so one mutation explores more than in version 1. The
versions share the mutations.
"""

from __future__ import annotations

import struct
import time
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sgmethod import BitstreamError, decode, info
from sgmethod.bitstream import container
from sgmethod.bitstream.v4 import FLAG_ALPHA
from sgmethod.bitstream.v5 import StreamV5
from sgmethod.scene import Gaussians
from sgmethod.view import View
from tests.bitstream import plain_decoder_v5
from tests.bitstream.fuzz.test_fuzz_v1 import Mutator, cut, duplicate, flip, insert, overwrite, put, remove
from tests.harness.data import NEW, golden, golden_path, with_checksum

MAX_PIXELS = 1 << 18  # a header can claim 4 gigapixels
VERSIONS = (b"SGM\3", b"SGM\4", NEW)
MAX_CPU_S = 2.0  # 0.14 s is the worst seen


GOLDEN = [*golden(3).values(), *golden(4).values(), *golden(5).values()]

places = st.floats(0, 1, exclude_max=True)
numbers = st.integers(0, 2**32 - 1)


def picture_size(data: bytes, place: float, number: int) -> bytes:
    """Another width or height: the grids of cells change, and with them all that is decoded."""
    sides = [0, 1, 2, 7, 16, 65, 300, 4096, 65_530, 65_535, 1 + number % 65_535]
    return put(data, 9 + 2 * int(place * 2), sides[number % len(sides)].to_bytes(2, "big"))


def header_field(data: bytes, place: float, number: int) -> bytes:
    """Flags, quantum or background."""
    at, values = [
        (8, [bytes([v]) for v in (0, 1, 2, 3, 4, 8, 12, 255)]),
        (13, [v.to_bytes(2, "big") for v in (0, 1, 255, 256, 3584, 3839, 3840, 65_535, number % 65_536)]),
        (15, [b"\0\0\0", b"\xff\xff\xff"]),
    ][int(place * 3)]
    return put(data, at, values[number % len(values)])


def version(data: bytes, place: float, _: int) -> bytes:
    """The same payload by the rules of either version."""
    return put(data, 3, b"\3" if place < 0.5 else b"\4")


def payload(data: bytes, place: float, number: int) -> bytes:
    """From some place on: all ones, all zeros, or noise; sometimes much of it."""
    at = 18 + int(place * max(len(data) - 18, 1))
    length = [0, 1, 8, 64, 500, 2000, 10_000][number % 7]
    fill = [b"\0" * length, b"\xff" * length, np.random.default_rng(number).bytes(length), b"\x55" * length]
    return data[:at] + fill[number // 7 % 4]


def start_of_payload(data: bytes, place: float, number: int) -> bytes:
    """The first bytes decide the number of the largest Gaussians."""
    return put(data, 18 + int(place * 6), struct.pack(">I", number)[: 1 + number % 4])


MUTATORS: list[Mutator] = [
    *[flip, overwrite, cut, remove, insert, duplicate],
    *[picture_size, header_field, version, payload, payload, start_of_payload],
]


def crowded() -> bytes:
    """Thousands of Gaussians that cost a bit each: what follows a change can be many more."""
    n = 3000
    rng = np.random.default_rng(0)
    means, factors = rng.uniform(0, 200, (n, 2)), np.tile((1.0, 0.0, 1.0), (n, 1))
    gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, np.full((n, 3), 0.5))))
    return container.serialise(StreamV5.of(gaussians, (200, 200), 1.5, (10, 20, 30), True))


def huge() -> bytes:
    """As many wide Gaussians as the picture's tiles can bear."""
    n = 500
    rng = np.random.default_rng(0)
    means, factors = rng.uniform(0, 150, (n, 2)), np.tile((500.0, 9.0, 700.0), (n, 1))
    gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, rng.normal(0, 0.1, (n, 3)))))
    return container.serialise(StreamV5.of(gaussians, (150, 150), 1.0, (10, 20, 30), False))


def needles() -> bytes:
    """Three times as large, more than the tiles can bear: too narrow for a coarser level, however long they are."""
    n, side = 4000, 170
    means, factors = np.full((n, 2), side / 2), np.tile((600.0, 600.0, 0.3), (n, 1))
    gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, np.full((n, 3), 0.01))))
    return container.serialise(StreamV5.of(gaussians, (side, side), 0.5, (10, 20, 30), True))


# The same in version 3: without a pyramid, they are more than the tiles can bear three times as large.
HUGE_V3 = golden_path("v3-large/wide.sg").read_bytes()
SEEDS = [*GOLDEN, crowded(), HUGE_V3, huge()]


def header_of(data: bytes) -> tuple[tuple[int, int], bool]:
    """The picture's size, and whether it has alpha."""
    if data.startswith(NEW):
        header = plain_decoder_v5.read(data).header
        return (header.width, header.height), header.alpha
    width, height = struct.unpack_from(">HH", data, 9)
    return (width, height), data[3] == 4 and bool(data[8] & FLAG_ALPHA)


def outcome(data: bytes, view: View) -> str:
    """What becomes of the bytes, in a word: why they are refused, or that they are drawn."""
    began = time.process_time()
    try:
        pixels = decode(data, MAX_PIXELS, view)
    except BitstreamError as error:
        found = next(
            (word for word in ("overlap", "limit", "checksum", "than the data") if word in str(error)), "other"
        )
    else:
        size, with_alpha = header_of(data)
        assert pixels.shape == (*view.size(*size)[::-1], 4 if with_alpha else 3)
        assert pixels.dtype == np.uint8
        if view.prefix == 1:
            fields = info(data).to_dict()
            assert fields["bytes"] == len(data)
            assert fields["gaussians"] <= (1 + with_alpha) * min(size[0] * size[1], 8 * len(data))  # type: ignore[operator]
        found = "drawn"
    assert time.process_time() - began < MAX_CPU_S
    return found


def explore(seeds: list[bytes], views: st.SearchStrategy[View], fits: st.SearchStrategy[bool]) -> Counter[str]:
    """Run mutations of one to three steps; what became of those whose checksum was made to fit."""
    seen: Counter[str] = Counter()
    steps = st.lists(st.tuples(st.sampled_from(MUTATORS), places, numbers), min_size=1, max_size=3)

    @given(st.sampled_from(seeds), steps, views, fits)
    def mutate(data: bytes, steps: list[tuple[Mutator, float, int]], view: View, fits: bool) -> None:
        for mutator, place, number in steps:
            data = mutator(data, place, number)
        if data.startswith(VERSIONS):
            seen[outcome(with_checksum(data) if fits else data, view)] += 1

    mutate()
    return seen


@pytest.mark.thorough
def test_mutations() -> None:
    """Half of the files, or nearly, get the checksum that fits them."""
    seen = explore(SEEDS, st.just(View()), st.sampled_from([True, True, False, True, False]))
    assert seen["drawn"] > settings().max_examples / 50
    assert seen["checksum"] > settings().max_examples / 5
    assert min(seen["limit"], seen["than the data"], seen["other"]) > 0


@pytest.mark.thorough
def test_mutations_seen_in_part() -> None:
    """A prefix ends in the midst of anything, and what is hostile is drawn at other sizes."""
    scales = st.sampled_from([1 / 64, 0.3, 1.0, 3.0])
    views = st.builds(
        lambda scale, prefix: View(scale, None, prefix), scales, st.sampled_from([1.0, 0.9, 0.5, 0.1, 1e-3])
    )
    seen = explore([*SEEDS, needles()], views, st.just(True))
    assert seen["drawn"] > settings().max_examples / 5
    assert min(seen["limit"], seen["overlap"], seen["other"]) > 0


@given(
    st.sampled_from(VERSIONS[:2]),
    st.binary(max_size=400),
    numbers,
    st.sampled_from([0, 1, 2, 3, 4]),
    st.sampled_from([0, 256, 1024, 3839]),
)
def test_any_payload(begin: bytes, payload: bytes, number: int, flags: int, quantum: int) -> None:
    size = struct.pack(">HH", 1 + number % 500, 1 + number // 500 % 500)
    body = bytes([flags]) + size + struct.pack(">H", quantum) + b"\1\2\3" + payload
    outcome(with_checksum(begin + bytes(4) + body), View(prefix=0.5 if number % 3 == 0 else 1.0))


@given(st.integers(0, 255), st.integers(0, 8), st.integers(0, 8), st.binary(max_size=400), st.sampled_from([1.0, 0.5]))
def test_any_file_of_version_5(first: int, wide: int, high: int, rest: bytes, prefix: float) -> None:
    """Of any flags, and of sizes that can be drawn."""
    begin = first << 16 | (wide & 14) << 15 | high << 9
    outcome(with_checksum(NEW + begin.to_bytes(3, "big") + rest + bytes(4)), View(prefix=prefix))


def test_needles_overlap_in_a_pyramid_too() -> None:
    assert outcome(needles(), View()) == "drawn"
    assert outcome(needles(), View(3.0)) == "overlap"
