"""The ends of what integers a payload may hold, which no encoder reaches, in both decoders.

A payload with chosen integers is written by the plain decoder, whose entropy decoder is replaced by one that says them.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from sgmethod.bitstream.v2 import StreamV2
from tests.bitstream import plain_decoder_v2
from tests.bitstream.plain_decoder_v2 import (
    MOST_COLOUR,
    MOST_EXPONENT,
    MOST_R,
    MOST_V,
    Coder,
    Header,
    Model,
    Number,
    RefusedError,
)
from tests.bitstream.test_format_v2 import rows


@dataclass(frozen=True)
class Known(Number):
    """A number whose rest is known already."""

    value: int = 0


class Scribe(Coder):
    """Stands where the plain decoder has its entropy decoder: says given values, then zeros, and writes them down."""

    def __init__(self, values: list[int]) -> None:
        super().__init__(b"", 2)
        self.payload = bytes(64)
        self.values = values
        self.steps: list[
            tuple[int, int, int]
        ] = []  # where a symbol begins, its share, its state; or bits fetched, 0, 0
        self.bits: list[int] = []
        self.states = [65536, 65536]

    @property
    def is_past_end(self) -> bool:
        return False

    def next(self) -> int:
        return self.values.pop(0) if self.values else 0

    def write(self, which: int, model: Model, symbol: int) -> None:
        self.steps.append((model.edge(symbol), model.edge(symbol + 1) - model.edge(symbol), which))
        model.adapt(symbol)

    def write_bits(self, value: int, count: int) -> None:
        self.bits += [value >> k & 1 for k in range(count)]

    def symbol(self, which: int, model: Model) -> int:
        symbol = self.next()
        self.write(which, model, symbol)
        return symbol

    def fetch(self, count: int) -> None:
        self.steps.append((count, 0, 0))

    def take(self, count: int) -> int:
        value = self.next()
        self.write_bits(value, count)
        return value

    def number(self, which: int, model: Model) -> Number:
        value = self.next()
        n = value.bit_length() - 1
        if value < 4:
            self.write(which, model, value)
            return Known(value, 0, value, value)
        if value < 192:
            symbol = 2 * n + (value >> n - 1) % 2
            self.write(which, model, symbol)
            return Known(value >> n - 1 << n - 1, n - 1, symbol, value)
        self.write(which, model, 15)
        for part, count in (n, 5), (value - 2**n, n):
            self.fetch(count)
            self.write_bits(part, count)
        return Known(value, 0, 15, value)

    def rest(self, number: Number) -> int:
        assert isinstance(number, Known)
        self.write_bits(number.value - number.least, number.rest)
        return number.value

    def written(self) -> bytes:
        """The payload: of each state, the last of the steps is coded first."""
        states, words = [65536, 65536], [b""] * len(self.steps)
        for i, (low, share, which) in reversed(list(enumerate(self.steps))):
            if share == 0:
                continue
            if states[which] >= share << 17:
                words[i] = (states[which] % 65536).to_bytes(2, "little")
                states[which] >>= 16
            states[which] = (states[which] // share << 15) + states[which] % share + low
        raw = sum(bit << k for k, bit in enumerate(self.bits)).to_bytes(len(self.bits) // 8 + 8, "little")
        queued = at = 0
        for i, (count, share, _) in enumerate(self.steps):
            if share == 0:
                more = (max(count - queued, 0) + 7) // 8
                words[i] = raw[at : at + more]
                queued, at = queued + 8 * more - count, at + more
        return b"".join(state.to_bytes(4, "little") for state in states) + b"".join(words)


def one_gaussian(y: int, v: int, r: int) -> bytes:
    """A file with one Gaussian of size 1 in the midst of 9 by 9 pixels; the integers may be out of their range."""
    # First and last class, number in it; distance in steps of 2^5, y, a, b, the rest of the distance; signs, v, r.
    scribe = Scribe([28, 0, 1, 3, y, 0, 0, 12, 0, v, r])
    header = Header(False, False, False, 9, 9, 1.0, (0, 0, 0))
    refused = b""
    try:
        list(plain_decoder_v2.read_payload(header, scribe, is_part=False))
    except RefusedError:
        refused = bytes(16)  # so that the payload does not end there
    payload = scribe.written() + refused
    stream = StreamV2(9, 9, header.quantum, header.background, header.grey, header.upright, payload)
    return container.serialise(stream)


# Steps of v and r are no finer than this, however long the colour is.
PER_STEP = 2**MOST_EXPONENT
MOST_R_STEPS = MOST_R // 2


@pytest.mark.parametrize(
    ("within", "beyond"),
    [
        ((MOST_COLOUR, 0, 0), (MOST_COLOUR + 1, 0, 0)),
        ((1, MOST_V, 0), (1, MOST_V + 1, 0)),
        ((1, 0, MOST_R_STEPS), (1, 0, MOST_R_STEPS + 1)),
        ((PER_STEP, MOST_V * PER_STEP, 0), (PER_STEP, MOST_V * PER_STEP + 1, 0)),
        ((MOST_COLOUR, MOST_V * PER_STEP, 0), (MOST_COLOUR, MOST_V * PER_STEP + 1, 0)),
        ((MOST_COLOUR, 7, MOST_R_STEPS * PER_STEP), (MOST_COLOUR, 7, MOST_R_STEPS * PER_STEP + 1)),
    ],
)
def test_limits_of_the_integers(within: tuple[int, int, int], beyond: tuple[int, int, int]) -> None:
    data = one_gaussian(*within)
    found = rows(container.parse(data).gaussians())
    assert len(found) == 1
    assert found == plain_decoder_v2.read(data).gaussians()
    data = one_gaussian(*beyond)
    with pytest.raises(BitstreamError, match=r"(shape|colour) is out of range"):
        container.parse(data).gaussians()
    with pytest.raises(RefusedError, match=r"shape|colour"):
        plain_decoder_v2.read(data).gaussians()
