"""Headers: what Python reads and writes, and the same tables in the text."""

from __future__ import annotations

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import v1, v2
from sgmethod.bitstream.fields import BitField, BitReader, Header, write_bits
from sgmethod.bitstream.stream import SIGNATURE_BYTES
from tests.bitstream.test_format_v1 import table

pytestmark = pytest.mark.thorough

BIT_FIELDS = (*v2.HEADER, *v2.ALPHA_HEADER)


@pytest.mark.parametrize(
    ("section", "header", "offset"),
    [("## Header of version 1", v1.HEADER, SIGNATURE_BYTES), ("## Group list", v1.GROUP, 0)],
)
def test_the_text_has_the_table(section: str, header: Header, offset: int) -> None:
    rows = table(section)
    assert len(rows) == len(header.fields)
    for row, field in zip(rows, header.fields, strict=True):
        assert (int(row["offset"]), int(row["size"]), row["field"]) == (offset, field.bytes, field.name)
        assert row["range"] == field.range
        offset += field.bytes


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


def test_the_text_has_the_tables_of_bits() -> None:
    for line, header in (("## Header", v2.HEADER), ("If there is alpha, its fields follow at once:", v2.ALPHA_HEADER)):
        rows = [(row["field"], row["bits"], row["in a short file"]) for row in table(line)]
        for (name, bits, short), field in zip(rows, header, strict=True):
            more = " + n" if field.grows else ""
            assert (name, bits, short) == (field.name, f"{field.bits}{more}", f"{field.short_bits}{more}")
    meaning = table("## Header")[0]["meaning"]
    flags = {v2.FLAG_GREY: "grey", v2.FLAG_UPRIGHT: "upright", v2.FLAG_TEXTURE: "texture"}
    for flag, word in {**flags, v2.FLAG_ALPHA: "alpha", v2.FLAG_SHORT: "short"}.items():
        assert f"{flag}: {word}" in meaning
