"""Headers: what is read is what was written."""

from __future__ import annotations

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import v2
from sgmethod.bitstream.fields import BitField, BitReader, write_bits

pytestmark = pytest.mark.thorough

BIT_FIELDS = (*v2.HEADER, *v2.ALPHA_HEADER)


@pytest.mark.parametrize("is_short", [False, True])
@pytest.mark.parametrize("field", BIT_FIELDS, ids=lambda field: field.name)
def test_bits_are_read_as_they_were_written(field: BitField, is_short: bool) -> None:
    held = [value for value in range(field.low, min(field.high, 70_000) + 1) if field.allows(value, is_short)]
    if not field.grows:
        assert len(held) == 2 ** (field.short_bits if is_short else field.bits)
    ones = BitField("ones", 3, 3)
    for value in [*held[:: max(len(held) // 50, 1)], field.high]:
        data = write_bits([(ones, 7), (field, value), (ones, 7)], is_short)
        reader = BitReader(data + b"more")
        assert list(reader.read([ones, field, ones], is_short)) == [7, value, 7]
        assert reader.end() == len(data)
        with pytest.raises(BitstreamError, match="ends within"):
            list(BitReader(data[:-1]).read([ones, field, ones], is_short))
    for value in {field.low - 1, field.high + 1, *({1} if is_short and field.bits > field.short_bits else set())}:
        with pytest.raises(ValueError, match=f"cannot hold {field.name} = {value}"):
            write_bits([(field, value)], is_short)
