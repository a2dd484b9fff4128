"""Damaged and hostile files: BitstreamError, or pixels of the size that the header says; nothing else.

Each gets the checksum that fits it. The mutations know the format; tests/native/sanitize has those that do not. A
changed bit changes all that follows in an entropy-coded payload, so one explores more in version 2 than in version 1.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import sgmethod
from sgmethod import BitstreamError, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.view import View
from tests.backend.cases import single
from tests.support.data import SIGNATURES, damaged, golden, with_checksum

MAX_PIXELS = 1 << 18  # a header can claim 4 gigapixels
MAX_CPU_S = 2.0  # 0.14 s is the worst seen
SIDES = [1, 2, 7, 16, 17, 64, 65, 300, 4096, 65_530, 65_535]

Mutator = Callable[[bytes, float, int], bytes]
places = st.floats(0, 1, exclude_max=True)
numbers = st.integers(0, 2**32 - 1)
WHOLE = st.just(View())


def put(data: bytes, at: int, value: bytes) -> bytes:
    return data[:at] + value + data[at + len(value) :]


def damage(data: bytes, place: float, number: int) -> bytes:
    """Other bytes in one place, and up to four more or fewer at the end."""
    return damaged(data, place, struct.pack(">I", number)[: 1 + number % 4], number % 9 - 4) if len(data) > 8 else data


# --- mutations of version 2


def rewritten(data: bytes, place: float, number: int) -> bytes:
    """Another size, quantum, background or flags: the grids of cells change, and with them all that is decoded."""
    try:
        stream = container.parse(with_checksum(data), Limits(MAX_PIXELS))
    except BitstreamError:
        return data
    assert isinstance(stream, StreamV2)
    quantum = StreamV2.coded_quantum([2.0**-10, 0.01, 1.0, 15.0][number % 4], stream.is_short)
    changes: list[dict[str, Any]] = [
        {"width": SIDES[number % len(SIDES)]},
        {"height": SIDES[number % len(SIDES)]},
        {"width": 1 + number % 600, "height": 1 + number // 600 % 600},
        {"quantum": quantum},
        {"background": (255, 255, 255)},
        {"upright": not stream.upright},
        {"grey": not stream.grey, "background": (0, 0, 0)},
    ]
    return container.serialise(replace(stream, **changes[int(place * len(changes))], texture=None))


def flags(data: bytes, place: float, _: int) -> bytes:
    """Other flags, so that all fields behind them mean something else."""
    return put(data, 2, bytes([int(place * 32) << 3 | data[2] & 7])) if len(data) > 2 else data


def payload(data: bytes, place: float, number: int) -> bytes:
    """From some place on: all ones, all zeros, or noise; sometimes much of it."""
    at = 14 + int(place * max(len(data) - 18, 1))
    length = [0, 1, 8, 64, 500, 2000, 10_000][number % 7]
    fill = [b"\0" * length, b"\xff" * length, np.random.default_rng(number).bytes(length), b"\x55" * length]
    return data[:at] + fill[number // 7 % 4] + bytes(4)


def start_of_payload(data: bytes, place: float, number: int) -> bytes:
    """The first bytes decide the number of the largest Gaussians."""
    return put(data, 9 + int(place * 12), struct.pack(">I", number)[: 1 + number % 4])


VERSION_2: list[Mutator] = [damage, damage, rewritten, flags, payload, start_of_payload]


# --- hostile files


def equal(n: int, side: int, factor: tuple[float, float, float], quantum: float, color: float = 0.5) -> bytes:
    """A square grey picture with n Gaussians of one shape, all over it."""
    means = np.random.default_rng(0).uniform(0, side, (n, 2))
    gaussians = single(means, np.tile(factor, (n, 1)), np.full((n, 3), color))
    return container.serialise(StreamV2.from_gaussians(gaussians, (side, side), quantum, (10, 20, 30), True))


CROWDED = equal(3000, 200, (1, 0, 1), 1.5)  # they cost a bit each: what follows a change can be many more
HUGE = equal(500, 150, (500, 9, 700), 1.0, 0.1)  # as many wide Gaussians as the picture's tiles can bear
# Too narrow for a coarser level: three times as large, they are more than the tiles can bear.
NEEDLES = equal(4000, 170, (600, 600, 0.3), 0.5, 0.01)
WORDS = ("overlap", "limit", "than the data")


def outcome(data: bytes, view: View) -> str:
    """What becomes of the bytes, in a word: why they are refused, or that they are drawn."""
    began = time.process_time()
    try:
        pixels = decode(data, MAX_PIXELS, view)
    except BitstreamError as error:
        found = next((word for word in WORDS if word in str(error)), "other")
    else:
        file = sgmethod.open(data)
        assert pixels.shape == (*view.size(*file.size)[::-1], 4 if file.has_alpha else 3)
        assert pixels.dtype == np.uint8
        if view.prefix == 1:
            assert file.info.bytes == len(data)
            assert file.info.gaussians <= (1 + file.has_alpha) * min(file.size[0] * file.size[1], 3 * len(data) + 64)
        found = "drawn"
    assert time.process_time() - began < MAX_CPU_S
    return found


def explore(seeds: list[bytes], mutators: list[Mutator], views: st.SearchStrategy[View] = WHOLE) -> Counter[str]:
    """What becomes of files after one to three mutations."""
    seen: Counter[str] = Counter()
    steps = st.lists(st.tuples(st.sampled_from(mutators), places, numbers), min_size=1, max_size=3)

    @given(st.sampled_from(seeds), steps, views)
    def mutate(data: bytes, steps: list[tuple[Mutator, float, int]], view: View) -> None:
        for mutator, place, number in steps:
            data = mutator(data, place, number)
        seen[outcome(with_checksum(data), view)] += 1

    mutate()
    return seen


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("seeds", "mutators"),
    [
        ([*golden(1).values()], [damage]),
        ([*golden(2).values(), CROWDED, HUGE], VERSION_2),
    ],
    ids=["v1", "v2"],
)
def test_any_damage(seeds: list[bytes], mutators: list[Mutator]) -> None:
    seen = explore(seeds, mutators)
    assert seen["drawn"] > settings().max_examples / 50
    assert seen["other"] > settings().max_examples / 5


@pytest.mark.thorough
def test_damage_seen_in_part() -> None:
    """A prefix ends in the midst of anything, and what is hostile is drawn at other sizes."""
    scales, prefixes = st.sampled_from([1 / 64, 0.3, 1.0, 3.0]), st.sampled_from([1.0, 0.9, 0.5, 0.1, 1e-3])
    views = st.builds(lambda scale, prefix: View(scale, None, prefix), scales, prefixes)
    needles = [NEEDLES] * 4  # few changes leave them as many as overlap
    seen = explore([*golden(2).values(), CROWDED, HUGE, *needles], VERSION_2, views)
    assert seen["drawn"] > settings().max_examples / 50  # a damaged tail is refused, whatever part is drawn
    assert min(seen["limit"], seen["overlap"], seen["than the data"], seen["other"]) > 0


@given(st.integers(0, 255), st.integers(0, 8), st.integers(0, 8), st.binary(max_size=400), st.sampled_from([1.0, 0.5]))
def test_any_file(first: int, wide: int, high: int, rest: bytes, prefix: float) -> None:
    """Any flags, and sizes that can be drawn."""
    begin = first << 16 | (wide & 14) << 15 | high << 9
    outcome(with_checksum(SIGNATURES[1] + begin.to_bytes(3, "big") + rest + bytes(4)), View(prefix=prefix))


def test_needles_overlap_in_a_pyramid_too() -> None:
    assert outcome(NEEDLES, View()) == "drawn"
    assert outcome(NEEDLES, View(3.0)) == "overlap"
