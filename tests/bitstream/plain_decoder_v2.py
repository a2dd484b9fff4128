"""A second decoder of version 2, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

Its parts follow the sections of that text, in their order, with their names, up to the Gaussians.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

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

MAX_COLOUR = 2**22
MAX_EXPONENT = 18
MAX_U_BITS, MAX_PART_BITS, MAX_RAW_BITS = 12, 16, 24
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

    def edge(self, i: int) -> int:
        return 32768 if i == 16 else (self.fast[i] + self.slow[i]) // 2

    def adapt(self, symbol: int) -> None:
        j = min((self.seen + 16).bit_length() - 1, 7)
        self.seen += 1
        for i in range(1, 16):
            aim = 4 * i + 32704 * (i > symbol)
            self.fast[i] += (aim - self.fast[i] + 15) // 32
            self.slow[i] += (aim - self.slow[i] + 2 ** (j - 1) - 1) // 2**j


class Models:
    def __init__(self) -> None:
        of = {name: [Model(start) for start in rows] for name, rows in start_tables().items()}
        (self.count,), (self.distance,), (self.luma,) = of["count"], of["distance"], of["luma"]
        self.a, self.b, self.v, self.r = of["a"], of["b"], of["v"], of["r"]
        self.colour_signs, self.shape_signs = of["colour signs"], of["shape signs"]


def start_tables() -> dict[str, list[list[int]]]:
    """Where models begin: for each name, fifteen numbers a model."""
    tables: dict[str, list[list[int]]] = json.loads(MODELS.read_text("utf-8"))
    return tables


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

    def symbol(self, which: int, model: Model) -> int:
        which %= len(self.states)
        state = self.states[which]
        place = state % 32768
        symbol = next(i for i in range(16) if place < model.edge(i + 1))
        state = (model.edge(symbol + 1) - model.edge(symbol)) * (state // 32768) + place - model.edge(symbol)
        self.states[which] = state * 65536 + self.bytes(2) if state < 65536 else state
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

    def number(self, which: int, model: Model) -> Number:
        s = self.symbol(which, model)
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


# Classes


class EndError(Exception):
    """A part of the payload has ended."""


@dataclass(frozen=True)
class SizeClass:
    k: int
    columns: int
    rows: int
    t: int = 0

    @property
    def g(self) -> int:
        return max(0, (self.k + 1) // 2)


def size(k: int) -> float:
    return 1.4142135623730951 * 2.0 ** ((k - 1) // 2) if k % 2 else 2.0 ** (k // 2)


def deinterleave(cell: int) -> tuple[int, int]:
    """Column and row of a Morton code."""
    column = sum((cell >> 2 * i & 1) << i for i in range(16))
    row = sum((cell >> 2 * i + 1 & 1) << i for i in range(16))
    return column, row


def read_payload(header: Header, coder: Coder, is_part: bool) -> Iterator[Integers]:
    """The Gaussians of a payload; of a part of one, until EndError."""
    if not coder.payload:
        return
    models = Models()
    most = min(header.width * header.height, 2**24, 8 * len(coder.payload) + 64)
    is_begun = min(coder.states) >= 65536
    coder.fetch(6)
    first = 28 - coder.take(6)
    coder.fetch(6)
    last = first - coder.take(6)
    check_end(coder, is_part)
    refuse_unless(is_begun and last >= -4, "start")
    total = 0
    for k in range(first, last - 1, -1):
        number = coder.number(COLOUR, models.count)
        coder.fetch(number.rest)
        n = coder.rest(number)
        check_end(coder, is_part)
        refuse_unless(is_part or total + n <= most, "count")
        of_class, now = size_class(header, k, n), None
        for i in range(n + 1 if n > 0 else 0):
            if total == most:
                raise EndError
            before, now = now, read_turn(header, coder, models, of_class, i < n, now)
            if before is not None:
                check_end(coder, is_part)
                yield before
                total += 1
    refuse_unless(is_part or set(coder.states) == {65536}, "last states")
    refuse_unless(is_part or coder.queue == 0, "last bits")
    refuse_unless(is_part or not any(coder.payload[coder.at :]), "rest")


def check_end(coder: Coder, is_part: bool) -> None:
    """What follows where more was read than there is: in a part of a payload, its end."""
    if coder.is_past_end:
        if is_part:
            raise EndError
        raise RefusedError("end")


def size_class(header: Header, k: int, n: int) -> SizeClass:
    side = 2 ** max(0, (k + 1) // 2)
    columns, rows = (min(pixels // side + 5, 65536) for pixels in (header.width, header.height))
    t, mean = 0, columns * rows // max(n, 1)
    while mean >= 8:
        t, mean = t + 1, mean // 2
    return SizeClass(k, columns, rows, min(t, MAX_RAW_BITS))


# Bits of a Gaussian


@dataclass
class Integers:
    """A Gaussian in integers. Before its second turn, only its cell and |y|, |a|, |b| are known."""

    of_class: SizeClass
    cell: int
    colour: list[int]  # y, a, b
    shape: list[int] = field(default_factory=list)  # u, v, r
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
    (u, v, r), h, k = integers.shape, integers.h, integers.of_class.k
    f = lg(integers.square) + 32 * integers.of_class.g - 17
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
    """Cell and colour of the next Gaussian, if there is one; `now` gets its signs, shape and place."""
    distance = y = a = b = v = r = Number()
    if has_next:
        distance = coder.number(COLOUR, models.distance)
    if now:
        row = sum(w * (x != 0) for w, x in zip((4, 2, 1), now.colour, strict=True))
        signs = coder.symbol(SHAPE, models.colour_signs[row])
        now.colour = [-x if signs & w else x for w, x in zip((4, 2, 1), now.colour, strict=True)]
    if has_next:
        y = coder.number(COLOUR, models.luma)
    if now:
        v = coder.number(SHAPE, models.v[now.bucket])
    if has_next and not header.grey:
        a = coder.number(COLOUR, models.a[y.magnitude])
    if now and not header.upright:
        r = coder.number(SHAPE, models.r[now.bucket])
    if has_next and not header.grey:
        b = coder.number(COLOUR, models.b[a.magnitude])

    coder.fetch(v.rest + r.rest + (now.u_bits if now else 0) + (of_class.t if has_next else 0))
    if now:
        read_shape(coder, models, now, (v, r))
    low = coder.take(of_class.t) if has_next else 0

    px, py = now.parts if now else (0, 0)
    coder.fetch(y.rest + a.rest + b.rest + distance.rest + px + py)
    following = None
    if has_next:
        colour = [coder.rest(number) for number in (y, a, b)]
        refuse_unless(any(colour), "no colour")
        refuse_unless(max(colour) <= MAX_COLOUR, "colour")
        cell = (now.cell if now else 0) + coder.rest(distance) * 2**of_class.t + low
        column, row = deinterleave(cell)
        refuse_unless(cell < 2**32 and column < of_class.columns and row < of_class.rows, "cell")
        following = Integers(of_class, cell, colour)
    if now:
        now.place = [coder.take(px), coder.take(py)]
    return following


def read_shape(coder: Coder, models: Models, now: Integers, numbers: tuple[Number, Number]) -> None:
    v, r = (coder.rest(number) for number in numbers)
    u = coder.take(now.u_bits)
    refuse_unless(v <= MAX_V * 2**now.h and 2 * r <= MAX_R * 2**now.h, "shape")
    signs = coder.symbol(SHAPE, models.shape_signs[2 * (v != 0) + (r != 0)])
    now.shape = [u, -v if signs & 2 else v, -r if signs & 1 else r]
    now.parts = parts_of(now)


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
        for along, part, bits in zip(deinterleave(integers.cell), integers.place, integers.parts, strict=True)
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
