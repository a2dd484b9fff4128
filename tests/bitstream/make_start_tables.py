"""Where the models of version 2 begin: python -m tests.bitstream.make_start_tables FOLDER

Counts the symbols of the folder's .sg files, and writes docs/format/models.json and the tables of
sgmethod/native/rd/start_tables.h.

A change of these tables changes the format, so this is run when the format gets another version. The tables there
come from eight photographs that scikit-image carries (astronaut, chelsea, coffee, motorcycle, rocket,
hubble_deep_field, retina and ihc, at most 768x640), each at 0.04, 0.12, 0.3 and 0.6 bpp, and at 128 pixels a side in
400 bytes.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bitstream import plain_decoder_v2
from tests.harness.data import ROOT

HEADER = ROOT / "sgmethod" / "native" / "rd" / "start_tables.h"
UNSEEN = 0.25 * 0.7 ** np.arange(16)  # what stands in for symbols, or whole models, that the files do not have


class CountingModel(plain_decoder_v2.Model):
    """Knows what it was used for."""

    def __init__(self, start: list[int]) -> None:
        super().__init__(start)
        self.counts = np.zeros(16)
        models.append(self)

    def adapt(self, symbol: int) -> None:
        super().adapt(symbol)
        self.counts[symbol] += 1


models: list[CountingModel] = []


def counts_of(data: bytes) -> list[NDArray[np.float64]]:
    """How often each symbol of each model occurs, in the table's order."""
    models.clear()
    plain_decoder_v2.read(data).integers()
    return [model.counts for model in models]


def edges(counts: NDArray[np.float64]) -> list[int]:
    """Cumulative probabilities below symbols 1 to 15, in 1/256; counts [files, 16]."""
    # Files with more symbols say more, but not in proportion: what is sought is the next file's start.
    weights = 1 / np.sqrt(np.maximum(counts.sum(1), 1))
    share = UNSEEN + (counts * weights[:, None]).sum(0)
    return [min(round(256 * float(c)), 255) for c in np.cumsum(share / share.sum())[:-1]]


def text_of(tables: dict[str, list[list[int]]]) -> str:
    """JSON with a row a line."""
    parts = (f' "{name}": [\n  ' + ",\n  ".join(map(json.dumps, starts)) + "\n ]" for name, starts in tables.items())
    return "{\n" + ",\n".join(parts) + "\n}\n"


def main() -> None:
    """See the module."""
    plain_decoder_v2.Model = CountingModel  # type: ignore[misc]
    files = [counts_of(path.read_bytes()) for path in sorted(Path(sys.argv[1]).glob("*.sg"))]
    rows = [edges(np.array(of_model)) for of_model in zip(*files, strict=True)]
    remaining = iter(rows)
    tables = {name: [next(remaining) for _ in starts] for name, starts in plain_decoder_v2.start_tables().items()}
    plain_decoder_v2.MODELS.write_text(text_of(tables), "utf-8")
    code = HEADER.read_text("utf-8")
    remaining = iter(rows)
    code = re.sub(r"\{\d+(, \d+)+\}", lambda _: "{" + ", ".join(map(str, next(remaining))) + "}", code)
    HEADER.write_text(code, "utf-8")


if __name__ == "__main__":
    main()
