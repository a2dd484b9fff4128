"""Syntax elements to bytes and back; what is no whole, intact file is refused."""

from __future__ import annotations

import struct
import zlib
from dataclasses import fields, replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from sgmethod.bitstream.container import parse, serialise
from sgmethod.bitstream.stream import Limits
from sgmethod.errors import BitstreamError
from sgmethod.paper.stream import BLOCK_RECORDS, Group, PaperStream
from tests.support.data import golden, with_checksum

GOLDEN = golden(1)


def stream(
    position_bits: int, groups: list[tuple[int, int]], seed: int = 0, size: tuple[int, int] = (64, 48)
) -> PaperStream:
    """Random syntax elements; groups lists bitwidth and number of Gaussians."""
    rng = np.random.default_rng(seed)

    def group(bitwidth: int, n: int) -> Group:
        return Group(
            bitwidth,
            rng.integers(0, 2**position_bits, (n, 2)).astype(np.uint16),
            rng.integers(0, 2**bitwidth, (n, 3)).astype(np.uint16),
            rng.integers(0, 8, (n, 2)).astype(np.uint8),
        )

    made = tuple(group(bitwidth, n) for bitwidth, n in groups)
    positions, factors = (rng.normal(0, 50, (k, 2)).astype(np.float32) for k in (2, 3))
    codebooks = rng.normal(0, 1, (2, 8, 3)).astype(np.float16)
    if not groups:
        positions, factors, codebooks = np.zeros_like(positions), np.zeros_like(factors), np.zeros_like(codebooks)
    return PaperStream("paper", *size, position_bits, positions, factors, codebooks, made)


def assert_equal(a: PaperStream, b: PaperStream) -> None:
    for one, other in ((a, b), *zip(a.groups, b.groups, strict=True)):
        for field in fields(one):
            if field.name != "groups":
                assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name


def changed(data: bytes, at: int, value: bytes) -> bytes:
    """data with other bytes at an offset, and the checksum to fit."""
    return with_checksum(data[:at] + value + data[at + len(value) :])


@given(
    st.integers(1, 16),
    st.lists(st.tuples(st.integers(1, 16), st.integers(1, 40)), max_size=16),
    st.integers(0, 2**32 - 1),
)
def test_what_is_written_is_read(position_bits: int, groups: list[tuple[int, int]], seed: int) -> None:
    written = stream(position_bits, groups, seed)
    data = serialise(written)
    assert_equal(parse(data), written)
    bits = written.size_bits()
    assert sum(bits.values()) == 8 * len(data)
    assert all(value >= 0 for value in bits.values())


def test_more_records_than_are_unpacked_at_once() -> None:
    n = 2 * BLOCK_RECORDS + 1
    written = stream(5, [(3, n), (7, 3)], size=(600, 400))
    assert_equal(parse(serialise(written)), written)


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_streams_are_written_again_bit_by_bit(name: str) -> None:
    assert serialise(parse(GOLDEN[name])) == GOLDEN[name]


def test_every_byte_of_a_small_file() -> None:
    """Written out by hand from docs/paper-format.md."""
    one = Group(2, np.array([[5, 2]], np.uint16), np.array([[3, 0, 1]], np.uint16), np.array([[6, 1]], np.uint8))
    codebooks = np.zeros((2, 8, 3), np.float16)
    codebooks[0, 6] = (1, 0.5, -2)
    written = PaperStream(
        "baseline",
        300,
        7,
        3,
        np.array([[0, 7], [1, -1]], np.float32),
        np.array([[1, 4], [-1, 1], [0.5, 2]], np.float32),
        codebooks,
        (one,),
    )
    body = (
        "00 012c 0007 03 01"
        "00000000 40e00000 3f800000 bf800000"
        "3f800000 40800000 bf800000 3f800000 3f000000 40000000"
        + "0000 0000 0000" * 6
        + "3c00 3800 c000"
        + "0000 0000 0000" * 9
        + "02 000001"
        + "ab 1c 40"  # x 101, y 010, l1 11, l2 00, l3 01, colours 110 and 001, padding 000000
    )
    data = bytes.fromhex(body)
    assert serialise(written) == b"\xd3\xc1" + data + struct.pack(">I", zlib.crc32(b"\xd3\xc1" + data))


@pytest.mark.parametrize(
    ("name", "value"),
    [("width", 0), ("height", 0), ("width", 65_536), *product(("position_bits", "bitwidth"), (0, 17))],
)
def test_elements_out_of_range_are_never_written(name: str, value: int) -> None:
    whole = stream(12, [(6, 3)])
    changes: dict[str, Any] = (
        {name: value} if name != "bitwidth" else {"groups": (replace(whole.groups[0], bitwidth=value),)}
    )
    with pytest.raises(ValueError, match=name):
        serialise(replace(whole, **changes))


@pytest.mark.parametrize("name", GOLDEN)
def test_any_flipped_bit_is_noticed(name: str) -> None:
    data = GOLDEN[name]
    for at in range(len(data)):
        for bit in range(8):
            with pytest.raises(BitstreamError):
                parse(data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :])


@pytest.mark.parametrize("name", GOLDEN)
def test_a_cut_at_any_byte_is_noticed(name: str) -> None:
    data = GOLDEN[name]
    for length in range(len(data)):
        with pytest.raises(BitstreamError):
            parse(data[:length])
        if length >= 8:
            with pytest.raises(BitstreamError):
                parse(with_checksum(data[:length]))


def f32(value: float) -> bytes:
    return struct.pack(">f", value)


WHOLE = serialise(stream(12, [(6, 3), (8, 2)]))  # 252 bits of records, 4 of padding
REFUSED = {
    "nothing": (b"", "too short"),
    "less than a header": (WHOLE[:12], "too short"),
    "another file": (b"\x89PNG\r\n\x1a\n" + bytes(100), "not an .sg file"),
    "a later version": (WHOLE[:1] + b"\xc3" + WHOLE[2:], "version 3"),
    "version 0": (WHOLE[:1] + b"\xc0" + WHOLE[2:], "not an .sg file"),
    "a wrong checksum": (WHOLE[:-4] + bytes(4), "checksum"),
    "a checksum of one byte": (with_checksum(WHOLE[:2] + b"\x80" + WHOLE[3:-3]), "profile is 128"),
    "an unknown profile": (changed(WHOLE, 2, b"\x02"), "profile is 2"),
    "zero width": (changed(WHOLE, 3, b"\0\0"), "width is 0"),
    "zero height": (changed(WHOLE, 5, b"\0\0"), "height is 0"),
    "zero position bits": (changed(WHOLE, 7, b"\0"), "position_bits is 0"),
    "17 position bits": (changed(WHOLE, 7, b"\x11"), "position_bits is 17"),
    "17 groups": (changed(WHOLE, 8, b"\x11"), "groups is 17"),
    "no groups, but their bytes": (changed(WHOLE, 8, b"\0"), "trailing bytes"),
    "more groups than bytes": (changed(WHOLE[:153], 8, b"\x10"), "truncated in its header"),
    "half a table": (with_checksum(WHOLE[:100]), "truncated in its tables"),
    "an infinite position": (changed(WHOLE, 9, f32(float("inf"))), "not finite"),
    "a factor that is no number": (changed(WHOLE, 25, f32(float("nan"))), "not finite"),
    "an infinite colour": (changed(WHOLE, 49, b"\xfc\x00"), "not finite"),
    "zero bitwidth": (changed(WHOLE, 145, b"\0"), "bitwidth is 0"),
    "17 bits": (changed(WHOLE, 145, b"\x11"), "bitwidth is 17"),
    "an empty group": (changed(WHOLE, 146, bytes(3)), "gaussians is 0"),
    "more Gaussians than bytes": (changed(WHOLE, 146, b"\0\1\0"), "bytes of records"),
    "more Gaussians than pixels": (changed(WHOLE, 146, b"\xff\xff\xff"), "more Gaussians"),
    "a byte too many": (with_checksum(WHOLE[:-4] + bytes(5)), "bytes of records"),
    "a byte too few": (with_checksum(WHOLE[:-1]), "bytes of records"),
    "padding": (changed(WHOLE, len(WHOLE) - 5, bytes([WHOLE[-5] | 1])), "padding"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence(name: str) -> None:
    data, why = REFUSED[name]
    with pytest.raises(BitstreamError, match=why) as caught:
        parse(data)
    assert "\n" not in str(caught.value)


def test_the_limit_of_pixels_stands_before_all_that_follows_the_header() -> None:
    data = changed(WHOLE[:18], 3, b"\xff\xff\xff\xff")  # nothing but a header, of 65,535 x 65,535 pixels
    with pytest.raises(BitstreamError, match="limit of 1000"):
        parse(data, Limits(max_pixels=1000))
    with pytest.raises(BitstreamError, match="tables"):
        parse(data)
