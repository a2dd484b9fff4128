"""Headers: what Python reads and writes, and the same tables in the text, in C++ and in the page's decoder."""

from __future__ import annotations

import json
import re

import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import payload, v1, v3, v4
from sgmethod.bitstream.fields import Field, Header
from sgmethod.bitstream.stream import PREFIX_BYTES
from tests.bitstream.test_format_v1 import TEXT, table
from tests.harness.data import ROOT

HEADERS = {
    "kHeaderV1": v1.HEADER,
    "kGroup": v1.GROUP,
    "kHeaderV3": v3.HEADER,
    "kHeaderV4": v4.HEADER,
    "kAlphaHeader": v4.ALPHA_HEADER,
}
EVERY = [(header, field) for header in HEADERS.values() for field in header.fields]
CPP = (ROOT / "sgmethod" / "native" / "file" / "file.cpp").read_text()
JAVASCRIPT = (ROOT / "service" / "web" / "static" / "decoder" / "file.js").read_text()


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
    assert f"`flags` may be up to {flags.high}. A {v4.FLAG_TEXTURE} in it stands for texture" in TEXT
    assert f"an {v4.FLAG_ALPHA} for alpha" in TEXT
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
    for names, of in re.findall(r"const auto \[(.*)\] =\s+values_of\((.*), \w+\);", CPP):
        for name in re.findall(r"k\w+", of):
            assert names.split(", ") == [field.name for field in HEADERS[name].fields]
            taken.add(name)
    assert taken == HEADERS.keys()


def test_javascript_has_the_tables() -> None:
    """Those of version 4, the only one that it reads."""
    found = dict(re.findall(r"^const (\w+) = (\[\n.*?\n\]);", JAVASCRIPT, re.M | re.S))
    assert found.keys() == {"HEADER", "ALPHA_HEADER"}
    for name, header in {"HEADER": v4.HEADER, "ALPHA_HEADER": v4.ALPHA_HEADER}.items():
        assert fields(json.loads(re.sub(r",\s*\]", "]", found[name]))) == header.fields
    flags = [payload.FLAG_GREY, payload.FLAG_UPRIGHT, v4.FLAG_TEXTURE, v4.FLAG_ALPHA]
    assert f"const [GREY, UPRIGHT, TEXTURE, ALPHA] = {flags};" in JAVASCRIPT
