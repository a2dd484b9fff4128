"""Files of version 2 from integers: the plain decoder, backwards. It writes what no other encoder does, too."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import groupby
from typing import TypeAlias

from tests.bitstream.plain_decoder_v2 import (
    COLOUR,
    Coder,
    Header,
    Integers,
    Map,
    Model,
    Models,
    Part,
    RefusedError,
    SizeClass,
    edges_of,
    gaussian_of,
    parts_of,
    read_turn,
    size_class,
)

Pair: TypeAlias = tuple[int, int]
Triple: TypeAlias = tuple[int, int, int]


@dataclass(frozen=True)
class Wanted:
    """A Gaussian in integers, but those that follow from the others."""

    k: int
    cell: Pair = (2, 2)  # column and row
    colour: Triple = (1, 0, 0)  # y, a, b
    shape: Triple = (0, 0, 0)  # u, v, r
    place: Pair = (0, 0)  # X, Y

    def integers(self, of_class: SizeClass) -> Integers:
        found = Integers(of_class, NO_PART, list(self.colour), list(self.shape), list(self.cell), list(self.place))
        found.parts = parts_of(found) if any(self.colour) else (0, 0)
        return found


NO_PART = Part(0, 0, 0, 0, 0, 0, 0, 0, 0)


class Recorder(Coder):
    """A coder that "reads" what it is told to, and remembers it."""

    def __init__(self, states: int) -> None:
        super().__init__(b"", 0)
        self.lanes = states
        self.symbols: deque[int] = deque()  # to come
        self.values: deque[int] = deque()  # of raw bits to come
        self.steps: list[tuple[int, int, int] | int] = []  # a symbol's state, edge and share; or bits that are fetched
        self.taken: list[tuple[int, int]] = []  # value and bits

    def tell_number(self, value: int) -> None:
        """What the next number is, but for its rest."""
        top = value.bit_length() - 1
        if value < 4:
            self.symbols.append(value)
        elif value < 192:
            self.symbols.append(2 * top + (value >> top - 1) % 2)
        else:
            self.symbols.append(15)
            self.tell(top, 5)
            self.tell(value, top)

    def tell_rest(self, value: int) -> None:
        if 4 <= value < 192:
            self.tell(value, value.bit_length() - 2)

    def tell(self, value: int, bits: int) -> None:
        """What the lowest bits of a value are, which are taken next."""
        if bits:
            self.values.append(value % 2**bits)

    def symbol(self, which: int, *models: Model) -> int:
        symbol = self.symbols.popleft()
        low, high = edges_of(models)[symbol : symbol + 2]
        self.steps.append((which % self.lanes, low, high - low))
        for model in models:
            model.adapt(symbol)
        return symbol

    def fetch(self, count: int) -> None:
        self.steps.append(count)

    def take(self, count: int) -> int:
        value = self.values.popleft() if count else 0
        self.taken.append((value, count))
        return value

    def finish(self, last: int = 65536, is_early: bool = False) -> bytes:
        """The payload. rANS codes backwards, from the last state. is_early: the first reads too few bytes before it."""
        states, words = [last] * self.lanes, []
        first = next(i for i, step in enumerate(self.steps) if not isinstance(step, int))
        for i, step in reversed([*enumerate(self.steps)]):
            word = b""
            if not isinstance(step, int):
                which, low, share = step
                state = states[which]
                if state >= share << 17 or (is_early and i == first):
                    word, state = (state % 65536).to_bytes(2, "little"), state >> 16
                states[which] = (state // share << 15) + state % share + low
            words.append(word)
        raw, at = 0, 0
        for value, count in self.taken:
            raw, at = raw | value << at, at + count
        queue = iter(raw.to_bytes(at // 8 + 9, "little"))
        found, queued = b"".join(state.to_bytes(4, "little") for state in states), 0
        for step, word in zip(self.steps, reversed(words), strict=True):
            found += word
            if isinstance(step, int):
                while queued < step:
                    found, queued = found + bytes([next(queue)]), queued + 8
                queued -= step
        return found


def write_payload(
    header: Header,
    wanted: list[Wanted],
    *,
    last_state: int = 65536,
    is_early: bool = False,
    stray: int = 0,
    promised: int = 0,
) -> bytes:
    """The payload of these Gaussians. Of those that a decoder refuses it ends after what makes it refuse them.

    The options make what is to be refused: those of Recorder.finish(), stray bits in the queue, and a first class that
    promises so many Gaussians and has none.
    """
    if not wanted:
        return b""
    coder, models, the_map = Recorder(1 if header.is_short else 2), Models(), Map(header.width, header.height)
    first, last = (pick(one.k for one in wanted) for pick in (max, min))
    for number in (28 - first, first - last):
        coder.tell(number, 6)
        coder.fetch(6)
        coder.take(6)
    for k in range(first, last - 1, -1):
        of_k = [one for one in wanted if one.k == k]
        coder.tell_number(promised or len(of_k))
        coder.tell_rest(promised or len(of_k))
        count = coder.number(COLOUR, models.count)
        coder.fetch(count.rest)
        coder.rest(count)
        if promised:
            break
        if not of_k:
            continue
        try:
            found = write_class(header, coder, models, size_class(header, k, len(of_k), the_map), of_k)
        except RefusedError:
            break
        for one in [] if header.is_short else found:
            the_map.add(one, gaussian_of(header, one))
    coder.taken.append((2**stray - 1, stray))
    return coder.finish(last_state, is_early)


def write_class(
    header: Header, coder: Recorder, models: Models, of_class: SizeClass, wanted: list[Wanted]
) -> list[Integers]:
    """Its Gaussians as a decoder reads them."""
    blocks, halvings = of_class.blocks, of_class.blocks.level - of_class.g
    found: list[Integers] = []

    def block_of(one: Integers) -> int:
        column, row = ((cell - 2 >> halvings) + 2 for cell in one.cell)
        return row * blocks.columns + column

    def number_of(one: Integers) -> int:
        """Of the part of the current block in which a Gaussian is."""
        level = blocks.levels[-1]
        i, j = level // 2, (level + 1) // 2
        x, y = (
            ((cell - 2) % 2**halvings << bits | at) * 2**part // 2 ** (halvings + bits)
            for cell, at, bits, part in zip(one.cell, one.place, one.parts, (i, j), strict=True)
        )
        even, odd = (x, y) if i == j else (y, x)
        return sum((even >> bit & 1) << 2 * bit | (odd >> bit & 1) << 2 * bit + 1 for bit in range(16))

    now = told = None  # as it is read, and what it is
    integers = sorted((one.integers(of_class) for one in wanted), key=block_of)
    for block, of_block in groupby(integers, block_of):
        while len(blocks.levels) < min(block + 1, blocks.rows * blocks.columns):
            blocks.go_on()
        for one in sorted(of_block, key=number_of):
            number = blocks.first + number_of(one) if len(blocks.levels) > block else blocks.parts
            tell_turn(header, coder, one, number - (now.part.number if now else 0), now, told)
            now, told = read_turn(header, coder, models, of_class, True, now), one
            assert now
            found.append(now)
    tell_turn(header, coder, None, 0, now, told)
    read_turn(header, coder, models, of_class, False, now)
    return found


def tell_turn(
    header: Header,
    coder: Recorder,
    following: Integers | None,
    distance: int,
    now: Integers | None,
    told: Integers | None,
) -> None:
    """What is read in a turn."""
    y, a, b = map(abs, following.colour) if following else (0, 0, 0)
    u, v, r = (told.shape[0], abs(told.shape[1]), abs(told.shape[2])) if told else (0, 0, 0)
    if following:
        coder.tell_number(distance // 8)
    if told:
        coder.symbols.append(signs(told.colour))
    if following:
        coder.tell_rest(distance // 8)
        coder.tell(distance, 3)
        coder.tell_number(y)
    if told:
        coder.tell_number(v)
    if following and not header.grey:
        coder.tell_number(a)
    if told and not header.upright:
        coder.tell_number(r)
    if following and not header.grey:
        coder.tell_number(b)
    if told:
        coder.symbols.append(signs(told.shape[1:]))
        coder.tell_rest(v)
        coder.tell_rest(r)
        coder.tell(u, told.u_bits)
    if following:
        for value in (y, a, b):
            coder.tell_rest(value)
    if told and now:
        beyond = told.of_class.blocks.level - told.of_class.g
        known = now.part.i - beyond, now.part.j - beyond
        for cell, at, bits, less in zip(told.cell, told.place, told.parts, known, strict=True):
            coder.tell(cell - 2 << bits | at, max(bits - less, 0))


def signs(values: list[int]) -> int:
    found = 0
    for value in values:
        found = 2 * found + (value < 0)
    return found
