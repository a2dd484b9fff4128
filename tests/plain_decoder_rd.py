"""A second decoder of version 2, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

Each part follows one section of that text, in its order.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

Gaussian = tuple[float, float, float, float, float, tuple[float, float, float]]  # x, y, l1, l2, l3, colour

CUTOFF = 5.5
MAX_VALUE, MAX_SHAPE, MAX_ASPECT = 2**20, 2**16, 20
SLACK = 8  # bytes past the end


class RefusedError(Exception):
    """The bytes are not a whole, intact file."""


class EndError(Exception):
    """A part of the payload has ended."""


def refuse_unless(condition: bool, why: str) -> None:
    if not condition:
        raise RefusedError(why)


def round32(value: float) -> float:
    rounded: float = struct.unpack(">f", struct.pack(">f", value))[0]
    return rounded


@dataclass
class Header:
    grey: bool
    upright: bool
    width: int
    height: int
    quantum: float
    background: tuple[int, int, int]


def parse_header(data: bytes) -> Header:
    refuse_unless(len(data) >= 18, "too short")
    refuse_unless(data[0:3] == b"SGM", "magic")
    refuse_unless(data[3] == 2, "version")
    refuse_unless(struct.unpack_from(">I", data, 4)[0] == zlib.crc32(data[8:]), "checksum")
    flags, width, height, quantum, red, green, blue = struct.unpack_from(">BHHHBBB", data, 8)
    refuse_unless(flags <= 3, "flags")
    refuse_unless(width > 0 and height > 0, "size")
    refuse_unless(quantum == 0 or 256 <= quantum <= 3839, "quantum")
    value = (1 + (quantum & 255) / 256) * 2.0 ** (4 - (quantum >> 8))
    return Header(bool(flags & 1), bool(flags & 2), width, height, value, (red, green, blue))


class Model:
    def __init__(self) -> None:
        self.fast, self.slow, self.seen = 32768, 32768, 1

    def adapt(self, bit: int) -> None:
        i, j = min(self.seen + 1, 4), min(self.seen + 1, 6)
        self.seen = min(self.seen + 1, 6)
        if bit:
            self.fast -= self.fast >> i
            self.slow -= self.slow >> j
        else:
            self.fast += (65535 - self.fast) >> i
            self.slow += (65535 - self.slow) >> j


class RangeDecoder:
    def __init__(self, payload: bytes) -> None:
        self.payload, self.at = payload, 0
        self.range, self.code = 2**32 - 1, 0
        for _ in range(4):
            self.code = self.code * 256 + self.byte()
        refuse_unless(self.code < self.range, "start")

    def byte(self) -> int:
        self.at += 1
        return self.payload[self.at - 1] if self.at <= len(self.payload) else 0

    @property
    def past_end(self) -> int:
        return max(self.at - len(self.payload), 0)

    def normalise(self) -> None:
        while self.range < 2**24:
            self.range *= 256
            self.code = self.code * 256 + self.byte()

    def bit(self, model: Model) -> int:
        p = (model.fast + model.slow) // 2
        bound = self.range // 65536 * min(max(p, 64), 65472)
        bit = int(self.code >= bound)
        if bit:
            self.code -= bound
            self.range -= bound
        else:
            self.range = bound
        model.adapt(bit)
        self.normalise()
        return bit

    def raw(self, count: int) -> int:
        value = 0
        for _ in range(count):
            self.range >>= 1
            bit = int(self.code >= self.range)
            if bit:
                self.code -= self.range
            value = 2 * value + bit
            self.normalise()
        return value


class Magnitude:
    def __init__(self) -> None:
        self.exponent = [Model() for _ in range(31)]
        self.high = [Model() for _ in range(32)]

    def read(self, coder: RangeDecoder) -> int:
        e = 0
        while e < 31 and coder.bit(self.exponent[e]):
            e += 1
        top = 1
        if e >= 1:
            top = 2 * top + coder.bit(self.high[e])
        if e >= 2:
            top = 2 ** (e - 1) * top + coder.raw(e - 1)
        return top - 1


class Signed:
    def __init__(self) -> None:
        self.magnitude, self.sign = Magnitude(), Model()

    def read(self, coder: RangeDecoder) -> int:
        value = self.magnitude.read(coder)
        refuse_unless(value <= MAX_VALUE, "value")
        if value == 0:
            return 0
        return -value if coder.bit(self.sign) else value


def level(x: int) -> int:
    return 0 if x == 0 else 1 if abs(x) <= 2 else 2 if abs(x) <= 6 else 3


class Models:
    def __init__(self) -> None:
        self.count, self.distance = Magnitude(), Magnitude()
        self.luma = Signed()
        self.a, self.b = ([Signed() for _ in range(4)] for _ in range(2))
        self.v, self.r = ([Signed() for _ in range(8)] for _ in range(2))


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


def read_gaussians(header: Header, coder: RangeDecoder, part: bool) -> Iterator[Gaussian]:
    """The Gaussians of a payload; of a part of one, until EndError."""

    def check_end() -> None:
        if part and coder.past_end:
            raise EndError

    models = Models()
    most = min(header.width * header.height, 2**24, 8 * len(coder.payload) + 64)
    total = 0
    for k in range(28, -5, -1):
        g = max(0, (k + 1) // 2)
        columns = min(header.width // 2**g + 5, 65536)
        rows = min(header.height // 2**g + 5, 65536)
        n = models.count.read(coder)
        check_end()
        refuse_unless(part or total + n <= most, "count")
        t, mean = 0, columns * rows // max(n, 1)
        while mean >= 8:
            t, mean = t + 1, mean // 2
        cell = 0
        for _ in range(n):
            if total == most:
                raise EndError
            total += 1
            cell += models.distance.read(coder) * 2**t
            cell += coder.raw(t)
            refuse_unless(cell < 2**32, "cell")
            column, row = deinterleave(cell)
            refuse_unless(column < columns and row < rows, "cell")
            gaussian = read_gaussian(header, coder, models, k, (column, row))
            check_end()
            refuse_unless(coder.past_end <= SLACK, "end")
            yield gaussian
    refuse_unless(coder.past_end <= SLACK, "end")
    refuse_unless(part or not any(coder.payload[coder.at :]), "rest")


def read_gaussian(header: Header, coder: RangeDecoder, models: Models, k: int, cell: tuple[int, int]) -> Gaussian:
    # Colour, and the steps that follow from it
    y = models.luma.read(coder)
    a = 0 if header.grey else models.a[level(y)].read(coder)
    b = 0 if header.grey else models.b[level(a)].read(coder)
    refuse_unless(y != 0 or a != 0 or b != 0, "no colour")
    m = math.sqrt(y * y + a * a + b * b)
    f, e = math.frexp(m)
    h = e - 1 if f < 0.70710678118654752 else e
    bucket, u_bits = min(max(h, 0), 7), min(max(h - 1, 0), 8)

    # Shape
    u = coder.raw(u_bits)
    v = models.v[bucket].read(coder)
    r = 0 if header.upright else models.r[bucket].read(coder)
    shape_v, shape_r = v * 2.0**-h, r * (2 * 2.0**-h)
    refuse_unless(abs(v) <= MAX_SHAPE and abs(r) <= MAX_SHAPE and abs(shape_v) <= MAX_ASPECT, "shape")
    within = ((u + 0.5) / 2**u_bits - 0.5) * 0.34657359027997264
    least = round32(0.3)
    l1 = max(size(k) * exponential(within + shape_v), least)
    l3 = max(size(k) * exponential(within - shape_v), least)
    l2 = shape_r * l3

    # Place
    side = 2 ** max(0, (k + 1) // 2)
    step = 1.4142135623730951 / m
    px = halvings(side / (step * l1 / math.sqrt(1 + shape_r * shape_r)))
    py = halvings(side / (step * l3))
    part_x = coder.raw(px)
    part_y = coder.raw(py)
    place_x = (cell[0] - 2 + (part_x + 0.5) / 2**px) * side
    place_y = (cell[1] - 2 + (part_y + 0.5) / 2**py) * side

    # Colour, in numbers
    c = header.quantum / (size(k) * 1.7724538509055160)
    p = y * c * 0.57735026918962576
    q = a * c * 0.70710678118654752
    s = b * c * 0.40824829046386302
    color = round32(p + q + s), round32(p - 2 * s), round32(p - q + s)
    return round32(place_x), round32(place_y), round32(l1), round32(l2), round32(l3), color


def exponential(x: float) -> float:
    z = x / 1024
    e = 1.0
    for i in range(12, 0, -1):
        e = 1 + e * z / i
    for _ in range(10):
        e = e * e
    return e


def halvings(q: float) -> int:
    return min(max(math.frexp(q)[1], 0), 12)


def parse(data: bytes) -> tuple[Header, list[Gaussian]]:
    """The header and the Gaussians."""
    header = parse_header(data)
    return header, list(read_gaussians(header, RangeDecoder(data[18:]), part=False))


def parse_part(data: bytes, part: float) -> tuple[Header, list[Gaussian]]:
    """The header, and the Gaussians in a part, above 0 and below 1, of the payload."""
    header = parse_header(data)
    coder = RangeDecoder(data[18:][: math.ceil(part * (len(data) - 18))])
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
            samples += bytes(math.floor(255 * min(max(value, 0.0), 1.0) + 0.5) for value in values)
    return bytes(samples)


def view(data: bytes, scale: float, region: tuple[int, int, int, int] | None = None) -> tuple[int, int, bytes]:
    """Width, height and samples of a view."""
    header, gaussians = parse(data)
    left, top, w, h = region or (0, 0, header.width, header.height)
    width, height = max(round(w * scale), 1), max(round(h * scale), 1)
    sx, sy = width / w, height / h
    vx, vy = max(1 - sx**2, 0) / 12, max(1 - sy**2, 0) / 12
    shown = []
    for x, y, l1, l2, l3, color in gaussians:
        a, b, d = sx * l1, sy * l2, sy * l3
        n1 = math.sqrt(a * a + vx)
        n3 = math.sqrt(d * d + vy + (b / n1) ** 2 * vx)
        red, green, blue = (round32(value * (a * d) / (n1 * n3)) for value in color)
        place = round32((x - left) * sx), round32((y - top) * sy)
        shown.append((*place, round32(n1), round32(a * b / n1), round32(n3), (red, green, blue)))
    return width, height, draw(shown, width, height, header.background)
