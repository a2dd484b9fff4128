"""The .sg file, version 1: syntax elements <-> bytes. docs/format.md is its description in words.

header   magic, version, checksum, picture size, bits per coordinate, groups       (HEADER)
tables   ranges of positions and factors, colour codebooks                         (only if there are Gaussians)
groups   bitwidth and number of Gaussians of each group
records  per Gaussian x, y, l1, l2, l3, first and second colour index, most significant bit first
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sgmethod.errors import BitstreamError

MAGIC = b"SGM"
VERSION = 1
PROFILE_CODES = {"baseline": 0, "paper": 1}
CODEBOOK_STAGES, CODEBOOK_ENTRIES, COLOR_INDEX_BITS = 2, 8, 3
MIN_BITWIDTH, MAX_BITWIDTH = 1, 16
CUTOFF = 5.5  # sigma at which a Gaussian of version 1 ends
MAX_SIDE = 65_535


@dataclass(frozen=True)
class Field:
    """One unsigned header field, big-endian, with the values it may take."""

    name: str
    bytes: int
    low: int
    high: int


HEADER = (
    Field("profile", 1, 0, 1),
    Field("width", 2, 1, MAX_SIDE),
    Field("height", 2, 1, MAX_SIDE),
    Field("position_bits", 1, MIN_BITWIDTH, MAX_BITWIDTH),
    Field("groups", 1, 0, MAX_BITWIDTH),
)
GROUP = (Field("bitwidth", 1, MIN_BITWIDTH, MAX_BITWIDTH), Field("gaussians", 3, 1, 2**24 - 1))
PREFIX_BYTES = len(MAGIC) + 1 + 4  # magic, version, CRC-32 of all that follows
HEADER_BYTES = PREFIX_BYTES + sum(f.bytes for f in HEADER)
POSITION_TABLE_BYTES, FACTOR_TABLE_BYTES = 2 * 2 * 4, 3 * 2 * 4
CODEBOOK_BYTES = CODEBOOK_STAGES * CODEBOOK_ENTRIES * 3 * 2
TABLE_BYTES = POSITION_TABLE_BYTES + FACTOR_TABLE_BYTES + CODEBOOK_BYTES
GROUP_BYTES = sum(f.bytes for f in GROUP)
BLOCK_RECORDS = 1 << 16  # unpacked at a time: a bit takes a byte then


@dataclass(frozen=True)
class Group:
    """Gaussians whose factors share one bitwidth B.

    positions [n, 2] in 0 .. 2^position_bits - 1; factors [n, 3] in 0 .. 2^B - 1; colors [n, 2] in 0 .. 7.
    """

    bitwidth: int
    positions: NDArray[np.uint16]
    factors: NDArray[np.uint16]
    colors: NDArray[np.uint8]


@dataclass(frozen=True)
class Stream:
    """All syntax elements of a version 1 file.

    position_range [2, 2]: for x and y the coordinate in pixels of code 0 and of the last code;
    factor_range [3, 2]: the same for l1, l2, l3; codebooks [2, 8, 3]: RGB entries of both stages.
    """

    profile: str
    width: int
    height: int
    position_bits: int
    position_range: NDArray[np.float32]
    factor_range: NDArray[np.float32]
    codebooks: NDArray[np.float16]
    groups: tuple[Group, ...]

    @property
    def gaussians(self) -> int:
        """Number of Gaussians."""
        return sum(len(g.positions) for g in self.groups)

    def size_bits(self) -> dict[str, int]:
        """Bits spent on headers (with tables of ranges and groups, checksum and padding), positions,
        covariances and colours; their sum is the file's size."""
        n = self.gaussians
        parts = {
            "positions": 2 * self.position_bits * n,
            "covariances": sum(3 * g.bitwidth * len(g.positions) for g in self.groups),
            "colors": CODEBOOK_STAGES * COLOR_INDEX_BITS * n + (8 * CODEBOOK_BYTES if n else 0),
        }
        fixed = HEADER_BYTES + (TABLE_BYTES + GROUP_BYTES * len(self.groups) if n else 0)
        records = sum(_record_bits(self.position_bits, g.bitwidth) * len(g.positions) for g in self.groups)
        total = 8 * (fixed + -(-records // 8))
        return {"headers": total - sum(parts.values()), **parts}


def record_budget_bits(max_bytes: int, groups: int) -> int:
    """Bits left for records in a file of max_bytes with so many groups; negative when even headers do not fit."""
    return 8 * (max_bytes - HEADER_BYTES - TABLE_BYTES - GROUP_BYTES * groups)


def file_bytes(record_bits: int, groups: int) -> int:
    """Size of a file with so many bits of records in so many groups, at least one."""
    return HEADER_BYTES + TABLE_BYTES + GROUP_BYTES * groups + -(-record_bits // 8)


def _record_bits(position_bits: int, bitwidth: int) -> int:
    return 2 * position_bits + 3 * bitwidth + CODEBOOK_STAGES * COLOR_INDEX_BITS


def _widths(position_bits: int, bitwidth: int) -> tuple[int, ...]:
    return (position_bits,) * 2 + (bitwidth,) * 3 + (COLOR_INDEX_BITS,) * CODEBOOK_STAGES


def serialise(stream: Stream) -> bytes:
    """The file's bytes."""
    values = {
        "profile": PROFILE_CODES[stream.profile],
        "width": stream.width,
        "height": stream.height,
        "position_bits": stream.position_bits,
        "groups": len(stream.groups),
    }
    body = bytearray(_write_fields(HEADER, values))
    if stream.groups:
        body += stream.position_range.astype(">f4").tobytes()
        body += stream.factor_range.astype(">f4").tobytes()
        body += stream.codebooks.astype(">f2").tobytes()
        for group in stream.groups:
            body += _write_fields(GROUP, {"bitwidth": group.bitwidth, "gaussians": len(group.positions)})
        bits = [_records_to_bits(group, stream.position_bits) for group in stream.groups]
        body += np.packbits(np.concatenate(bits)).tobytes()
    return MAGIC + bytes([VERSION]) + struct.pack(">I", zlib.crc32(body)) + bytes(body)


def parse(data: bytes, max_pixels: int | None = None, max_gaussians: int | None = None) -> Stream:
    """The syntax elements of a file.

    Raises BitstreamError for anything but a whole, intact file, and for a picture of more than max_pixels or
    max_gaussians before anything behind the header is read.
    """
    if len(data) < HEADER_BYTES:
        raise BitstreamError(f"the file is too short: {len(data)} bytes")
    if data[:3] != MAGIC:
        raise BitstreamError("this is not an .sg file")
    if data[3] != VERSION:
        raise BitstreamError(f"version {data[3]} of the format is not known to this decoder")
    body = memoryview(data)[PREFIX_BYTES:]
    if zlib.crc32(body) != struct.unpack(">I", data[4:8])[0]:
        raise BitstreamError("the file is damaged: its checksum does not match")
    header = _read_fields(HEADER, body)
    at = sum(f.bytes for f in HEADER)
    profile = next(name for name, code in PROFILE_CODES.items() if code == header["profile"])
    size = header["width"], header["height"], header["position_bits"]
    pixels = header["width"] * header["height"]
    if max_pixels is not None and pixels > max_pixels:
        raise BitstreamError(f"{size[0]} x {size[1]} pixels are more than the limit of {max_pixels}")
    if header["groups"] == 0:
        if len(body) != at:
            raise BitstreamError("the file has bytes after its end")
        empty = np.zeros((2, 2), np.float32), np.zeros((3, 2), np.float32), np.zeros((2, 8, 3), np.float16)
        return Stream(profile, *size, *empty, ())
    tables = _read_tables(body[at : at + TABLE_BYTES])
    at += TABLE_BYTES
    counts = []
    for _ in range(header["groups"]):
        group = _read_fields(GROUP, body[at : at + GROUP_BYTES])
        counts.append((group["bitwidth"], group["gaussians"]))
        at += GROUP_BYTES
    gaussians = sum(n for _, n in counts)
    if gaussians > pixels:
        raise BitstreamError(f"the file claims more Gaussians than its picture's {pixels} pixels")
    if max_gaussians is not None and gaussians > max_gaussians:
        raise BitstreamError(f"the file has more Gaussians than the limit of {max_gaussians}")
    return Stream(profile, *size, *tables, _read_groups(body[at:], header["position_bits"], counts))


def _write_fields(fields: tuple[Field, ...], values: dict[str, int]) -> bytes:
    for f in fields:
        if not f.low <= values[f.name] <= f.high:
            raise ValueError(f"{f.name} = {values[f.name]} is outside {f.low} .. {f.high}")
    return b"".join(values[f.name].to_bytes(f.bytes, "big") for f in fields)


def _read_fields(fields: tuple[Field, ...], data: memoryview) -> dict[str, int]:
    values, at = {}, 0
    for f in fields:
        if len(data) < at + f.bytes:
            raise BitstreamError("the file ends within its header")
        value = int.from_bytes(data[at : at + f.bytes], "big")
        if not f.low <= value <= f.high:
            raise BitstreamError(f"header field {f.name} is {value}, outside {f.low} .. {f.high}")
        values[f.name] = value
        at += f.bytes
    return values


Tables = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float16]]


def _read_tables(data: memoryview) -> Tables:
    if len(data) < TABLE_BYTES:
        raise BitstreamError("the file ends within its tables")
    factors_at = POSITION_TABLE_BYTES + FACTOR_TABLE_BYTES
    positions = np.frombuffer(data[:POSITION_TABLE_BYTES], ">f4").astype(np.float32).reshape(2, 2)
    factors = np.frombuffer(data[POSITION_TABLE_BYTES:factors_at], ">f4").astype(np.float32).reshape(3, 2)
    codebooks = np.frombuffer(data[factors_at:], ">f2").astype(np.float16).reshape(2, 8, 3)
    if not all(np.isfinite(table).all() for table in (positions, factors, codebooks)):
        raise BitstreamError("a table of the file holds a value that is not finite")
    return positions, factors, codebooks


def _records_to_bits(group: Group, position_bits: int) -> NDArray[np.uint8]:
    columns = np.concatenate([group.positions, group.factors, group.colors], axis=1).astype(np.uint32)
    shifts = [
        (column, shift)
        for column, width in enumerate(_widths(position_bits, group.bitwidth))
        for shift in reversed(range(width))
    ]
    bits = np.stack([(columns[:, c] >> s) & 1 for c, s in shifts], axis=1)
    return bits.astype(np.uint8).ravel()


def _read_groups(data: memoryview, position_bits: int, counts: list[tuple[int, int]]) -> tuple[Group, ...]:
    total = sum(n * _record_bits(position_bits, bitwidth) for bitwidth, n in counts)
    if len(data) != -(-total // 8):
        raise BitstreamError(f"the file holds {len(data)} bytes of records, its header says {-(-total // 8)}")
    if total % 8 and data[-1] & 0xFF >> total % 8:
        raise BitstreamError("the file's padding is not zero")
    groups, at = [], 0
    for bitwidth, n in counts:
        table = np.empty((n, 7), np.uint16)
        length = _record_bits(position_bits, bitwidth)
        for first in range(0, n, BLOCK_RECORDS):
            block = table[first : first + BLOCK_RECORDS]
            _read_records(data, at + first * length, _widths(position_bits, bitwidth), block)
        groups.append(Group(bitwidth, table[:, :2], table[:, 2:5], table[:, 5:].astype(np.uint8)))
        at += n * length
    return tuple(groups)


def _read_records(data: memoryview, at: int, widths: tuple[int, ...], out: NDArray[np.uint16]) -> None:
    """Fill out [n, 7] with the elements of the records that begin at bit `at`."""
    end = at + len(out) * sum(widths)
    bits = np.unpackbits(np.frombuffer(data[at // 8 : -(-end // 8)], np.uint8))
    rows = bits[at % 8 :][: end - at].reshape(len(out), -1)
    start = 0
    for column, width in enumerate(widths):
        weights = (1 << np.arange(width)[::-1]).astype(np.float32)  # float: a fast product, exact to 2^24
        out[:, column] = rows[:, start : start + width] @ weights
        start += width
