"""A second decoder of version 2, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

Its parts follow the sections of that text, in their order, with their names, up to the Gaussians.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MODELS = Path(__file__).parents[2] / "docs" / "format" / "models.json"
Gaussian = tuple[float, float, float, float, float, tuple[float, ...]]  # x, y, l1, l2, l3, colour


class RefusedError(Exception):
    """The bytes are not a whole, intact file."""


def refuse_unless(condition: bool, why: str) -> None:
    if not condition:
        raise RefusedError(why)


# Conventions


def round32(value: float) -> float:
    rounded: float = struct.unpack(">f", struct.pack(">f", value))[0]
    return rounded


# Both versions


def body_of(data: bytes, version: int) -> bytes:
    """What lies between signature and checksum."""
    refuse_unless(len(data) >= 3, "too short")
    refuse_unless(data[:2] == bytes([0xD3, 0xC0 + version]), "signature")
    end = len(data) - (1 if data[2] >= 128 else 4)
    refuse_unless(end >= 3, "too short")
    checksum = zlib.crc32(data[:end]).to_bytes(4, "big")
    refuse_unless(data[end:] == checksum[-len(data[end:]) :], "checksum")
    return data[2:end]


# Version 2: limits

MAX_GAUSSIANS = 2**24
MAX_COLOUR = 2**22
MAX_EXPONENT = 18
MAX_U_BITS, MAX_PART_BITS = 12, 16
MAX_V, MAX_R = 8, 4096
MIN_COLOUR_STEP = 2.0**-16
OCTAVES, PATCH, MAX_STRENGTH = 2, 64, 15


# Header


@dataclass
class Header:
    """The fields of a picture, or those of its alpha."""

    grey: bool
    upright: bool
    is_short: bool
    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]


class Bits:
    """A string of bits, the most significant of a byte first."""

    def __init__(self, data: bytes) -> None:
        self.bits = "".join(f"{byte:08b}" for byte in data)
        self.at = 0

    def take(self, count: int) -> int:
        refuse_unless(self.at + count <= len(self.bits), "end")
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

    def fill(self) -> None:
        """Go on to a whole byte."""
        refuse_unless(self.take(-self.at % 8) == 0, "padding")


def read_header(bits: Bits) -> tuple[Header, bool, tuple[Header, int] | None]:
    """The picture's header; whether there is texture; alpha's header, and the bytes of its payload."""
    flags = bits.take(5)
    grey, upright, has_texture, has_alpha, is_short = (bool(flags // 2**k % 2) for k in range(5))
    width, height = bits.grown(4), bits.grown(4)
    quantum = quantum_of(bits.upper(12, 8, is_short))
    red = bits.upper(8, 5, is_short)
    green, blue = (red, red) if grey else (bits.upper(8, 5, is_short), bits.upper(8, 5, is_short))
    header = Header(grey, upright, is_short, width, height, quantum, (red, green, blue))
    alpha = None
    if has_alpha:
        quantum = quantum_of(bits.upper(12, 8, is_short))
        value = bits.upper(8, 5, is_short)
        alpha = Header(True, False, is_short, width, height, quantum, (value,) * 3), bits.grown(5) - 1
    bits.fill()
    return header, has_texture, alpha


def quantum_of(code: int) -> float:
    return (1 + code % 256 / 256) * 2.0 ** (3 - code // 256)


# Texture

Codes = list[list[list[int]]]  # of strengths, by octave, row and column


def read_texture(header: Header, bits: Bits) -> Codes:
    rows, columns = -(-header.height // PATCH), -(-header.width // PATCH)
    codes: Codes = []
    for octave in range(OCTAVES):
        codes.append([])
        above = 0
        for row in range(rows):
            t = above
            codes[octave].append([])
            for column in range(columns):
                ones = 0
                while bits.take(1):
                    ones += 1
                t += -(ones + 1) // 2 if ones % 2 else ones // 2
                above = t if column == 0 else above
                code = t + (codes[octave - 1][row][column] if octave > 0 else 0)
                refuse_unless(0 <= code <= MAX_STRENGTH, "strength")
                codes[octave][row].append(code)
    bits.fill()
    return codes


# Payload: states and symbols

COLOUR, SHAPE = 0, 1  # the states


class Model:
    def __init__(self, start: list[int]) -> None:
        self.fast = [0, *(32704 * b // 256 + 4 * i for i, b in enumerate(start, 1))]
        self.slow = list(self.fast)
        self.seen = 0

    def edges(self) -> list[int]:
        return [*((fast + slow) // 2 for fast, slow in zip(self.fast, self.slow, strict=True)), 32768]

    def adapt(self, symbol: int) -> None:
        j = min((self.seen + 16).bit_length() - 1, 7)
        self.seen += 1
        for i in range(1, 16):
            aim = 4 * i + 32704 * (i > symbol)
            self.fast[i] += (aim - self.fast[i] + 15) // 32
            self.slow[i] += (aim - self.slow[i] + 2 ** (j - 1) - 1) // 2**j


def edges_of(models: Sequence[Model]) -> list[int]:
    """Those of a symbol that has one model, or two."""
    return [sum(edges) // len(models) for edges in zip(*(model.edges() for model in models), strict=True)]


class Models:
    def __init__(self) -> None:
        of = {name: [Model(start) for start in tables()[name]] for name in MODEL_NAMES}
        (self.count,), (self.distance,) = of["count"], of["distance"]
        self.luma, self.luma_by_group = of["luma"], of["luma_by_group"]
        self.a, self.a_by_group, self.b, self.b_by_luma = of["a"], of["a_by_group"], of["b"], of["b_by_luma"]
        self.v, self.v_by_group, self.r, self.r_by_direction = of["v"], of["v_by_group"], of["r"], of["r_by_direction"]
        self.colour_signs, self.shape_signs = of["colour signs"], of["shape signs"]


MODEL_NAMES = (
    "count",
    "distance",
    "luma",
    "luma_by_group",
    "a",
    "a_by_group",
    "b",
    "b_by_luma",
    "colour signs",
    "v",
    "v_by_group",
    "r",
    "r_by_direction",
    "shape signs",
)


@cache
def tables() -> dict[str, Any]:
    """Where models begin, fifteen numbers a model, and the numbers of how likely a block is."""
    found: dict[str, Any] = json.loads(MODELS.read_text("utf-8"))
    return found


class Coder:
    def __init__(self, payload: bytes, states: int) -> None:
        self.payload, self.at = payload, 0
        self.queue, self.queued = 0, 0  # raw bits and their number
        self.states = [self.bytes(4) for _ in range(states)]

    def bytes(self, count: int) -> int:
        self.at += count
        return int.from_bytes(self.payload[self.at - count : self.at].ljust(count, b"\0"), "little")

    @property
    def is_past_end(self) -> bool:
        return self.at > len(self.payload)

    def symbol(self, which: int, *models: Model) -> int:
        which %= len(self.states)
        state = self.states[which]
        place = state % 32768
        edges = edges_of(models)
        symbol = next(i for i in range(16) if place < edges[i + 1])
        state = (edges[symbol + 1] - edges[symbol]) * (state // 32768) + place - edges[symbol]
        self.states[which] = state * 65536 + self.bytes(2) if state < 65536 else state
        for model in models:
            model.adapt(symbol)
        return symbol

    # Raw bits and numbers

    def fetch(self, count: int) -> None:
        while self.queued < count:
            self.queue += self.bytes(1) << self.queued
            self.queued += 8

    def take(self, count: int) -> int:
        value = self.queue % 2**count
        self.queue >>= count
        self.queued -= count
        return value

    def number(self, which: int, *models: Model) -> Number:
        s = self.symbol(which, *models)
        if s < 4:
            return Number(s, 0, s)
        if s == 15:
            self.fetch(5)
            n = self.take(5)
            self.fetch(n)
            return Number(2**n + self.take(n), 0, s)
        n = s // 2 - 1
        return Number((2 + s % 2) * 2**n, n, s)

    def rest(self, number: Number) -> int:
        return number.least + self.take(number.rest)


@dataclass(frozen=True)
class Number:
    least: int = 0
    rest: int = 0  # bits that follow
    symbol: int = 0

    @property
    def magnitude(self) -> int:
        return 0 if self.symbol == 0 else 1 if self.symbol <= 2 else 2 if self.symbol <= 5 else 3

    @property
    def slant(self) -> int:
        return 0 if self.symbol == 0 else 1 if self.symbol <= 3 else 2 if self.symbol <= 6 else 3


# Classes


class EndError(Exception):
    """A part of the payload has ended."""


@dataclass(frozen=True)
class SizeClass:
    k: int
    columns: int
    rows: int
    n: int
    blocks: Blocks

    @property
    def g(self) -> int:
        return max(0, (self.k + 1) // 2)

    @property
    def group(self) -> int:
        return min(self.k + 4, 13)


def size(k: int) -> float:
    return 1.4142135623730951 * 2.0 ** ((k - 1) // 2) if k % 2 else 2.0 ** (k // 2)


def read_payload(header: Header, coder: Coder, is_part: bool) -> Iterator[Integers]:
    """The Gaussians of a payload; of a part of one, until EndError."""
    if not coder.payload:
        return
    models = Models()
    most = min(header.width * header.height, MAX_GAUSSIANS, 3 * len(coder.payload) + 64)
    is_begun = min(coder.states) >= 65536
    coder.fetch(6)
    first = 28 - coder.take(6)
    coder.fetch(6)
    last = first - coder.take(6)
    check_end(coder, is_part)
    refuse_unless(is_begun and last >= -4, "start")
    the_map = Map(header.width, header.height)
    total = 0
    for k in range(first, last - 1, -1):
        number = coder.number(COLOUR, models.count)
        coder.fetch(number.rest)
        n = coder.rest(number)
        check_end(coder, is_part)
        refuse_unless(is_part or total + n <= most, "count")
        n = min(n, MAX_GAUSSIANS)
        if n == 0:
            continue
        of_class, now = size_class(header, k, n, the_map), None
        found = []
        for i in range(n + 1):
            if total == most:
                raise EndError
            before, now = now, read_turn(header, coder, models, of_class, i < n, now)
            if before is not None:
                check_end(coder, is_part)
                yield before
                found.append(before)
                total += 1
        for one in [] if header.is_short else found:
            the_map.add(one, gaussian_of(header, one))
    refuse_unless(is_part or set(coder.states) == {65536}, "last states")
    refuse_unless(is_part or coder.queue == 0, "last bits")
    refuse_unless(is_part or not any(coder.payload[coder.at :]), "rest")


def check_end(coder: Coder, is_part: bool) -> None:
    """What follows where more was read than there is: in a part of a payload, its end."""
    if coder.is_past_end:
        if is_part:
            raise EndError
        raise RefusedError("end")


def size_class(header: Header, k: int, n: int, the_map: Map) -> SizeClass:
    g = max(0, (k + 1) // 2)
    columns, rows = (min(inside(pixels, g) + 4, 65536) for pixels in (header.width, header.height))
    the_map.refine(g)
    return SizeClass(k, columns, rows, n, Blocks(the_map, k, n))


# The map

TINY = np.float32(2.0**-12)
SMALLEST_BLOCK, LARGEST_BLOCK, MAX_LEVEL = 3, 12, 20
Sums = NDArray[np.float32]  # E, X and Y, by row and column


def log2_16(x: Sums) -> NDArray[np.int64]:
    """L: about 16 log2(x)."""
    return np.asarray(x, np.float32).view(np.uint32).astype(np.int64) // 2**19 - 2032


def inside(side: int, m: int) -> int:
    return (side - 1) // 2**m + 1


def pooled(finer: Sums, rows: int, columns: int) -> Sums:
    """Blocks twice as wide, of which there are so many."""
    wide = np.zeros((len(finer), 2 * rows, 2 * columns), np.float32)
    part = finer[:, : 2 * rows - 2, : 2 * columns - 2]
    wide[:, 2 : 2 + part.shape[1], 2 : 2 + part.shape[2]] = part
    return (wide[:, ::2, ::2] + wide[:, 1::2, ::2]) + (wide[:, ::2, 1::2] + wide[:, 1::2, 1::2])


def sums_of_9(block: Sums) -> Sums:
    padded = np.pad(block, ((0, 0), (1, 1), (1, 1)))
    along = (padded[:, :, :-2] + padded[:, :, 1:-1]) + padded[:, :, 2:]
    return (along[:, :-2] + along[:, 1:-1]) + along[:, 2:]


def limited(x: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    return np.clip(x, -most, most)


class Map:
    """What the Gaussians so far tell of the next class."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self.m: int | None = None
        self.block = np.zeros((3, 0, 0), np.float32)
        self.n, self.total = 0, 0.0  # N and T

    def shape(self, m: int) -> tuple[int, int]:
        """Rows and columns of map(m)."""
        return inside(self.height, m) + 4, inside(self.width, m) + 4

    def blocks_inside(self, m: int) -> int:
        return inside(self.width, m) * inside(self.height, m)

    def mean(self, m: int) -> int:
        return int(log2_16(np.float32(self.total / self.blocks_inside(m)) + TINY))

    def refine(self, g: int) -> None:
        """Go on to the blocks for a class of this g."""
        m = max(g, SMALLEST_BLOCK)
        while m < max(g, LARGEST_BLOCK) and math.prod(self.shape(m)) > 8 * self.n + 1024:
            m += 1
        if self.m is None:
            self.m = m
            self.block = np.zeros((3, *self.shape(m)), np.float32)
        while self.m > m:
            self.m -= 1
            rows, columns = (np.arange(n) - 2 for n in self.shape(self.m))
            self.block = np.float32(0.25) * self.block[:, (rows // 2 + 2)[:, None], columns // 2 + 2]

    def add(self, integers: Integers, gaussian: Gaussian) -> None:
        x, y, l1, l2, l3, _ = gaussian
        weight = integers.square * 2.0 ** (-2 - integers.of_class.k) / (l1 * l3)
        energy = round32(weight * (l1 * l1 + (l2 * l2 + l3 * l3)))
        across = round32(weight * ((l2 * l2 + l3 * l3) - l1 * l1))
        aslant = round32(weight * (-2 * (l1 * l2)))
        value = np.array([energy, across, aslant], np.float32)
        self.n, self.total = self.n + 1, self.total + 4 * energy
        far1, far2, far3 = (np.float32(1.25) * np.float32(factor) for factor in (l1, l2, l3))
        x, y = np.float32(x), np.float32(y)
        for at in ((x + far1, y + far2), (x - far1, y - far2), (x, y + far3), (x, y - far3)):
            column, row = (
                math.floor(min(max(u * np.float32(2.0**-self.m) + np.float32(2), np.float32(0)), np.float32(count - 1)))
                for u, count in zip(at, self.block.shape[:0:-1], strict=True)
            )
            self.block[:, row, column] += value


class Blocks:
    """A class's blocks: how likely each is, and the parts that follow from it."""

    def __init__(self, the_map: Map, k: int, n: int) -> None:
        assert the_map.m is not None
        self.map, self.m, self.n, self.group = the_map, the_map.m, n, min(k + 4, 13)
        self.of_map = the_map.block.copy()
        self.is_known = the_map.n > 0
        level = self.m
        while level < max(self.m, LARGEST_BLOCK) and the_map.blocks_inside(level) > 8 * n + 64:
            level += 1
        self.level = level  # M
        self.rows, self.columns = the_map.shape(level)
        self.inside = the_map.blocks_inside(level)
        self.density = lg(256 * n // self.inside + 1) - 128
        self.here = self.likely()
        self.around = sums_of_9(self.of_map)
        self.counts = np.zeros((self.rows + 4, self.columns + 8), np.int64)  # with none above and beside
        self.levels: list[int] = []  # of the blocks so far
        self.first = 0  # the first part of the last of these
        self.parts = 0  # in all these

    def likely(self) -> NDArray[np.int64]:
        """`here` of all blocks."""
        if not self.is_known:
            return np.zeros((self.rows, self.columns), np.int64)
        of, f = tables(), self.features()
        total = np.full(f[0].shape, 64 * of["map_base"][self.group], np.int64)
        for out, bias, weights in zip(of["map_out"], of["map_bias"][self.group], of["map_weights"], strict=True):
            total += out * (np.maximum(64 * bias + sum(w * x for w, x in zip(weights, f, strict=True)), 0) // 64)
        return total // 64

    def features(self) -> list[NDArray[np.int64]]:
        """f0 to f3 of all blocks."""
        block = self.of_map
        for m in range(self.m, self.level):
            block = pooled(block, *self.map.shape(m + 1))
        far = block
        for m in (self.level, self.level + 1):
            far = pooled(far, *self.map.shape(m + 1))
        rows, columns = ((np.arange(n) - 2) // 4 + 2 for n in block.shape[1:])
        e, (s, sx, sy), sf = block[0], sums_of_9(block), sums_of_9(far)[0][rows[:, None], columns]
        mean = self.map.mean(self.level)
        return [
            limited(log2_16(e + TINY) - mean, 255),
            limited(log2_16(s + np.float32(9) * TINY) - mean, 255),
            limited(log2_16(sf + np.float32(144) * TINY) - mean, 255),
            limited(log2_16((abs(sx) + abs(sy)) + TINY) - log2_16(s + TINY), 255),
        ]

    def own(self, row: int, column: int) -> int:
        """What the class's own Gaussians in the blocks before this tell."""
        if not self.is_known:
            return 0
        here, above = self.counts[row + 4, column : column + 4], self.counts[row : row + 4, column : column + 9]
        p = min(int(2 * here[3] + 2 * above[3, 4] + above[3, 3] + above[3, 5]), 63)
        q = min(int(here.sum() + above.sum()), 255)
        o = (
            lg(256 * p * self.inside // (6 * self.n) + 77) - 128,
            lg(256 * q * self.inside // (40 * self.n) + 77) - 128,
            self.density,
        )
        of, total = tables(), 0
        for out, bias, weights in zip(of["own_out"], of["own_bias"][self.group], of["own_weights"], strict=True):
            total += out * (max(64 * bias + sum(w * x for w, x in zip(weights, o, strict=True)), 0) // 64)
        return total // 64

    def next_level(self, row: int, column: int) -> int:
        is_outside = not (2 <= row < self.rows - 2 and 2 <= column < self.columns - 2)
        likely = self.density + int(self.here[row, column]) + self.own(row, column) + 104 - 48 * is_outside
        return min(max(likely // 16, 0), MAX_LEVEL)

    def go_on(self) -> None:
        """Go on to the next block."""
        refuse_unless(len(self.levels) < self.rows * self.columns, "part")
        self.levels.append(self.next_level(*divmod(len(self.levels), self.columns)))
        self.first, self.parts = self.parts, self.parts + 2 ** self.levels[-1]

    def part(self, number: int) -> Part:
        """The part of that number, which is no lower than of any before; a Gaussian is in it."""
        while number >= self.parts:
            self.go_on()
        level = self.levels[-1]
        row, column = divmod(len(self.levels) - 1, self.columns)
        self.counts[row + 4, column + 4] += 1
        i, j = level // 2, (level + 1) // 2
        within = number - self.first
        even, odd = (sum((within >> 2 * bit + first & 1) << bit for bit in range(16)) for first in (0, 1))
        x, y = (even, odd) if i == j else (odd, even)
        return Part(number, column, row, i, j, x, y, *self.contexts(column, row, i, j, x, y))

    def contexts(self, column: int, row: int, i: int, j: int, x: int, y: int) -> tuple[int, int]:
        """`energy` and `direction` around a part."""
        if not self.is_known:
            return 0, 0
        wide = 2 ** (self.level - self.m)
        at = (
            min(max((along - 2) * wide + x * wide // 2**bits + 2, 0), count - 1)
            for along, x, bits, count in zip((row, column), (y, x), (j, i), self.around.shape[1:], strict=True)
        )
        s, sx, sy = self.around[(slice(None), *at)]
        of_mean = log2_16(s * np.float32(1 / 9) + TINY) - self.map.mean(self.m)
        energy = 1 + min(max((int(of_mean) + 96) // 24, 0), 7)
        return energy, direction_of(float(s), float(sx), float(sy))


def direction_of(s: float, sx: float, sy: float) -> int:
    q = sx * sx + sy * sy
    if s == 0 or 25 * q < s * s:
        return 1
    c = 0 if 5 * q < s * s else 1 if 2 * q < s * s else 2
    if 5 * abs(sy) < 2 * abs(sx):
        o = 0 if sx > 0 else 4
    elif 5 * abs(sx) < 2 * abs(sy):
        o = 2 if sy > 0 else 6
    else:
        o = {(True, True): 1, (False, True): 3, (False, False): 5, (True, False): 7}[sx > 0, sy > 0]
    return 2 + 8 * c + o


@dataclass(frozen=True)
class Part:
    number: int
    column: int  # of its block
    row: int
    i: int
    j: int
    x: int
    y: int
    energy: int
    direction: int

    @property
    def fold(self) -> int:
        if self.direction < 2:
            return 0
        c, o = divmod(self.direction - 2, 8)
        return 1 + 3 * c + (1 if o % 2 else 2 if o in (2, 6) else 0)


# Bits of a Gaussian


@dataclass
class Integers:
    """A Gaussian in integers. Before its second turn, only its part and |y|, |a|, |b| are known."""

    of_class: SizeClass
    part: Part
    colour: list[int]  # y, a, b
    shape: list[int] = field(default_factory=list)  # u, v, r
    cell: list[int] = field(default_factory=list)  # column and row
    place: list[int] = field(default_factory=list)  # X, Y
    parts: tuple[int, int] = (0, 0)  # px, py

    def __post_init__(self) -> None:
        self.square = sum(value * value for value in self.colour)  # S
        self.h = min(self.square.bit_length() // 2, MAX_EXPONENT)
        self.bucket = min(self.h, 7)
        self.u_bits = min(max(self.h - 1, 0), MAX_U_BITS)


def lg(x: int) -> int:
    n = x.bit_length() - 1
    return 16 * n + 16 * x // 2**n - 16


def parts_of(integers: Integers) -> tuple[int, int]:
    """px and py."""
    (u, v, r), h, k, g = integers.shape, integers.h, integers.of_class.k, integers.of_class.g
    f = lg(integers.square) + 32 * g - 17
    w = lg(4**h + 4 * r * r) - 32 * h
    a = 16 * k + 8 * (2 * u + 1) // 2**integers.u_bits - 8
    b = 46 * v // 2**h
    px = (f + w - max(a + b, -56)) // 32 + 1
    py = (f - max(a - b, -56)) // 32 + 1
    return min(max(px, 0), MAX_PART_BITS), min(max(py, 0), MAX_PART_BITS)


# Turns


def read_turn(
    header: Header, coder: Coder, models: Models, of_class: SizeClass, has_next: bool, now: Integers | None
) -> Integers | None:
    """Part and colour of the next Gaussian, if there is one; `now` gets its signs, shape and place."""
    distance = y = a = b = v = r = Number()
    group = of_class.group
    if has_next:
        distance = coder.number(COLOUR, models.distance)
    if now:
        row = sum(w * (x != 0) for w, x in zip((4, 2, 1), now.colour, strict=True))
        signs = coder.symbol(SHAPE, models.colour_signs[row])
        now.colour = [-x if signs & w else x for w, x in zip((4, 2, 1), now.colour, strict=True)]
    part = None
    if has_next:
        coder.fetch(distance.rest + 3)
        steps = 8 * coder.rest(distance)
        part = of_class.blocks.part((now.part.number if now else 0) + steps + coder.take(3))
        y = coder.number(COLOUR, models.luma[part.energy], models.luma_by_group[group])
    if now:
        v = coder.number(
            SHAPE, models.v[8 * now.part.fold + now.bucket], models.v_by_group[8 * (group // 2) + now.bucket]
        )
    if has_next and not header.grey:
        a = coder.number(COLOUR, models.a[y.magnitude], models.a_by_group[4 * y.magnitude + group // 4])
    if now and not header.upright:
        r = coder.number(
            SHAPE,
            models.r[6 * now.bucket + min((v.symbol + 1) // 2, 5)],
            models.r_by_direction[4 * (8 * now.part.fold + now.bucket) + v.slant],
        )
    if has_next and not header.grey:
        b = coder.number(COLOUR, models.b[a.magnitude], models.b_by_luma[4 * a.magnitude + y.magnitude])
    if now:
        is_not_0 = 2 * (v.symbol != 0) + (r.symbol != 0)
        signs = coder.symbol(SHAPE, models.shape_signs[4 * now.part.direction + is_not_0])

    coder.fetch(v.rest + r.rest + (now.u_bits if now else 0) + y.rest + a.rest + b.rest)
    if now:
        read_shape(coder, now, (v, r), signs)
    following = None
    if part:
        colour = [coder.rest(number) for number in (y, a, b)]
        refuse_unless(any(colour), "no colour")
        refuse_unless(max(colour) <= MAX_COLOUR, "colour")
        following = Integers(of_class, part, colour)
    if now:
        read_place(coder, now)
    return following


def read_shape(coder: Coder, now: Integers, numbers: tuple[Number, Number], signs: int) -> None:
    v, r = (coder.rest(number) for number in numbers)
    u = coder.take(now.u_bits)
    refuse_unless(v <= MAX_V * 2**now.h and 2 * r <= MAX_R * 2**now.h, "shape")
    now.shape = [u, -v if signs & 2 else v, -r if signs & 1 else r]
    now.parts = parts_of(now)


def read_place(coder: Coder, now: Integers) -> None:
    of, part = now.of_class, now.part
    beyond = of.blocks.level - of.g  # M - g
    along = [(part.column, part.i, part.x), (part.row, part.j, part.y)]
    missing = [max(bits - (known - beyond), 0) for bits, (_, known, _) in zip(now.parts, along, strict=True)]
    coder.fetch(sum(missing))
    for bits, (block, known, at), count in zip(now.parts, along, missing, strict=True):
        known -= beyond
        taken = coder.take(count)
        z = at * 2 ** (bits - known) + taken if bits >= known else at // 2 ** (known - bits)
        now.cell.append((block - 2) * 2**beyond + 2 + z // 2**bits)
        now.place.append(z % 2**bits)
    refuse_unless(0 <= now.cell[0] < of.columns and 0 <= now.cell[1] < of.rows, "cell")


# Integers to Gaussians


def exponential(x: float) -> float:
    z = x / 1024
    e = 1 + z * (1 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)))
    for _ in range(10):
        e = e * e
    return e


def gaussian_of(header: Header, integers: Integers) -> Gaussian:
    k, g = integers.of_class.k, integers.of_class.g
    u, v, r = integers.shape
    step, least = 2.0**-integers.h, 0.30000001192092896
    shape_u = ((u + 0.5) / 2**integers.u_bits - 0.5) * 0.34657359027997264
    shape_v, shape_r = v * step, r * (2 * step)
    l1 = max(size(k) * exponential(shape_u + shape_v), least)
    l3 = max(size(k) * exponential(shape_u - shape_v), least)
    l2 = shape_r * l3

    x, y = (
        (along - 2 + (part + 0.5) / 2**bits) * 2**g
        for along, part, bits in zip(integers.cell, integers.place, integers.parts, strict=True)
    )

    c = max(header.quantum / (size(k) * 1.5), MIN_COLOUR_STEP)
    p = integers.colour[0] * c * 0.57735026918962576
    q = integers.colour[1] * c * 0.70710678118654752
    s = integers.colour[2] * c * 0.40824829046386302
    colour = round32(p + q + s), round32(p - 2 * s), round32(p - q + s)
    return round32(x), round32(y), round32(l1), round32(l2), round32(l3), colour


# The whole file


@dataclass(frozen=True)
class File:
    """What a file says, before its payloads are decoded."""

    header: Header
    codes: Codes  # none without texture
    alpha: tuple[Header, bytes] | None  # the header as of a picture, and the payload
    payload: bytes

    def integers(self) -> list[Integers]:
        return list(read_payload(self.header, coder_of(self.header, self.payload), is_part=False))

    def gaussians(self) -> list[Gaussian]:
        return [gaussian_of(self.header, one) for one in self.integers()]

    def alpha_integers(self) -> list[Integers]:
        return [] if self.alpha is None else list(read_payload(self.alpha[0], coder_of(*self.alpha), is_part=False))

    def alpha_gaussians(self) -> list[Gaussian]:
        return [] if self.alpha is None else [gaussian_of(self.alpha[0], one) for one in self.alpha_integers()]

    # A part of the payload

    def part(self, k: int) -> list[Gaussian]:
        """The Gaussians in the first k bytes of the payload."""
        coder = coder_of(self.header, self.payload[:k])
        found = []
        try:
            for integers in read_payload(self.header, coder, is_part=True):
                found.append(gaussian_of(self.header, integers))
        except EndError:
            pass
        except RefusedError:
            if not coder.is_past_end:
                raise
        return found


def coder_of(header: Header, payload: bytes) -> Coder:
    return Coder(payload, 1 if header.is_short else 2)


def read(data: bytes) -> File:
    bits = Bits(body_of(data, 2))
    header, has_texture, alpha = read_header(bits)
    codes = read_texture(header, bits) if has_texture else []
    rest = data[2 + bits.at // 8 : len(data) - (1 if header.is_short else 4)]
    if alpha is None:
        return File(header, codes, None, rest)
    of_alpha, length = alpha
    refuse_unless(len(rest) >= length, "alpha")
    return File(header, codes, (of_alpha, rest[:length]), rest[length:])
