"""docs/paper-format.md against the code, and a decoder written from it alone against ours."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from sgmethod import BitstreamError
from sgmethod.bitstream import container
from tests.bitstream.document import rows
from tests.bitstream.plain_decoder_v2 import RefusedError
from tests.paper import plain_decoder
from tests.support.data import golden, with_checksum

GOLDEN = golden(1)


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_finds_the_same(name: str) -> None:
    stream = container.parse(GOLDEN[name])
    assert plain_decoder.parse(GOLDEN[name]) == (stream.width, stream.height, rows(stream.scene().gaussians))


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
            plain_decoder.parse(data)
    else:
        width, height, gaussians = plain_decoder.parse(data)
        stream = container.parse(data)
        assert (width, height, len(gaussians)) == (stream.width, stream.height, stream.gaussians)
