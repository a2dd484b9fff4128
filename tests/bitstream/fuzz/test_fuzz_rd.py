"""Damaged and hostile files of version 2: BitstreamError, or pixels of the size that the header says; nothing else.

A changed bit changes all that follows in an entropy-coded payload, so one mutation explores more than in version 1.
"""

from __future__ import annotations

import struct
import time
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sgmethod import BitstreamError, decode, info
from sgmethod.bitstream import container
from sgmethod.bitstream.fields import write_bits
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.v2 import BACKGROUND, FLAGS, QUANTUM, SIZE, StreamV2
from sgmethod.scene import Gaussians
from sgmethod.view import View
from tests.bitstream import plain_decoder_v2
from tests.bitstream.fuzz.test_fuzz_v1 import Mutator, cut, duplicate, flip, insert, overwrite, put, remove
from tests.harness.data import golden, with_checksum

MAX_PIXELS = 1 << 18  # a header can claim 4 gigapixels
SIGNATURE = b"\xd3\xc2"
MAX_CPU_S = 2.0  # 0.14 s is the worst seen


GOLDEN = [*golden(2).values()]

places = st.floats(0, 1, exclude_max=True)
numbers = st.integers(0, 2**32 - 1)


SIDES = [1, 2, 7, 16, 65, 300, 4096, 65_530, 65_535]


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
    changed = replace(stream, **changes[int(place * len(changes))], texture=None)
    return container.serialise(changed)


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


MUTATORS: list[Mutator] = [
    *[flip, overwrite, cut, remove, insert, duplicate],
    *[rewritten, rewritten, flags, payload, payload, start_of_payload],
]


def crowded() -> bytes:
    """Thousands of Gaussians that cost a bit each: what follows a change can be many more."""
    n = 3000
    rng = np.random.default_rng(0)
    means, factors = rng.uniform(0, 200, (n, 2)), np.tile((1.0, 0.0, 1.0), (n, 1))
    gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, np.full((n, 3), 0.5))))
    return container.serialise(StreamV2.of(gaussians, (200, 200), 1.5, (10, 20, 30), True))


def huge() -> bytes:
    """As many wide Gaussians as the picture's tiles can bear."""
    n = 500
    rng = np.random.default_rng(0)
    means, factors = rng.uniform(0, 150, (n, 2)), np.tile((500.0, 9.0, 700.0), (n, 1))
    gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, rng.normal(0, 0.1, (n, 3)))))
    return container.serialise(StreamV2.of(gaussians, (150, 150), 1.0, (10, 20, 30), False))


def needles() -> bytes:
    """Needles, too narrow for a coarser level: three times as large, they are more than the tiles can bear."""
    n, side = 4000, 170
    means, factors = np.full((n, 2), side / 2), np.tile((600.0, 600.0, 0.3), (n, 1))
    gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, np.full((n, 3), 0.01))))
    return container.serialise(StreamV2.of(gaussians, (side, side), 0.5, (10, 20, 30), True))


SEEDS = [*GOLDEN, crowded(), huge()]


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
        file = plain_decoder_v2.read(data)
        size, with_alpha = (file.header.width, file.header.height), file.alpha is not None
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
        if data.startswith(SIGNATURE):
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
    st.binary(max_size=400),
    numbers,
    st.integers(0, 31).map(lambda flags: flags & 19),  # neither texture nor alpha
    st.sampled_from([0, 255, 1024, 3328, 4095]),
)
def test_any_payload(payload: bytes, number: int, flags: int, quantum: int) -> None:
    fields = [(FLAGS, flags), *zip(SIZE, (1 + number % 500, 1 + number // 500 % 500), strict=True)]
    is_short = flags > 15
    fields += [(QUANTUM, QUANTUM.value(quantum >> 4) if is_short else quantum)]
    fields += [(field, 0) for field in BACKGROUND[: 1 if flags & 1 else 3]]
    data = SIGNATURE + write_bits(fields, is_short) + payload + bytes(4)
    outcome(with_checksum(data), View(prefix=0.5 if number % 3 == 0 else 1.0))


@given(st.integers(0, 255), st.integers(0, 8), st.integers(0, 8), st.binary(max_size=400), st.sampled_from([1.0, 0.5]))
def test_any_file(first: int, wide: int, high: int, rest: bytes, prefix: float) -> None:
    """Any flags, and sizes that can be drawn."""
    begin = first << 16 | (wide & 14) << 15 | high << 9
    outcome(with_checksum(SIGNATURE + begin.to_bytes(3, "big") + rest + bytes(4)), View(prefix=prefix))


def test_needles_overlap_in_a_pyramid_too() -> None:
    assert outcome(needles(), View()) == "drawn"
    assert outcome(needles(), View(3.0)) == "overlap"
