"""Colours and aperture of the picture that an AVIF shows: Pillow gives neither, and pillow-heif reads no AVIF.

That is the file's primary item; others, such as a gain map, may have colours of their own. Containers are defined in
ISO/IEC 14496-12 and 23008-12, what is in an item in the AV1 Bitstream Specification, 5.3 to 5.5. Functions raise
ValueError for a damaged file.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import islice

from sgmethod.io.chunks import MAX_BOXES, Box, boxes

Content = tuple[bytes, bytes]  # kind and content of a box
MAX_LISTS = 4  # boxes ipma: each has another version, or other flags
ABSENT = bytes(16)  # the content of a box that lists nothing
HEADER_BYTES = 4096  # of a picture: AV1's sequence header is among the first
SEQUENCE_HEADER = 1  # kind of an OBU


def code_points(data: bytes) -> tuple[int, int] | None:
    """Primaries and transfer (H.273) that the container states, or else the picture itself; None if neither does."""
    picture = _Primary(data)
    for kind, content in picture.properties():
        if kind == b"colr" and content[:4] == b"nclx":
            read = _Reader(content[4:])
            return read.number(2), read.number(2)
    return _colours(_sequence_header(picture.beginning()))


def clean_aperture(data: bytes, width: int, height: int) -> Box | None:
    """Visible part of the picture; None if there is none, or it is invalid.

    ISO/IEC 14496-12, 12.1.4: width, height, and the offset of the part's centre from the picture's, all as fractions.
    """
    content = next((content for kind, content in _Primary(data).properties() if kind == b"clap"), b"")
    numbers = struct.unpack(">iIiIiIiI", content) if len(content) == 32 else (0,) * 8
    if 0 in numbers[1::2]:
        return None
    w, h, across, down = map(Fraction, numbers[::2], numbers[1::2])
    x, y = int((width - w) / 2 + across), int((height - h) / 2 + down)
    right, bottom = x + int(w), y + int(h)
    return (x, y, right, bottom) if 0 <= x < right <= width and 0 <= y < bottom <= height else None


class _Reader:
    """Reader of numbers, highest bit first."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0  # in bits

    def bits(self, count: int) -> int:
        """Read a number of `count` bits."""
        start, self._at = self._at, self._at + count
        if self._at > 8 * len(self._data):
            raise ValueError("a header is truncated")
        end = -(-self._at // 8)
        return int.from_bytes(self._data[start // 8 : end], "big") >> (8 * end - self._at) & ((1 << count) - 1)

    def number(self, size: int) -> int:
        """Read a number of `size` bytes."""
        return self.bits(8 * size)

    def skip(self, size: int) -> None:
        """Skip `size` bytes."""
        self._at += 8 * size


def _children(content: bytes) -> Iterator[Content]:
    return ((kind, content[start:end]) for kind, start, end in boxes(content))


class _Primary:
    """The primary item of a file: what its box meta says of it."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        meta = next((data[start + 4 : end] for kind, start, end in boxes(data) if kind == b"meta"), b"")
        self._boxes = dict(_children(meta))
        read, version = self._full(b"pitm")
        self._item = read.number(2 if version == 0 else 4)

    def _full(self, kind: bytes) -> tuple[_Reader, int]:
        """Begin to read a box that begins with a version and flags; return the version too."""
        read = _Reader(self._boxes.get(kind, ABSENT))
        return read, read.number(4) >> 24

    def properties(self) -> list[Content]:
        """Return the item's properties."""
        parts = list(_children(self._boxes.get(b"iprp", b"")))
        stored = [one for kind, content in parts if kind == b"ipco" for one in _children(content)]
        lists = (self._places(_Reader(content)) for kind, content in parts if kind == b"ipma")
        places = next(filter(None, islice(lists, MAX_LISTS)), [])
        return [stored[place - 1] for place in places if 0 < place <= len(stored)]  # 0 stands for none

    def _places(self, read: _Reader) -> list[int]:
        """Read the places of the item's properties, counted from 1."""
        version, size = read.number(1), 8 * (1 + read.number(3) % 2)
        for _ in range(min(read.number(4), MAX_BOXES)):
            item, count = read.number(2 if version == 0 else 4), read.number(1)
            if item == self._item:
                return [read.bits(size) % (1 << size - 1) for _ in range(count)]  # the first bit: must be understood
            read.skip(count * size // 8)
        return []

    def beginning(self) -> bytes:
        """Return the item's first bytes; of a grid, those of its first tile."""
        item, (_, version) = self._item, self._full(b"iref")
        size = 2 if version == 0 else 4
        for kind, content in _children(self._boxes.get(b"iref", ABSENT)[4:]):
            read = _Reader(content)
            if kind == b"dimg" and read.number(size) == item and read.number(2):
                item = read.number(size)
                break
        return self._stored(item)

    def _stored(self, item: int) -> bytes:
        """Return the first bytes of any item (ISO/IEC 14496-12, 8.11.3)."""
        read, version = self._full(b"iloc")
        start_size, length_size, base_size, index_size = (read.bits(4) for _ in range(4))
        if version == 0:
            index_size = 0
        size = 2 if version < 2 else 4
        for _ in range(min(read.number(size), MAX_BOXES)):
            found = read.number(size)
            within = read.number(2) % 16 if version else 0  # 0: the file, 1: the box idat
            read.skip(2)
            base, parts = read.number(base_size), read.number(2)
            if found == item and parts and within < 2:
                read.skip(index_size)
                start, length = base + read.number(start_size), read.number(length_size)
                whole = self._boxes.get(b"idat", b"") if within else self._data
                return whole[start : start + min(length or HEADER_BYTES, HEADER_BYTES)]
            read.skip(parts * (index_size + start_size + length_size))
        return b""


def _sequence_header(data: bytes) -> bytes:
    """Find the sequence header in an AV1 bitstream; empty if there is none."""
    at = 0
    while at < len(data):
        kind, has_extension, has_size = data[at] >> 3 & 15, data[at] >> 2 & 1, data[at] >> 1 & 1
        at += 1 + has_extension
        size, place = 0 if has_size else len(data), 0
        while has_size and at < len(data):
            size |= (data[at] & 127) << place
            at, place = at + 1, place + 7
            if data[at - 1] < 128:
                break
        if kind == SEQUENCE_HEADER:
            return data[at : at + size]
        at += size
    return b""


def _colours(header: bytes) -> tuple[int, int] | None:
    """Primaries and transfer in AV1's sequence header (5.5.1 to 5.5.5 of the specification), if it states them."""
    if not header:
        return None
    bits = _Reader(header).bits
    profile, _, is_short = bits(3), bits(1), bits(1)  # reduced_still_picture_header
    if is_short:
        bits(5)
    else:
        _skip_operating_points(bits)
    width, height = bits(4), bits(4)
    bits(width + height + 2)
    if not is_short and bits(1):  # numbers of frames
        bits(7)
    bits(3)
    if not is_short:
        bits(4)
        has_order = bits(1)
        bits(2 * has_order)
        screen = 1 if bits(1) else bits(1)  # seq_force_screen_content_tools
        if screen and not bits(1):
            bits(1)
        bits(3 * has_order)
    bits(3)
    is_deep = bits(1)
    if profile == 2 and is_deep:
        bits(1)
    if profile != 1:
        bits(1)  # grey
    return (bits(8), bits(8)) if bits(1) else None


def _skip_operating_points(bits: Callable[[int], int]) -> None:
    """Skip from the time code to the last operating point."""
    delay = 0  # bits of a number
    if bits(1):  # timing_info
        bits(32), bits(32)
        if bits(1):
            zeros = 0
            while not bits(1):
                zeros += 1
            bits(zeros)
        if bits(1):  # decoder_model_info
            delay = bits(5) + 1
            bits(32 + 5 + 5)
    has_initial = bits(1)
    for _ in range(bits(5) + 1):
        bits(12)
        if bits(5) > 7:
            bits(1)
        if delay and bits(1):
            bits(2 * delay + 1)
        if has_initial and bits(1):
            bits(4)
