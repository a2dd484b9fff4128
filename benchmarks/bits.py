"""Bits of a file of version 5 by what they say, counted by the second decoder as it reads: colour, shape, place."""

from __future__ import annotations

import math
from typing import Any
from unittest.mock import patch

from tests.bitstream import plain_decoder_v4 as v4
from tests.bitstream import plain_decoder_v5 as v5

SCALE = 32768  # what the edges of a model's symbols end at
_MODELS = v4.Models


def by_kind(data: bytes) -> dict[str, float]:
    """Of the payload of a file: colour (luma, chroma and their signs), shape (ratio, slant, size within a class),
    place (number in each class of size, distances, parts of a cell), and what it begins and ends with."""
    file = v5.read(data)
    coder = _Counting(file.payload, file.states)
    read_turn = v4.read_turn

    def turn(*arguments: Any) -> Any:
        following, gaussian = read_turn(*arguments)
        if following is not None:
            coder.move_to_shape(following.u_bits)
        return following, gaussian

    with patch.object(v4, "read_turn", turn), patch.object(v4, "Models", coder.models):
        for _ in v4.read_gaussians(file.header, coder, part=False):
            pass
    return {**coder.bits, "begin and end": 8 * len(file.payload) - sum(coder.bits.values())}


class _Counting(v4.Coder):
    """Counts as it reads. Raw bits of a number are of its kind; all others are of places, but those of a size."""

    def __init__(self, payload: bytes, states: int) -> None:
        super().__init__(payload, states)
        self.bits = dict.fromkeys(("colour", "shape", "place"), 0.0)
        self.kinds: dict[int, str] = {}  # by model

    def models(self) -> v4.Models:
        """Those of a payload, whose kinds are known from then on."""
        models = _MODELS()
        colour = [models.luma, *models.a, *models.b, *models.color_signs]
        shape = [*models.v, *models.r, *models.shape_signs]
        self.kinds = {id(model): "place" for model in (models.count, models.distance)}
        self.kinds |= {id(model): "colour" for model in colour} | {id(model): "shape" for model in shape}
        return models

    def symbol(self, which: int, model: v4.Model) -> int:
        edges = [model.edge(i) for i in range(17)]
        symbol = super().symbol(which, model)
        self.bits[self.kinds[id(model)]] -= math.log2((edges[symbol + 1] - edges[symbol]) / SCALE)
        return symbol

    def number(self, which: int, model: v4.Model) -> v4.Number:
        number = super().number(which, model)
        kind = self.kinds[id(model)]
        self.bits[kind] += number.rest
        self.bits["place"] -= number.rest  # which take() will say
        if number.symbol == 15:  # its raw bits were taken already
            raw = 5 + number.least.bit_length() - 1
            self.bits[kind] += raw
            self.bits["place"] -= raw
        return number

    def take(self, count: int) -> int:
        self.bits["place"] += count
        return super().take(count)

    def move_to_shape(self, count: int) -> None:
        """So many raw bits will be those of a size within its class."""
        self.bits["shape"] += count
        self.bits["place"] -= count
