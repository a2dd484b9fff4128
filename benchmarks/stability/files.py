"""Damaged files, a second decoder, sanitizers."""

from __future__ import annotations

import subprocess
import sys
import time
from collections import Counter
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.needs import photograph
from benchmarks.stability.case import Case, Cases, Found
from sgmethod import BitstreamError, Budget, decode, encode
from tests.harness.data import ROOT, golden, with_checksum

AT_A_TIME = 10_000  # mutations of a row
MAX_PIXELS = 1 << 18  # a header can claim 4 gigapixels
ROUNDING = 1  # level, which docs/format.md allows a decoder
LIMIT_S = 2.0  # processor time of one file
MUTATION_RULE = "files that end in anything but pixels or BitstreamError, or take more than 2 s of processor time"


def cases(mutations: int, sanitized: bool) -> Cases:
    """Mutations in parts, so that an interrupted run goes on."""
    for first in range(0, mutations, AT_A_TIME):
        count = min(AT_A_TIME, mutations - first)
        name = f"mutations {first:,} to {first + count - 1:,}"
        yield Case(name, MUTATION_RULE, 0, partial(mutated, first, count))
    yield Case(
        "a second decoder", "largest difference of a pixel's level, golden files and a photograph", ROUNDING, second
    )
    if sanitized:
        yield Case("sanitizers", "exit status of python -m tests.native.sanitize", 0, partial(sanitize, mutations))


def mutated(first: int, count: int) -> Found:
    """Each mutation has a seed of its own."""
    seeds = [*golden(1).values(), *golden(3).values(), *golden(4).values()]
    counts: Counter[str] = Counter()
    longest, broken = 0.0, ""
    for seed in range(first, first + count):
        data = damage(seeds[seed % len(seeds)], np.random.default_rng(seed))
        began = time.process_time()
        try:
            decode(data, MAX_PIXELS)
            counts["drawn"] += 1
        except BitstreamError:
            counts["refused"] += 1
        except Exception as error:
            counts["broken"] += 1
            broken = f"; seed {seed}: {type(error).__name__}: {error}"
        taken = time.process_time() - began
        counts["broken"] += taken > LIMIT_S
        longest = max(longest, taken)
    told = f"{counts['drawn']:,} drawn, {counts['refused']:,} refused, the longest {longest:.2f} s"
    return float(counts["broken"]), told + broken


def damage(data: bytes, random: np.random.Generator) -> bytes:
    """One to three changes behind the checksum, which then fits in two of three files."""
    body = bytearray(data[8:])
    for _ in range(random.integers(1, 4)):
        at, length = int(random.integers(0, max(len(body), 1))), int(random.integers(1, 12))
        kind = random.integers(0, 6)
        if kind == 0 and body:
            body[at] ^= 1 << int(random.integers(0, 8))
        elif kind == 1:
            body[at : at + length] = random.bytes(length)
        elif kind == 2:
            del body[at:]
        elif kind == 3:
            body[at:at] = random.bytes(length)
        elif kind == 4:
            body[: min(10, len(body))] = random.bytes(min(10, len(body)))
        else:
            body[at:] = bytes([int(random.choice([0, 85, 255]))]) * int(random.integers(0, 3000))
    damaged = data[:8] + bytes(body)
    return with_checksum(damaged) if random.integers(0, 3) else damaged


def second() -> Found:
    """The tests' decoder, written from docs/format.md alone, beside ours."""
    files = [*golden(4).values(), encode(photograph(48), Budget("bpp", 1)).data]
    plain_decoder: Any = import_module("tests.bitstream.plain_decoder_v5")  # tests have no types to check
    worst = 0
    for data in files:
        width, height, pixels = plain_decoder.decode(data)
        other = np.frombuffer(pixels, np.uint8).reshape(height, width, -1)  # with alpha, four channels
        worst = max(worst, int(np.abs(decode(data).astype(int) - other).max()))
    return float(worst), f"{len(files)} files"


def sanitize(mutations: int) -> Found:
    """Addresses, undefined behaviour and threads; builds the native code anew."""
    command = [sys.executable, "-m", "tests.native.sanitize", "--mutations", str(mutations)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return float(done.returncode), "" if done.returncode == 0 else done.stderr[-300:]
