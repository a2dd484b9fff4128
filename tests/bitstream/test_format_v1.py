"""Version 1 in docs/format.md against the code, and a decoder written from it alone against ours."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from sgmethod.scene import Gaussians
from tests.bitstream import plain_decoder_v1
from tests.bitstream.plain_decoder_v2 import Gaussian, RefusedError
from tests.support.data import ROOT, golden, with_checksum

TEXT = (ROOT / "docs" / "format.md").read_text()
GOLDEN = golden(1)


def rows(gaussians: Gaussians) -> list[Gaussian]:
    """As the plain decoders have them."""
    return [(*m, *f, tuple(c)) for m, f, c in zip(*(a.tolist() for a in gaussians.arrays), strict=True)]


def table(line: str) -> list[dict[str, str]]:
    """The first table after the end of a line, such as a heading; a dictionary for each row."""
    after = TEXT.split(f"{line}\n", 1)[1]
    lines = after[after.index("\n|") + 1 :].split("\n\n", 1)[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_finds_the_same(name: str) -> None:
    stream = container.parse(GOLDEN[name])
    assert plain_decoder_v1.parse(GOLDEN[name]) == (stream.width, stream.height, rows(stream.scene().gaussians))


@given(st.sampled_from(sorted(GOLDEN)), st.integers(2, 164), st.binary(min_size=1, max_size=4), st.integers(-2, 2))
def test_both_refuse_the_same_files(name: str, at: int, value: bytes, growth: int) -> None:
    """Bytes of header and tables changed, the end moved, the checksum made to fit."""
    data = GOLDEN[name][:at] + value + GOLDEN[name][at + len(value) :]
    data = data[: len(data) + growth] if growth < 0 else data + bytes(growth)
    data = with_checksum(data)
    try:
        container.parse(data)
    except BitstreamError:
        with pytest.raises(RefusedError):
            plain_decoder_v1.parse(data)
    else:
        width, height, gaussians = plain_decoder_v1.parse(data)
        stream = container.parse(data)
        assert (width, height, len(gaussians)) == (stream.width, stream.height, stream.gaussians)
