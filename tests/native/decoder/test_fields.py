"""Headers: what Python reads and writes, and the same tables in the text, in C++ and in JavaScript."""

from __future__ import annotations

import re

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import payload, v1, v3, v4, v5
from sgmethod.bitstream.fields import BitField, BitReader, Field, Header, write_bits
from sgmethod.bitstream.stream import PREFIX_BYTES
from tests.bitstream.test_format_v1 import TEXT, table
from tests.harness.data import JAVASCRIPT, ROOT

pytestmark = pytest.mark.thorough

HEADERS = {
    "kHeaderV1": v1.HEADER,
    "kGroup": v1.GROUP,
    "kHeaderV3": v3.HEADER,
    "kHeaderV4": v4.HEADER,
    "kAlphaHeader": v4.ALPHA_HEADER,
}
BIT_HEADERS = {"kHeaderV5": v5.HEADER, "kAlphaHeaderV5": v5.ALPHA_HEADER}
BIT_FIELDS = [field for header in BIT_HEADERS.values() for field in header]
EVERY = [(header, field) for header in HEADERS.values() for field in header.fields]
CPP = (ROOT / "sgmethod" / "native" / "file" / "fields.h").read_text()
READING = (ROOT / "sgmethod" / "native" / "file" / "file.cpp").read_text()
HEADER_JS = (JAVASCRIPT / "header.js").read_text()


def least(header: Header) -> dict[str, int]:
    return {field.name: field.low for field in header.fields}


@pytest.mark.parametrize(("header", "field"), EVERY)
def test_a_field_is_read_as_it_was_written(header: Header, field: Field) -> None:
    for value in {field.low, field.low + 1, field.high - 1, field.high, *([] if field.also is None else [field.also])}:
        data = header.write({**least(header), field.name: value})
        assert len(data) == header.size
        assert header.read(data + b"more") == {**least(header), field.name: value}
        with pytest.raises(BitstreamError, match="truncated in"):
            header.read(data[:-1])


@pytest.mark.parametrize(("header", "field"), EVERY)
def test_a_value_outside_of_its_range_is_refused(header: Header, field: Field) -> None:
    at = sum(before.bytes for before in header.fields[: header.fields.index(field)])
    most = 256**field.bytes - 1
    beyond = {value for value in (0, field.low - 1, field.high + 1, most) if 0 <= value <= most}
    for value in beyond - {field.low, field.high, field.also}:
        with pytest.raises(ValueError, match=f"{field.name} = {value} is outside"):
            header.write({**least(header), field.name: value})
        data = header.write(least(header))
        data = data[:at] + value.to_bytes(field.bytes, "big") + data[at + field.bytes :]
        with pytest.raises(BitstreamError, match=f"{field.name} is {value}, outside"):
            header.read(data)


@pytest.mark.parametrize(
    ("section", "header", "offset"),
    [
        ("Header", v1.HEADER, PREFIX_BYTES),
        ("Group list", v1.GROUP, 0),
        ("Header of version 3", v3.HEADER, PREFIX_BYTES),
        ("The alpha part", v4.ALPHA_HEADER, 0),
    ],
)
def test_the_text_has_the_table(section: str, header: Header, offset: int) -> None:
    rows = [row for row in table(section) if row["range"]]  # a payload has none
    assert len(rows) == len(header.fields)
    for row, field in zip(rows, header.fields, strict=True):
        assert (int(row["offset"]), int(row["size"]), row["field"]) == (offset, field.bytes, field.name)
        assert row["range"] == field.range
        offset += field.bytes


def test_the_text_has_the_flags() -> None:
    """Version 4 adds flags to the header of version 3, and nothing else."""
    flags, *others = v4.HEADER.fields
    assert others == [*v3.HEADER.fields[1:]]
    assert f"`flags` may be up to {flags.high}. A {payload.FLAG_TEXTURE} in it stands for texture" in TEXT
    assert f"an {payload.FLAG_ALPHA} for alpha" in TEXT
    meaning = table("Header of version 3")[0]["meaning"]
    assert f"{payload.FLAG_GREY}: grey" in meaning
    assert f"{payload.FLAG_UPRIGHT}: upright" in meaning


def fields(rows: list[list[str | int]]) -> tuple[Field, ...]:
    return tuple(Field(*row) for row in rows)  # type: ignore[arg-type]


def test_cpp_has_the_tables() -> None:
    """And takes the values by the same names, in the same order."""
    most_flags = dict(re.findall(r"(kHeaderV\d) = header_of\((\d+)\)", CPP))
    for name, header in HEADERS.items():
        begin = "header_of(uint32_t most_flags)" if name in most_flags else f"std::array {name} = "
        part = CPP.split(begin, 1)[1].split("\n}", 1)[0].replace("most_flags", most_flags.get(name, ""))
        rows = re.findall(r"Field\{(.*)\}, *// (\w+)", part)
        assert fields([[said, *map(int, numbers.split(", "))] for numbers, said in rows]) == header.fields
    taken = set()
    named = {name: [field.name for field in header.fields] for name, header in HEADERS.items()}
    named |= {name: [field.name for field in header] for name, header in BIT_HEADERS.items()}
    for names, of in re.findall(r"const auto \[(.*)\] =\s+(?:bits\.)?values_of\((.*)\);", READING):
        for name in re.findall(r"k\w+", of):
            assert names.split(", ") == named[name]
            taken.add(name)
    assert taken == named.keys()


def bit_fields(rows: list[list[object]]) -> tuple[BitField, ...]:
    return tuple(BitField(*row) for row in rows)  # type: ignore[arg-type]


def test_cpp_has_the_tables_of_bits() -> None:
    for name, header in BIT_HEADERS.items():
        part = CPP.split(f"std::array {name} = ", 1)[1].split("\n}", 1)[0]
        rows = re.findall(r"BitField\{(\d+), (\d+)(, true)?\}, *// (\w+)", part)
        assert bit_fields([[said, int(bits), int(short), bool(more)] for bits, short, more, said in rows]) == header


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
    for section, header in ("Header of version 5", v5.HEADER), ("Alpha in version 5", v5.ALPHA_HEADER):
        rows = [(row["field"], row["bits"], row["in a short file"]) for row in table(section)]
        for (name, bits, short), field in zip(rows, header, strict=True):
            more = " + n" if field.grows else ""
            assert (name, bits, short) == (field.name, f"{field.bits}{more}", f"{field.short_bits}{more}")
    meaning = table("Header of version 5")[0]["meaning"]
    flags = {payload.FLAG_GREY: "grey", payload.FLAG_UPRIGHT: "upright", payload.FLAG_TEXTURE: "texture"}
    for flag, word in {**flags, payload.FLAG_ALPHA: "alpha", v5.FLAG_SHORT: "short"}.items():
        assert f"{flag}: {word}" in meaning


def test_javascript_has_the_tables() -> None:
    """Those of version 5, the only one that it reads."""
    for name, header in {"HEADER": v5.HEADER, "ALPHA_HEADER": v5.ALPHA_HEADER}.items():
        part = HEADER_JS.split(f"const {name} = [\n", 1)[1].split("];", 1)[0]
        rows = re.findall(r"\[(\d+), (\d+), (true|false)\], // (\w+)", part)
        assert bit_fields([[said, int(bits), int(short), more == "true"] for bits, short, more, said in rows]) == header
    flags = {"GREY": payload.FLAG_GREY, "UPRIGHT": payload.FLAG_UPRIGHT, "TEXTURE": payload.FLAG_TEXTURE}
    for name, flag in {**flags, "ALPHA": payload.FLAG_ALPHA}.items():
        assert f"const {name} = {flag};" in HEADER_JS
    assert v5.FLAG_SHORT << 3 == 128  # it looks at the whole byte
    assert "isShort = bytes[2] > 127;" in HEADER_JS
