"""What the tables of docs/format.md say, and Gaussians as the plain decoders have them."""

from __future__ import annotations

from sgmethod.scene import Gaussians
from tests.bitstream.plain_decoder_v2 import Gaussian
from tests.support.data import ROOT

TEXT = (ROOT / "docs" / "format.md").read_text()


def rows(gaussians: Gaussians) -> list[Gaussian]:
    """As the plain decoders have them."""
    return [(*m, *f, tuple(c)) for m, f, c in zip(*(a.tolist() for a in gaussians.arrays), strict=True)]


def table(line: str) -> list[dict[str, str]]:
    """The first table of docs/format.md after the end of a line, such as a heading; a dictionary for each row."""
    after = TEXT.split(f"{line}\n", 1)[1]
    lines = after[after.index("\n|") + 1 :].split("\n\n", 1)[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]
