"""Files of version 2 that a decoder must refuse, most of them for one reason alone: without that check, they decode.

Most hold one grey Gaussian in a short file. The writer codes what no encoder would.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

from sgmethod.bitstream.container import with_checksum
from sgmethod.bitstream.v2 import StreamV2
from tests.bitstream import plain_decoder_v2 as plain

Number = tuple[int, int]  # the rest of a number, and its bits


class Writer:
    """The mirror of plain.Coder, with one state."""

    def __init__(self) -> None:
        self.steps: list[tuple[int, int] | int] = []  # a symbol's edge and share, or a number of raw bits to fetch
        self.raw, self.raw_bits = 0, 0

    def symbol(self, model: plain.Model, symbol: int) -> None:
        low = model.edge(symbol)
        self.steps.append((low, model.edge(symbol + 1) - low))
        model.adapt(symbol)

    def fetch(self, count: int) -> None:
        self.steps.append(count)

    def bits(self, value: int, count: int) -> None:
        self.raw |= value << self.raw_bits
        self.raw_bits += count

    def number(self, model: plain.Model, value: int) -> Number:
        """The rest is for the caller to write."""
        n = max(value.bit_length() - 2, 0)
        s = value if value < 4 else 2 * (n + 1) + (value >> n) % 2
        self.symbol(model, min(s, 15))
        if s < 15:
            return value % 2**n, n
        n += 1
        self.fetch(5)
        self.bits(n, 5)
        self.fetch(n)
        self.bits(value - 2**n, n)
        return 0, 0

    def finish(self, last_state: int, low_start: bool) -> bytes:
        """The payload. low_start: its state is below 65536, though all that follows is right."""
        words: dict[int, int] = {}
        state = last_state
        first = next(at for at, step in enumerate(self.steps) if not isinstance(step, int))
        for at, step in reversed(list(enumerate(self.steps))):
            if isinstance(step, int):
                continue
            low, share = step
            if state >= share << 17 or (low_start and at == first):
                words[at] = state % 65536
                state //= 65536
            state = state // share * 32768 + state % share + low
        found, left, raw = bytearray(state.to_bytes(4, "little")), 0, self.raw
        for at, step in enumerate(self.steps):
            if at in words:
                found += words[at].to_bytes(2, "little")
            if isinstance(step, int):
                while left < step:
                    found.append(raw % 256)
                    raw, left = raw // 256, left + 8
                left -= step
        return bytes(found)


@dataclass(frozen=True)
class One:
    """A Gaussian in each class from 0, or from -4, to the last, and what is odd about its file."""

    side: int = 4  # of the picture
    count: int = 1  # equal Gaussians in place of the one
    last_class: int = 0
    cell: int = 12
    y: int = 1
    v: int = 0
    r: int = 0
    last_state: int = 65536
    low_start: bool = False
    left: int = 0  # raw bits behind the last

    @property
    def stream(self) -> StreamV2:
        return StreamV2(self.side, self.side, 0.5, (123,) * 3, True, False, self.payload, is_short=True)

    @property
    def file(self) -> bytes:
        return with_checksum(b"\xd3\xc2" + self.stream.body())

    @property
    def payload(self) -> bytes:
        writer, models = Writer(), plain.Models()
        first = 0 if self.last_class >= -4 else -4
        for value in (28 - first, first - self.last_class):
            writer.fetch(6)
            writer.bits(value, 6)
        header = plain.Header(True, False, True, self.side, self.side, 0.5, (123,) * 3)
        for k in range(first, self.last_class - 1, -1):
            rest = writer.number(models.count, self.count)
            writer.fetch(rest[1])
            writer.bits(*rest)
            of_class = plain.size_class(header, k, self.count)
            for i in range(self.count + 1):
                self._turn(writer, models, of_class, i < self.count, i > 0)
        writer.bits(self.left, 8)
        return writer.finish(self.last_state, self.low_start)

    def _turn(
        self, writer: Writer, models: plain.Models, of_class: plain.SizeClass, has_next: bool, has_now: bool
    ) -> None:
        one = plain.Integers(of_class, self.cell, [self.y, 0, 0], [0, self.v, self.r])
        distance = y = v = r = (0, 0)
        far, low = divmod(self.cell if not has_now else 0, 2**of_class.t)
        if has_next:
            distance = writer.number(models.distance, far)
        if has_now:
            writer.symbol(models.colour_signs[4 * (self.y != 0)], 0)
        if has_next:
            y = writer.number(models.luma, self.y)
        if has_now:
            v = writer.number(models.v[one.bucket], self.v)
            r = writer.number(models.r[one.bucket], self.r)
        t = of_class.t if has_next else 0
        writer.fetch(v[1] + r[1] + (one.u_bits if has_now else 0) + t)
        parts = (0, 0)
        if has_now:
            for rest in (v, r, (0, one.u_bits)):
                writer.bits(*rest)
            writer.symbol(models.shape_signs[2 * (self.v != 0) + (self.r != 0)], 0)
            parts = plain.parts_of(one) if self.y else (0, 0)
        writer.bits(low if has_next else 0, t)
        writer.fetch(y[1] + distance[1] + sum(parts))
        for rest in (y, distance, (0, sum(parts))):
            writer.bits(*rest)


MANY = One(side=40, count=1200)


def refused_early() -> tuple[bytes, int]:
    """A file, and how many bytes of its payload are enough to refuse it."""
    odd = One(v=9)
    stream = replace(odd.stream, payload=odd.payload + b"\0")
    return with_body(stream.body()), len(odd.payload)


def with_body(body: bytes) -> bytes:
    return with_checksum(b"\xd3\xc2" + body)


def refused() -> dict[str, bytes]:
    """Files by the reason to refuse them."""
    plainest, fine = One(), One(y=200)
    good = plainest.file
    header = len(replace(plainest.stream, payload=b"").body())
    body, payload = good[2 : 2 + header], fine.payload
    assert payload[-1] == 0
    textured = bytes([body[0] | 4 << 3]) + body[1:]
    alpha = replace(plainest.stream, payload=plainest.payload + b"\0")
    with_alpha = replace(plainest.stream, payload=b"", alpha=alpha)
    return {
        "signature": with_checksum(b"\xd4" + good[1:-1]),
        "version": with_checksum(b"\xd3\xc3" + good[2:-1]),
        "checksum": good[:-1] + bytes([good[-1] ^ 1]),
        "nothing between signature and checksum": b"\xd3\xc2" + zlib.crc32(b"\xd3\xc2").to_bytes(4, "big")[-1:],
        "the header does not end": with_body(body[:-1]),
        "a one bit fills the header": with_body(body[:-1] + bytes([body[-1] | 1]) + plainest.payload),
        "the texture does not end": with_body(textured + b"\xff"),
        "a strength below 0": with_body(textured + b"\x80"),
        "a strength above 15": with_body(textured + b"\xff\xff\xff\xff\x00"),
        "a one bit fills the texture": with_body(textured + b"\x20"),
        "the payload of alpha does not end": with_body(with_alpha.body()[:-1]),
        "a state below 65536": One(low_start=True).file,
        "last class below -4": One(last_class=-5).file,
        "more Gaussians than pixels": One(side=1, count=2).file,
        "more Gaussians than pixels, but not in one class": One(side=1, last_class=-1).file,
        "more Gaussians than 8 for each byte and 64 more": MANY.file,
        "|v| above its limit": One(v=9).file,
        "|r| above its limit": One(r=2049).file,
        "no colour": One(y=0).file,
        "a colour above its limit": One(y=2**22 + 1).file,
        "a column outside the grid": One(cell=0b1000001).file,
        "a row outside the grid": One(cell=0b10000010).file,
        "more bytes read than there are, all zero": with_body(body + payload[:-1]),
        "last state": One(last_state=65537).file,
        "a one bit in the queue": One(y=4, left=1).file,
        "a byte that is not read": with_body(body + plainest.payload + b"\1"),
    }
