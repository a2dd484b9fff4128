"""A second decoder of version 3, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

Each part follows one section of that text, in its order. What is the same in all versions comes from the decoder of
version 1.
"""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.bitstream.plain_decoder import RefusedError, Region, refuse_unless, resized, round32, to_byte, view_size

Gaussian = tuple[float, float, float, float, float, tuple[float, float, float]]  # x, y, l1, l2, l3, colour

CUTOFF = 3.0
FORMAT = Path(__file__).parents[2] / "docs" / "format.md"


class EndError(Exception):
    """A part of the payload has ended."""


@dataclass(frozen=True)
class Numbers:
    """What another version may have otherwise. Of h, of |r| * r step and of c, version 3 has no limit."""

    version: int = 3
    most_colour: int = 2**20
    most_h: float = math.inf
    most_u_bits: int = 8
    most_part_bits: int = 12
    most_shape: float = 65536  # steps
    most_v: float = 20
    most_r: float = math.inf
    least_colour_step: float = 0.0
    most_flags: int = 3


V3 = Numbers()


@dataclass
class Header:
    grey: bool
    upright: bool
    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]
    numbers: Numbers = V3
    texture: bool = False
    alpha: bool = False


def parse_header(data: bytes, numbers: Numbers = V3) -> Header:
    refuse_unless(len(data) >= 18, "too short")
    refuse_unless(data[0:3] == b"SGM", "magic")
    refuse_unless(data[3] == numbers.version, "version")
    refuse_unless(struct.unpack_from(">I", data, 4)[0] == zlib.crc32(data[8:]), "checksum")
    flags, width, height, quantum, red, green, blue = struct.unpack_from(">BHHHBBB", data, 8)
    refuse_unless(flags <= numbers.most_flags, "flags")
    refuse_unless(width > 0 and height > 0, "size")
    value = quantum_of(quantum)
    kinds = [bool(flags >> bit & 1) for bit in range(4)]
    return Header(*kinds[:2], width, height, value, (red, green, blue), numbers, *kinds[2:])


def quantum_of(code: int) -> float:
    refuse_unless(code == 0 or 256 <= code <= 3839, "quantum")
    return (1 + (code & 255) / 256) * 2.0 ** (4 - (code >> 8))


def start_tables() -> dict[str, list[list[int]]]:
    """The text's table of where models begin: for each name, fifteen numbers a model."""
    tables: dict[str, list[list[int]]] = {}
    for name, row in re.findall(r"^\| ([a-z ]+) \d+ \| `([0-9a-f]{30})` \|$", FORMAT.read_text("utf-8"), re.M):
        tables.setdefault(name, []).append(list(bytes.fromhex(row)))
    return tables


class Model:
    def __init__(self, start: list[int]) -> None:
        self.fast = [0, *(256 * s for s in start)]
        self.slow = list(self.fast)
        self.seen = 0

    def edge(self, i: int) -> int:
        if i == 16:
            return 32768
        mean = (self.fast[i] + self.slow[i] + 1) // 2
        return mean // 2 - mean // 1024 + 4 * i

    def adapt(self, symbol: int) -> None:
        shift = (self.seen + 16).bit_length() - 1
        self.seen = min(self.seen + 1, 128)
        for values, most in (self.fast, 5), (self.slow, 7):
            for i in range(16):
                if i <= symbol:
                    values[i] -= values[i] >> min(shift, most)
                else:
                    values[i] += (65535 - values[i]) >> min(shift, most)


class Coder:
    def __init__(self, payload: bytes) -> None:
        self.payload, self.at, self.state = payload, 0, 0
        self.state = self.word() * 65536 + self.word()

    def word(self) -> int:
        self.at += 2
        high, low = (self.payload[i] if i < len(self.payload) else 0 for i in (self.at - 2, self.at - 1))
        return 256 * high + low

    @property
    def past_end(self) -> bool:
        return self.at > len(self.payload)

    def refill(self) -> None:
        if self.state < 65536:
            self.state = self.state * 65536 + self.word()

    def symbol(self, model: Model) -> int:
        place = self.state % 32768
        symbol = next(i for i in range(16) if place < model.edge(i + 1))
        share = model.edge(symbol + 1) - model.edge(symbol)
        self.state = share * (self.state // 32768) + place - model.edge(symbol)
        model.adapt(symbol)
        self.refill()
        return symbol

    def raw(self, count: int) -> int:
        high = 0
        if count > 16:
            high, count = self.raw(count - 16) << 16, 16
        value = self.state % 2**count
        self.state >>= count
        self.refill()
        return high + value

    def number(self, model: Model) -> int:
        s = self.symbol(model)
        if s < 4:
            return s
        if s == 15:
            n = self.raw(5)
            return 2**n + self.raw(n)
        n = s // 2 - 1
        return (2 + s % 2) * 2**n + self.raw(n)


def level(x: int) -> int:
    return 0 if x == 0 else 1 if abs(x) <= 2 else 2 if abs(x) <= 6 else 3


class Models:
    def __init__(self) -> None:
        of = {name: [Model(start) for start in rows] for name, rows in start_tables().items()}
        (self.count,), (self.distance,), (self.luma,) = of["count"], of["distance"], of["luma"]
        self.a, self.b, self.v, self.r = of["a"], of["b"], of["v"], of["r"]
        self.color_signs, self.shape_signs = of["colour signs"], of["shape signs"]


def size(k: int) -> float:
    if k % 2:
        return 1.4142135623730951 * 2.0 ** ((k - 1) // 2)
    return 2.0 ** (k // 2)


def deinterleave(number: int) -> tuple[int, int]:
    column = row = 0
    for i in range(16):
        column |= (number >> 2 * i & 1) << i
        row |= (number >> 2 * i + 1 & 1) << i
    return column, row


def check_end(past_end: bool, part: bool) -> None:
    """What follows where more was read than there is: in a part of a payload, its end."""
    if past_end:
        if part:
            raise EndError
        raise RefusedError("end")


def most_gaussians(header: Header, payload: bytes) -> int:
    """That a payload may hold."""
    return min(header.width * header.height, 2**24, 8 * len(payload) + 64)


def read_gaussians(header: Header, coder: Coder, part: bool) -> Iterator[Gaussian]:
    """The Gaussians of a payload; of a part of one, until EndError."""

    if not coder.payload:
        return
    models = Models()
    most = most_gaussians(header, coder.payload)
    begun = coder.state >= 65536
    first = 28 - coder.raw(6)
    last = first - coder.raw(6)
    check_end(coder.past_end, part)
    refuse_unless(begun and last >= -4, "start")
    total = 0
    for k in range(first, last - 1, -1):
        g = max(0, (k + 1) // 2)
        columns = min(header.width // 2**g + 5, 65536)
        rows = min(header.height // 2**g + 5, 65536)
        n = coder.number(models.count)
        check_end(coder.past_end, part)
        refuse_unless(part or total + n <= most, "count")
        t, mean = 0, columns * rows // max(n, 1)
        while mean >= 8:
            t, mean = t + 1, mean // 2
        cell = 0
        for _ in range(n):
            if total == most:
                raise EndError
            total += 1
            cell += coder.number(models.distance) * 2**t
            cell += coder.raw(t)
            refuse_unless(cell < 2**32, "cell")
            column, row = deinterleave(cell)
            refuse_unless(column < columns and row < rows, "cell")
            gaussian = read_gaussian(header, coder, models, k, (column, row))
            check_end(coder.past_end, part)
            yield gaussian
    refuse_unless(part or coder.state == 65536, "last state")
    refuse_unless(part or not any(coder.payload[coder.at :]), "rest")


def read_gaussian(header: Header, coder: Coder, models: Models, k: int, cell: tuple[int, int]) -> Gaussian:
    # Colour, and the steps that follow from it
    numbers = header.numbers
    y = coder.number(models.luma)
    a = 0 if header.grey else coder.number(models.a[level(y)])
    b = 0 if header.grey else coder.number(models.b[level(a)])
    refuse_unless(y != 0 or a != 0 or b != 0, "no colour")
    refuse_unless(max(y, a, b) <= numbers.most_colour, "colour")
    signs = coder.symbol(models.color_signs[4 * (y != 0) + 2 * (a != 0) + (b != 0)])
    y, a, b = (-value if signs & bit else value for value, bit in ((y, 4), (a, 2), (b, 1)))
    square = y * y + a * a + b * b
    h = int(min(square.bit_length() // 2, numbers.most_h))
    bucket, u_bits = min(h, 7), min(max(h - 1, 0), numbers.most_u_bits)
    v_step, r_step = 2.0**-h, 2 * 2.0**-h

    # Shape
    u = coder.raw(u_bits)
    v = coder.number(models.v[bucket])
    r = 0 if header.upright else coder.number(models.r[bucket])
    refuse_unless(max(v, r) <= numbers.most_shape, "shape")
    refuse_unless(v * v_step <= numbers.most_v and r * r_step <= numbers.most_r, "shape")
    if v or r:
        signs = coder.symbol(models.shape_signs[2 * (v != 0) + (r != 0)])
        v, r = -v if signs & 2 else v, -r if signs & 1 else r
    shape_v, shape_r = v * v_step, r * r_step
    within = ((u + 0.5) / 2**u_bits - 0.5) * 0.34657359027997264
    least = round32(0.3)
    l1 = max(size(k) * exponential(within + shape_v), least)
    l3 = max(size(k) * exponential(within - shape_v), least)
    l2 = shape_r * l3

    # Place
    side = 2 ** max(0, (k + 1) // 2)
    fineness = square * (side * side / 2)
    px = halvings(fineness * (1 + shape_r * shape_r) / (l1 * l1), numbers.most_part_bits)
    py = halvings(fineness / (l3 * l3), numbers.most_part_bits)
    part_x = coder.raw(px)
    part_y = coder.raw(py)
    place_x = (cell[0] - 2 + (part_x + 0.5) / 2**px) * side
    place_y = (cell[1] - 2 + (part_y + 0.5) / 2**py) * side

    # Colour, in numbers
    c = max(header.quantum / (size(k) * 1.5), numbers.least_colour_step)
    p = y * c * 0.57735026918962576
    q = a * c * 0.70710678118654752
    s = b * c * 0.40824829046386302
    color = round32(p + q + s), round32(p - 2 * s), round32(p - q + s)
    return round32(place_x), round32(place_y), round32(l1), round32(l2), round32(l3), color


def exponential(x: float) -> float:
    z = x / 1024
    e = 1 + z * (1 + z * (0.5 + z * (0.16666666666666666 + z * 0.041666666666666664)))
    for _ in range(10):
        e = e * e
    return e


def halvings(q: float, most: int) -> int:
    """The least number of halvings n >= 0, up to a maximum, with 4^n > q."""
    return min(max((math.frexp(q)[1] - 1 >> 1) + 1, 0), most)


def parse(data: bytes, numbers: Numbers = V3) -> tuple[Header, list[Gaussian]]:
    """The header and the Gaussians."""
    header = parse_header(data, numbers)
    return header, list(read_gaussians(header, Coder(data[18:]), part=False))


def parse_part(data: bytes, part: float, numbers: Numbers = V3) -> tuple[Header, list[Gaussian]]:
    """The header, and the Gaussians in a part, above 0 and below 1, of the payload."""
    header = parse_header(data, numbers)
    coder = Coder(data[18:][: math.ceil(part * (len(data) - 18))])
    found = []
    try:
        for gaussian in read_gaussians(header, coder, part=True):
            found.append(gaussian)
    except EndError:
        pass
    except RefusedError:
        if not coder.past_end:
            raise
    return header, found


def decode(data: bytes) -> tuple[int, int, bytes]:
    """Width, height and the samples: height rows of width pixels of red, green and blue."""
    header, gaussians = parse(data)
    return header.width, header.height, draw(gaussians, header.width, header.height, header.background)


def draw(gaussians: list[Gaussian], width: int, height: int, background: tuple[int, int, int]) -> bytes:
    samples = bytearray()
    for r in range(height):
        for c in range(width):
            values = [level / 255 for level in background]
            for x, y, l1, l2, l3, color in gaussians:
                z1 = (c + 0.5 - x) / l1
                z2 = (r + 0.5 - y - l2 * z1) / l3
                sigma = (z1 * z1 + z2 * z2) / 2
                if sigma < CUTOFF:
                    weight = math.exp(-sigma) - math.exp(-CUTOFF)
                    for channel in range(3):
                        values[channel] += color[channel] * weight
            samples += bytes(to_byte(value) for value in values)
    return bytes(samples)


def view(data: bytes, scale: float, region: Region | None = None) -> tuple[int, int, bytes]:
    """Width, height and samples of a view."""
    header, gaussians = parse(data)
    region = region or (0, 0, header.width, header.height)
    width, height = view_size(region, scale)
    return width, height, draw(resized(gaussians, region, scale, CUTOFF), width, height, header.background)
