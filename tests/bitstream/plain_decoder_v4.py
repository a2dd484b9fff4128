"""A second decoder of version 4, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

What is the same in all versions, or in version 3, comes from the decoders of versions 1 and 3.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from tests.bitstream import plain_decoder_v3 as v3
from tests.bitstream.plain_decoder import RefusedError, Region, refuse_unless, resized, round32, to_byte, view_size
from tests.bitstream.plain_decoder_v3 import CUTOFF, FORMAT, EndError, Gaussian, Header, Numbers

Plane = list[list[float]]  # rows of one colour's samples, in a part of a level


def numbers_in_the_text() -> dict[str, float]:
    """The table at the head of the section on version 4."""
    section = FORMAT.read_text("utf-8").split("\n# Version 4\n")[1].split("\n## ")[0]
    found = re.findall(r"^\| ([a-zA-Z ]+) \| (?:(\d+)\^)?(-?[\d.]+) \|", section, re.M)
    return {name: float(base) ** float(value) if base else float(value) for name, base, value in found}


TEXT = numbers_in_the_text()
NUMBERS = Numbers(
    version=4,
    most_colour=int(TEXT["most colour"]),
    most_h=TEXT["most exponent"],
    most_u_bits=int(TEXT["most u bits"]),
    most_part_bits=int(TEXT["most part bits"]),
    most_shape=math.inf,
    most_v=TEXT["most V"],
    most_r=TEXT["most R"],
    least_colour_step=TEXT["least colour step"],
    most_flags=15,
)
OCTAVES, CELL, MOST_STRENGTH = (int(TEXT[name]) for name in ("octaves", "cell", "most strength"))
NARROWEST, TOP_LEVEL = TEXT["narrowest"], int(TEXT["top level"])


MOST_RAW = int(TEXT["most raw bits"])


class Model:
    def __init__(self, start: list[int]) -> None:
        self.fast = [0, *(32704 * byte // 256 + 4 * i for i, byte in enumerate(start, 1))]
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


COLOUR, SHAPE = 0, 1  # the states


class Coder:
    def __init__(self, payload: bytes, states: int = 2) -> None:
        self.payload, self.at = payload, 0
        self.queue, self.queued = 0, 0  # raw bits and their number
        self.states = [self.bytes(4) for _ in range(states)]

    def bytes(self, count: int) -> int:
        self.at += count
        return int.from_bytes(self.payload[self.at - count : self.at].ljust(count, b"\0"), "little")

    @property
    def past_end(self) -> bool:
        return self.at > len(self.payload)

    def symbol(self, which: int, model: Model) -> int:
        which %= len(self.states)
        state = self.states[which]
        place = state % 32768
        symbol = next(i for i in range(16) if place < model.edge(i + 1))
        state = (model.edge(symbol + 1) - model.edge(symbol)) * (state // 32768) + place - model.edge(symbol)
        model.adapt(symbol)
        self.states[which] = state * 65536 + self.bytes(2) if state < 65536 else state
        return symbol

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


def level(x: Number) -> int:
    return 0 if x.symbol == 0 else 1 if x.symbol <= 2 else 2 if x.symbol <= 5 else 3


class Models:
    def __init__(self) -> None:
        of = {name: [Model(start) for start in rows] for name, rows in v3.start_tables().items()}
        (self.count,), (self.distance,), (self.luma,) = of["count"], of["distance"], of["luma"]
        self.a, self.b, self.v, self.r = of["a"], of["b"], of["v"], of["r"]
        self.color_signs, self.shape_signs = of["colour signs"], of["shape signs"]


@dataclass
class Half:
    """A Gaussian whose cell and colour are known, but not the signs of the colour."""

    k: int
    cell: int
    size: list[int]  # |y|, |a|, |b|
    color: list[int] = field(default_factory=list)  # with their signs

    def __post_init__(self) -> None:
        self.square = sum(value * value for value in self.size)
        self.h = int(min(self.square.bit_length() // 2, NUMBERS.most_h))
        self.u_bits = min(max(self.h - 1, 0), NUMBERS.most_u_bits)
        self.g = max(0, (self.k + 1) // 2)


def read_gaussians(header: Header, coder: Coder, part: bool) -> Iterator[Gaussian]:
    """The Gaussians of a payload; of a part of one, until EndError."""

    if not coder.payload:
        return
    models = Models()
    most = v3.most_gaussians(header, coder.payload)
    begun = min(coder.states) >= 65536
    coder.fetch(6)
    first = 28 - coder.take(6)
    coder.fetch(6)
    last = first - coder.take(6)
    v3.check_end(coder.past_end, part)
    refuse_unless(begun and last >= -4, "start")
    total = 0
    for k in range(first, last - 1, -1):
        columns, rows = (min(side // 2 ** max(0, (k + 1) // 2) + 5, 65536) for side in (header.width, header.height))
        number = coder.number(COLOUR, models.count)
        coder.fetch(number.rest)
        n = coder.rest(number)
        v3.check_end(coder.past_end, part)
        refuse_unless(part or total + n <= most, "count")
        t, mean = 0, columns * rows // max(n, 1)
        while mean >= 8:
            t, mean = t + 1, mean // 2
        now: Half | None = None
        for i in range(n + 1 if n > 0 else 0):
            if total == most:
                raise EndError
            before = now
            now, gaussian = read_turn(header, coder, models, (k, min(t, MOST_RAW), columns, rows), i < n, before)
            if gaussian is not None:
                v3.check_end(coder.past_end, part)
                yield gaussian
                total += 1
    refuse_unless(part or set(coder.states) == {65536}, "last states")
    refuse_unless(part or coder.queue == 0, "last bits")
    refuse_unless(part or not any(coder.payload[coder.at :]), "rest")


def read_turn(
    header: Header, coder: Coder, models: Models, of_class: tuple[int, int, int, int], more: bool, now: Half | None
) -> tuple[Half | None, Gaussian | None]:
    """Cell and colour of the next Gaussian, if there are more; shape and place of the one before, if there is one."""
    k, t, columns, rows = of_class
    distance = y = a = b = v = r = Number()
    if more:
        distance = coder.number(COLOUR, models.distance)
    if now:
        signs = coder.symbol(
            SHAPE, models.color_signs[sum(w * (x != 0) for w, x in zip((4, 2, 1), now.size, strict=True))]
        )
        now.color = [-x if signs & w else x for w, x in zip((4, 2, 1), now.size, strict=True)]
    if more:
        y = coder.number(COLOUR, models.luma)
    if now:
        v = coder.number(SHAPE, models.v[min(now.h, 7)])
    if more and not header.grey:
        a = coder.number(COLOUR, models.a[level(y)])
    if now and not header.upright:
        r = coder.number(SHAPE, models.r[min(now.h, 7)])
    if more and not header.grey:
        b = coder.number(COLOUR, models.b[level(a)])

    coder.fetch(v.rest + r.rest + (now.u_bits if now else 0) + (t if more else 0))
    px = py = u = shape_v = shape_r = 0
    if now:
        shape_v, shape_r, u = coder.rest(v), coder.rest(r), coder.take(now.u_bits)
        refuse_unless(shape_v <= NUMBERS.most_v * 2**now.h and shape_r <= NUMBERS.most_r * 2**now.h / 2, "shape")
        signs = coder.symbol(SHAPE, models.shape_signs[2 * (shape_v != 0) + (shape_r != 0)])
        shape_v, shape_r = -shape_v if signs & 2 else shape_v, -shape_r if signs & 1 else shape_r
        px, py = parts(now, u, shape_v, shape_r)
    low = coder.take(t) if more else 0

    coder.fetch(y.rest + a.rest + b.rest + distance.rest + px + py)
    following = gaussian = None
    if more:
        size = [coder.rest(number) for number in (y, a, b)]
        refuse_unless(any(size), "no colour")
        refuse_unless(max(size) <= NUMBERS.most_colour, "colour")
        cell = (now.cell if now else 0) + coder.rest(distance) * 2**t + low
        column, row = v3.deinterleave(cell)
        refuse_unless(cell < 2**32 and column < columns and row < rows, "cell")
        following = Half(k, cell, size)
    if now:
        gaussian = values(header, now, (u, shape_v, shape_r), (px, coder.take(px)), (py, coder.take(py)))
    return following, gaussian


def lg(x: int) -> int:
    """The logarithm to base two in sixteenths, linear between powers of two."""
    n = x.bit_length() - 1
    return 16 * n + 16 * x // 2**n - 16


def parts(half: Half, u: int, v: int, r: int) -> tuple[int, int]:
    """By how many bits the cell is divided along x and y."""
    h = half.h
    within = 8 * (2 * u + 1) // 2**half.u_bits - 8
    aspect = 46 * v // 2**h
    slant = lg(4**h + 4 * r * r) - 32 * h
    fineness = lg(half.square) + 32 * half.g - 17
    along = fineness + slant - max(16 * half.k + within + aspect, -56)
    across = fineness - max(16 * half.k + within - aspect, -56)
    px, py = (min(max(x // 32 + 1, 0), NUMBERS.most_part_bits) for x in (along, across))
    return px, py


def values(header: Header, half: Half, shape: tuple[int, int, int], x: tuple[int, int], y: tuple[int, int]) -> Gaussian:
    """From integers to what is drawn, as in version 3."""
    u, v, r = shape
    step, size, least = 2.0**-half.h, v3.size(half.k), round32(0.3)
    within = ((u + 0.5) / 2**half.u_bits - 0.5) * 0.34657359027997264
    l1 = max(size * v3.exponential(within + v * step), least)
    l3 = max(size * v3.exponential(within - v * step), least)
    l2 = r * (2 * step) * l3
    column, row = v3.deinterleave(half.cell)
    place_x, place_y = (
        (cell - 2 + (part + 0.5) / 2**bits) * 2**half.g for cell, (bits, part) in ((column, x), (row, y))
    )
    c = max(header.quantum / (size * 1.5), NUMBERS.least_colour_step)
    p, q, s = (
        value * c * axis
        for value, axis in zip(half.color, (0.57735026918962576, 0.70710678118654752, 0.40824829046386302), strict=True)
    )
    color = round32(p + q + s), round32(p - 2 * s), round32(p - q + s)
    return round32(place_x), round32(place_y), round32(l1), round32(l2), round32(l3), color


Codes = list[list[list[int]]]  # of strengths, by octave, row and column


def read_texture(header: Header, data: bytes) -> tuple[Codes, bytes]:
    """The codes, and what follows the texture part. No codes without texture."""
    if not header.texture:
        return [], data
    rows, columns = -(-header.height // CELL), -(-header.width // CELL)
    bits = (byte >> k & 1 for byte in data for k in range(7, -1, -1))
    read, codes = 0, [[[0] * columns for _ in range(rows)] for _ in range(OCTAVES)]
    for octave in range(OCTAVES):
        above = 0
        for row in range(rows):
            t = above
            for column in range(columns):
                ones = 0
                while (bit := next(bits, None)) == 1:
                    ones += 1
                refuse_unless(bit == 0, "texture")
                read += ones + 1
                t += -(ones + 1) // 2 if ones % 2 else ones // 2
                above = t if column == 0 else above
                codes[octave][row][column] = t + (codes[octave - 1][row][column] if octave > 0 else 0)
                refuse_unless(0 <= codes[octave][row][column] <= MOST_STRENGTH, "strength")
    refuse_unless(not any(next(bits) for _ in range(-read % 8)), "padding")
    return codes, data[-(-read // 8) :]


def mix(h: int) -> int:
    h %= 2**32
    h ^= h >> 16
    h = h * 0x7FEB352D % 2**32
    h ^= h >> 15
    h = h * 0x846CA68B % 2**32
    return h ^ h >> 16


def word(octave: int, i: int, j: int) -> int:
    """The byte of a place."""
    return mix(i + mix(mix(octave + 1) + j // 4)) // 256 ** (j % 4) % 256


def white(octave: int, i: int, j: int) -> float:
    """Noise, where a strength is 1."""
    return (2 * word(octave, i, j) - 255) / 148


@dataclass(frozen=True)
class Texture:
    """Codes, and where they are drawn: output pixels for a pixel, and where in these the picture's corner lies."""

    codes: Codes
    scale: tuple[float, float] = (1.0, 1.0)
    corner: tuple[float, float] = (0.0, 0.0)
    noise: Callable[[int, int, int], float] = white

    @property
    def shift(self) -> int:
        """Between an octave and its level."""
        twice = 2 * self.scale[0] * self.scale[1]
        return max(n for n in range(-7, 8) if 4.0**n <= twice)

    @property
    def top(self) -> int:
        """The highest level that has any."""
        octaves = [o for o, rows in enumerate(self.codes) if any(map(any, rows))]
        return max((o + self.shift for o in octaves), default=-1)

    def value(self, level: int, i: int, j: int) -> float:
        """What is added to a sample."""
        octave = level - self.shift
        if not 0 <= octave < len(self.codes):
            return 0.0
        places = 65536 // 2**level
        v = self.noise(octave, i % places, j % places)
        share = 0.75 if self.shift < 0 and level == 0 else 1.0
        at_x, at_y = (
            min(max(((n + 0.5) * 2**level - corner) / scale / CELL - 0.5, 0), cells - 1)
            for n, corner, scale, cells in zip(
                (i, j), self.corner, self.scale, (len(self.codes[0][0]), len(self.codes[0])), strict=True
            )
        )
        ends = [self.along_x(octave, row, at_x) for row in (math.floor(at_y), math.ceil(at_y))]
        return v * share * (ends[0] + (ends[1] - ends[0]) * (at_y - math.floor(at_y)))

    def along_x(self, octave: int, row: int, at: float) -> float:
        codes = self.codes[octave][row]
        left, right = (
            2 ** ((code - 1) / 2) / (2 * 255) if code else 0.0 for code in (codes[math.floor(at)], codes[math.ceil(at)])
        )
        return left + (right - left) * (at - math.floor(at))


@dataclass(frozen=True)
class File:
    """What a file says. Version 5 may have one state, and has other noise."""

    header: Header
    codes: Codes  # none without texture
    alpha: tuple[Header, bytes] | None  # the header as of a picture, and the payload
    payload: bytes
    states: int = 2
    noise: Callable[[int, int, int], float] = white

    def gaussians(self) -> list[Gaussian]:
        return list(read_gaussians(self.header, Coder(self.payload, self.states), part=False))

    def alpha_gaussians(self) -> list[Gaussian]:
        return (
            [] if self.alpha is None else list(read_gaussians(self.alpha[0], Coder(self.alpha[1], self.states), False))
        )

    def part(self, part: float) -> list[Gaussian]:
        """The Gaussians in a part, above 0 and below 1, of the payload."""
        coder = Coder(self.payload[: math.ceil(part * len(self.payload))], self.states)
        found = []
        try:
            for gaussian in read_gaussians(self.header, coder, part=True):
                found.append(gaussian)
        except EndError:
            pass
        except RefusedError:
            if not coder.past_end:
                raise
        return found


def read(data: bytes) -> File:
    header = v3.parse_header(data, NUMBERS)
    codes, rest = read_texture(header, data[18:])
    if not header.alpha:
        return File(header, codes, None, rest)
    refuse_unless(len(rest) >= 7, "alpha")
    code, level, size = struct.unpack_from(">HBI", rest)
    refuse_unless(len(rest) >= 7 + size, "alpha")
    quantum = v3.quantum_of(code)
    of_alpha = Header(True, False, header.width, header.height, quantum, (level, level, level), NUMBERS)
    return File(header, codes, (of_alpha, rest[7 : 7 + size]), rest[7 + size :])


def level_of(l1: float, l2: float, l3: float) -> int:
    xx = l1 * l1
    yy = l2 * l2 + l3 * l3
    minor = 2 * (xx * l3) * l3 / (xx + yy + math.sqrt((xx - yy) * (xx - yy) + 4 * (xx * l2) * l2))
    ratio = minor / (NARROWEST * NARROWEST)
    return max((level for level in range(1, TOP_LEVEL + 1) if 4**level <= ratio), default=0)


def on_level(gaussian: Gaussian, level: int) -> Gaussian:
    """In samples of its level, narrower and stronger. Places are counted from two samples before the picture."""
    x, y, l1, l2, l3, (red, green, blue) = gaussian
    if level == 0:
        return gaussian
    samples = 2**level
    p1, p2, p3, v = l1 / samples, l2 / samples, l3 / samples, (1 - 4.0**-level) / 4
    xx, xy, yy = p1 * p1 - v, p1 * p2, p2 * p2 + p3 * p3 - v
    q1 = math.sqrt(xx)
    q2 = xy / q1
    q3 = math.sqrt(xx * yy - xy * xy) / q1
    gain = round32(p1 * p3 / (q1 * q3))
    place = round32(x / samples + 2), round32(y / samples + 2)
    return *place, round32(q1), round32(q2), round32(q3), (gain * red, gain * green, gain * blue)


def pyramid(by_level: list[list[Gaussian]], texture: Texture, level: int, columns: range, rows: range) -> list[Plane]:
    """What a level comes to, from the highest down, in the part of it that is asked for: red, green and blue."""
    planes = [[[0.0] * len(columns) for _ in rows] for _ in range(3)]
    if level + 1 < len(by_level):
        above = [range(places[0] // 2 - 1, places[-1] // 2 + 2) for places in (columns, rows)]
        planes = [
            transposed(enlarged(transposed(enlarged(plane, above[0], columns)), above[1], rows))
            for plane in pyramid(by_level, texture, level + 1, *above)
        ]
    for y, j in enumerate(rows):
        for x, i in enumerate(columns):
            noise = texture.value(level, i, j)
            for plane in planes:
                plane[y][x] += noise
    first = 0.5 if level == 0 else 2.5
    for gaussian in by_level[level]:
        add(gaussian, [i + first for i in columns], [j + first for j in rows], planes)
    return planes


def enlarged(plane: Plane, coarse: range, places: range) -> Plane:
    """Along x: the samples in some places, from the coarse ones."""
    pairs = [(n // 2 - coarse[0], n // 2 + (1 if n % 2 else -1) - coarse[0]) for n in places]
    return [[0.75 * row[near] + 0.25 * row[far] for near, far in pairs] for row in plane]


def transposed(plane: Plane) -> Plane:
    return [list(column) for column in zip(*plane, strict=True)]


def add(gaussian: Gaussian, xs: list[float], ys: list[float], planes: list[Plane]) -> None:
    """One Gaussian at the samples whose centres are given."""
    x, y, l1, l2, l3, color = gaussian
    for j, at_y in enumerate(ys):
        for i, at_x in enumerate(xs):
            z1 = (at_x - x) / l1
            z2 = (at_y - y - l2 * z1) / l3
            sigma = (z1 * z1 + z2 * z2) / 2
            if sigma < CUTOFF:
                w = math.exp(-sigma) - math.exp(-CUTOFF)
                for plane, part in zip(planes, color, strict=True):
                    plane[j][i] += part * w


def draw(
    gaussians: list[Gaussian], texture: Texture, columns: range, rows: range, background: tuple[int, int, int]
) -> bytes:
    """Samples of the pixels in some columns and rows."""
    levels = [level_of(*gaussian[2:5]) for gaussian in gaussians]
    by_level: list[list[Gaussian]] = [[] for _ in range(max([0, texture.top, *levels]) + 1)]
    for gaussian, level in zip(gaussians, levels, strict=True):
        by_level[level].append(on_level(gaussian, level))
    planes = pyramid(by_level, texture, 0, columns, rows)
    samples = bytearray()
    for j in range(len(rows)):
        for i in range(len(columns)):
            values = [plane[j][i] + level / 255 for plane, level in zip(planes, background, strict=True)]
            samples += bytes(to_byte(value) for value in values)
    return bytes(samples)


def parse(data: bytes) -> tuple[Header, list[Gaussian]]:
    """The header and the Gaussians."""
    file = read(data)
    return file.header, file.gaussians()


def decode(data: bytes) -> tuple[int, int, bytes]:
    """Width, height and the samples: height rows of width pixels of red, green and blue, and alpha if there is any."""
    return decoded(read(data))


def view(data: bytes, scale: float, region: Region | None = None) -> tuple[int, int, bytes]:
    """Width, height and samples of a view."""
    return viewed(read(data), scale, region)


def decoded(file: File) -> tuple[int, int, bytes]:
    header, gaussians = file.header, file.gaussians()
    if file.alpha is not None:
        return viewed(file, 1)
    texture = Texture(file.codes, noise=file.noise)
    return header.width, header.height, draw(gaussians, texture, *pixels_of(header), header.background)


def pixels_of(header: Header) -> tuple[range, range]:
    return range(header.width), range(header.height)


def viewed(file: File, scale: float, region: Region | None = None) -> tuple[int, int, bytes]:
    header, gaussians = file.header, file.gaussians()
    region = region or (0, 0, header.width, header.height)
    width, height = view_size(region, scale)
    sx, sy = width / region[2], height / region[3]
    ox, oy = math.floor(region[0] * sx) % 65536, math.floor(region[1] * sy) % 65536
    shown = resized(gaussians, region, scale, CUTOFF, (ox, oy))
    texture = Texture(file.codes, (sx, sy), (ox - region[0] * sx, oy - region[1] * sy), file.noise)
    part = range(ox, ox + width), range(oy, oy + height)
    pixels = draw(shown, texture, *part, header.background)
    if file.alpha is None:
        return width, height, pixels
    shown = resized(file.alpha_gaussians(), region, scale, CUTOFF, (ox, oy))
    grey = draw(shown, Texture([]), *part, file.alpha[0].background)
    samples = bytearray()
    for at in range(0, len(pixels), 3):
        samples += pixels[at : at + 3] + grey[at : at + 1]
    return width, height, bytes(samples)
