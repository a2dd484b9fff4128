"""Damaged and hostile files, for the decoder here, under sanitizers (tests/native/sanitize) and for the fuzzer
(tests/native/fuzz): BitstreamError, or pixels of the size that the header says; nothing else.

Some changes know the format, and some do not. A changed bit changes all that follows in an entropy-coded payload,
so one explores more there than in fields of fixed length.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import sgmethod
from sgmethod import BitstreamError, ViewError, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.view import View
from tests.backend.cases import single
from tests.support.data import golden, with_checksum

MAX_PIXELS = 1 << 18  # a header can claim 4 gigapixels
MAX_CPU_S = 2.0  # 0.14 s is the worst seen
SIDES = [1, 2, 7, 16, 17, 64, 65, 300, 4096, 65_530, 65_535]
NUMBERS = (0, 1, 2, 15, 16, 17, 127, 128, 254, 255)
WORDS = ("overlap", "limit", "than the data")
WHOLE = View()


def equal(n: int, side: int, factor: tuple[float, float, float], quantum: float, color: float = 0.5) -> bytes:
    """A square grey picture with n Gaussians of one shape, all over it."""
    means = np.random.default_rng(0).uniform(0, side, (n, 2))
    gaussians = single(means, np.tile(factor, (n, 1)), np.full((n, 3), color))
    return container.serialise(StreamV2.from_gaussians(gaussians, (side, side), quantum, (10, 20, 30), True))


CROWDED = equal(3000, 200, (1, 0, 1), 1.5)  # they cost a bit each: what follows a change can be many more
HUGE = equal(500, 150, (500, 9, 700), 1.0, 0.1)  # as many wide Gaussians as the picture's tiles can bear
# Too narrow for a coarser level: three times as large, they are more than the tiles can bear.
NEEDLES = equal(4000, 170, (600, 600, 0.3), 0.5, 0.01)
# Few changes leave needles as many as overlap.
CORPUS = [*golden().values(), CROWDED, HUGE, *[NEEDLES] * 4]


def bytes_of_any_kind(data: bytes, rng: random.Random) -> bytes:
    """Change, cut, double or replace bytes; many of them near the beginning, where the headers are."""
    changed = bytearray(data)
    at = rng.randrange(min(len(changed), rng.choice((24, 200, 1 << 30, 1 << 30)))) if changed else 0
    length = rng.choice((1, 1, 2, 4, 16, 300))
    kind = rng.randrange(7)
    if kind == 0:
        changed[at : at + 1] = bytes(byte ^ 1 << rng.randrange(8) for byte in changed[at : at + 1])
    elif kind == 1:
        changed[at : at + length] = rng.randbytes(length)
    elif kind == 2:
        changed[at : at + length] = bytes(rng.choice(NUMBERS) for _ in range(length))
    elif kind == 3:
        del changed[at : at + length]
    elif kind == 4:
        changed[at:at] = changed[at : at + length] * rng.choice((1, 1, 100))
    elif kind == 5:
        del changed[rng.randrange(len(changed) + 1) :]
    else:
        other = rng.choice(CORPUS)
        changed[at:] = other[rng.randrange(len(other)) :]
    return bytes(changed)


def header(data: bytes, rng: random.Random) -> bytes:
    """Another size, quantum, background or flags: the grids of cells change, and with them all that is decoded."""
    try:
        stream = container.parse(with_checksum(data), Limits(MAX_PIXELS))
    except BitstreamError:
        return data
    if not isinstance(stream, StreamV2):
        return data
    changes: list[dict[str, Any]] = [
        {"width": rng.choice(SIDES)},
        {"height": rng.choice(SIDES)},
        {"width": rng.randint(1, 600), "height": rng.randint(1, 600)},
        {"quantum": StreamV2.coded_quantum(rng.choice([2.0**-10, 0.01, 1.0, 15.0]), stream.is_short)},
        {"background": (255, 255, 255)},
        {"upright": not stream.upright},
        {"grey": not stream.grey, "background": (0, 0, 0)},
    ]
    return container.serialise(replace(stream, **rng.choice(changes), texture=None))


def flags(data: bytes, rng: random.Random) -> bytes:
    """Other flags, so that all fields behind them mean something else."""
    return data[:2] + bytes([rng.randrange(32) << 3 | data[2] & 7]) + data[3:] if len(data) > 2 else data


def payload(data: bytes, rng: random.Random) -> bytes:
    """From some place on: all ones, all zeros, or noise; sometimes much of it."""
    at = 14 + rng.randrange(max(len(data) - 18, 1))
    length = rng.choice([0, 1, 8, 64, 500, 2000, 10_000])
    return data[:at] + rng.choice([bytes(length), b"\xff" * length, rng.randbytes(length), b"\x55" * length]) + bytes(4)


def start_of_payload(data: bytes, rng: random.Random) -> bytes:
    """The first bytes decide the number of the largest Gaussians."""
    at, value = 9 + rng.randrange(12), rng.randbytes(rng.randint(1, 4))
    return data[:at] + value + data[at + len(value) :]


Change = Callable[[bytes, random.Random], bytes]
CHANGES: list[Change] = [*[bytes_of_any_kind] * 2, header, flags, payload, start_of_payload]


def mutated(rng: random.Random) -> bytes:
    """A file after one to three changes, nearly always with the checksum that fits it."""
    data = rng.choice(CORPUS)
    for _ in range(rng.randint(1, 3)):
        data = rng.choice(CHANGES)(data, rng)
    return with_checksum(data) if rng.random() < 0.9 else data


def any_view(rng: random.Random) -> View:
    """A prefix ends in the midst of anything, and what is hostile is drawn at other sizes."""
    region = rng.choice((None, None, (1, 2, 5, 4)))
    return View(
        rng.choice((1.0, 1.0, 3.0, 3.0, 0.3, 1 / 64)), region, rng.choice((1.0, 1.0, 0.5, rng.uniform(0.01, 1)))
    )


def outcome(data: bytes, view: View, max_cpu_s: float = MAX_CPU_S) -> str:
    """What becomes of the bytes, in a word: why they are refused, or that they are drawn."""
    began = time.process_time()
    try:
        pixels = decode(data, MAX_PIXELS, view)
    except ViewError:
        assert view.region is not None or view.prefix < 1  # not in the picture; a file without prefixes
        found = "view"
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
    assert time.process_time() - began < max_cpu_s
    return found


def explore(count: int, seed: int, path: Path, max_cpu_s: float = MAX_CPU_S) -> Counter[str]:
    """What becomes of so many files; one that ends the process, or is not as it must be, lies at a path."""
    rng = random.Random(seed)
    seen: Counter[str] = Counter()
    for _ in range(count):
        data, view = mutated(rng), any_view(rng)
        path.write_bytes(data)
        seen[outcome(data, view, max_cpu_s)] += 1
    path.unlink(missing_ok=True)
    return seen
