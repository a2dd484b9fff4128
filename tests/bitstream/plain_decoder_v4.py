"""A second decoder of version 4, written from docs/format.md alone: plain Python, slow, sharing nothing with sgmethod.

What is the same in all versions, or in version 3, comes from the decoders of versions 1 and 3.
"""

from __future__ import annotations

import math
import re

from tests.bitstream import plain_decoder_v3 as v3
from tests.bitstream.plain_decoder import Region, resized, round32, to_byte, view_size
from tests.bitstream.plain_decoder_v3 import CUTOFF, FORMAT, Gaussian, Header, Numbers

Plane = list[list[float]]  # rows of one colour's samples, in a part of a level


def numbers_in_the_text() -> dict[str, float]:
    """The table at the head of the section on version 4."""
    section = FORMAT.read_text("utf-8").split("\n# Version 4 (draft)\n")[1].split("\n## ")[0]
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
)
NARROWEST, TOP_LEVEL = TEXT["narrowest"], int(TEXT["top level"])


def parse(data: bytes) -> tuple[Header, list[Gaussian]]:
    """The header and the Gaussians."""
    return v3.parse(data, NUMBERS)


def parse_part(data: bytes, part: float) -> tuple[Header, list[Gaussian]]:
    """The header, and the Gaussians in a part, above 0 and below 1, of the payload."""
    return v3.parse_part(data, part, NUMBERS)


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


def pyramid(by_level: list[list[Gaussian]], level: int, columns: range, rows: range) -> list[Plane]:
    """What a level comes to, from the highest down, in the part of it that is asked for: red, green and blue."""
    planes = [[[0.0] * len(columns) for _ in rows] for _ in range(3)]
    if level + 1 < len(by_level):
        above = [range(places[0] // 2 - 1, places[-1] // 2 + 2) for places in (columns, rows)]
        planes = [
            transposed(enlarged(transposed(enlarged(plane, above[0], columns)), above[1], rows))
            for plane in pyramid(by_level, level + 1, *above)
        ]
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


def draw(gaussians: list[Gaussian], columns: range, rows: range, background: tuple[int, int, int]) -> bytes:
    """Samples of the pixels in some columns and rows."""
    levels = [level_of(*gaussian[2:5]) for gaussian in gaussians]
    by_level: list[list[Gaussian]] = [[] for _ in range(max(levels, default=0) + 1)]
    for gaussian, level in zip(gaussians, levels, strict=True):
        by_level[level].append(on_level(gaussian, level))
    planes = pyramid(by_level, 0, columns, rows)
    samples = bytearray()
    for j in range(len(rows)):
        for i in range(len(columns)):
            values = [plane[j][i] + level / 255 for plane, level in zip(planes, background, strict=True)]
            samples += bytes(to_byte(value) for value in values)
    return bytes(samples)


def decode(data: bytes) -> tuple[int, int, bytes]:
    """Width, height and the samples: height rows of width pixels of red, green and blue."""
    header, gaussians = parse(data)
    return header.width, header.height, draw(gaussians, range(header.width), range(header.height), header.background)


def view(data: bytes, scale: float, region: Region | None = None) -> tuple[int, int, bytes]:
    """Width, height and samples of a view."""
    header, gaussians = parse(data)
    region = region or (0, 0, header.width, header.height)
    width, height = view_size(region, scale)
    sx, sy = width / region[2], height / region[3]
    ox, oy = math.floor(region[0] * sx) % 65536, math.floor(region[1] * sy) % 65536
    shown = resized(gaussians, region, scale, CUTOFF, (ox, oy))
    return width, height, draw(shown, range(ox, ox + width), range(oy, oy + height), header.background)
