"""JPEG XL, with a parser of its header: pillow-jxl-plugin decodes all pixels on opening, some wrongly."""

from __future__ import annotations

import re

from sgmethod.io.chunks import boxes
from sgmethod.io.kinds.format import Format, Header

BARE, IN_BOXES = b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n"  # how a codestream alone begins, and one in boxes
# ISO/IEC 18181-1: two bits choose a pair: the width in bits of the number that follows, and the offset added to it.
SIDES = ((9, 1), (13, 1), (18, 1), (30, 1))
DEPTHS = ((0, 8), (0, 10), (0, 12), (6, 1))
RATIOS = ((1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))


def header_of(data: bytes) -> Header:
    """Parse the header of a JPEG XL file (ISO/IEC 18181-1, annex D). Raises ValueError."""
    if data.startswith(IN_BOXES):  # boxes: jxlp is a part with its number in front, jxlc the whole codestream
        starts = {b"jxlp": 4, b"jxlc": 0}
        parts = (data[at + starts[kind] : end] for kind, at, end in boxes(data) if kind in starts)
        data = b"".join(part[:64] for part in parts)
    bits = _Bits(data[2:64])
    height, width = bits.size()
    orientation, is_animated, depth = 1, False, 8
    if not bits.take(1):
        if bits.take(1):
            orientation = 1 + bits.take(3)
            if bits.take(1):
                bits.size()
            if bits.take(1):
                raise ValueError("it has a preview")
            is_animated = bool(bits.take(1))
        if not is_animated:  # else the animation's header is next
            depth = 32 if bits.take(1) else bits.choice(DEPTHS)
    return Header(*((height, width) if orientation >= 5 else (width, height)), is_animated, depth)


class _Bits:
    """Reader of a JPEG XL header's fields, lowest bit first."""

    def __init__(self, data: bytes) -> None:
        self.value, self.count = int.from_bytes(data, "little"), 8 * len(data)

    def take(self, count: int) -> int:
        if count > self.count:
            raise ValueError("its header is truncated")
        taken = self.value & ((1 << count) - 1)
        self.value >>= count
        self.count -= count
        return taken

    def choice(self, of: tuple[tuple[int, int], ...]) -> int:
        count, minimum = of[self.take(2)]
        return minimum + self.take(count)

    def size(self) -> tuple[int, int]:
        """Read height and width."""
        is_small = self.take(1)
        height, ratio = self._side(is_small), self.take(3)
        if ratio == 0:
            return height, self._side(is_small)
        over, under = RATIOS[ratio - 1]
        return height, height * over // under

    def _side(self, is_small: int) -> int:
        return 8 * (1 + self.take(5)) if is_small else self.choice(SIDES)


FORMAT = Format(
    "JPEG XL",
    (".jxl",),
    ("pillow_jxl.JpegXLImagePlugin", "JXLImageFile"),
    re.escape(BARE) + b"|" + re.escape(IN_BOXES),
    extra="jxl",
    lists_tiles=False,
    turns=True,  # unless it reconstructs a JPEG
    threads=("pillow_jxl.JpegXLImagePlugin", "DECODE_THREADS", 0),
    header=header_of,
)
