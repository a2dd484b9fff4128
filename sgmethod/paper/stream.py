"""The file of profile paper: integer codes <-> bytes, in fields of fixed length.

docs/paper-format.md describes it in words. Between signature and checksum stand

header   profile, picture size, bits per coordinate, groups                        (HEADER)
tables   ranges of positions and factors, colour codebooks                         (only if there are Gaussians)
groups   bitwidth and number of Gaussians of each group
records  per Gaussian x, y, l1, l2, l3, first and second colour index, most significant bit first
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sgmethod.bitstream.stream import LONG_CHECKSUM, NO_LIMITS, SIGNATURE_BYTES, Info, Limits
from sgmethod.errors import BitstreamError, ViewError
from sgmethod.native import native
from sgmethod.paper.settings import PaperSettings
from sgmethod.scene import FloatArray, Gaussians, Scene

PROFILE_CODES = {"baseline": 0, "paper": 1}  # nothing writes 0 any more
CODEBOOK_STAGES, CODEBOOK_ENTRIES, COLOR_INDEX_BITS = 2, 8, 3
MIN_BITWIDTH, MAX_BITWIDTH = 1, 16


Fields = dict[str, tuple[int, int, int]]  # bytes, least and greatest value of each
HEADER: Fields = {
    "profile": (1, 0, 1),
    "width": (2, 1, native.MAX_SIDE),
    "height": (2, 1, native.MAX_SIDE),
    "position_bits": (1, MIN_BITWIDTH, MAX_BITWIDTH),
    "groups": (1, 0, MAX_BITWIDTH),
}
GROUP: Fields = {"bitwidth": (1, MIN_BITWIDTH, MAX_BITWIDTH), "gaussians": (3, 1, 2**24 - 1)}
POSITION_TABLE_BYTES, FACTOR_TABLE_BYTES = 2 * 2 * 4, 3 * 2 * 4
CODEBOOK_BYTES = CODEBOOK_STAGES * CODEBOOK_ENTRIES * 3 * 2
TABLE_BYTES = POSITION_TABLE_BYTES + FACTOR_TABLE_BYTES + CODEBOOK_BYTES
HEADER_BYTES, GROUP_BYTES = (sum(size for size, *_ in fields.values()) for fields in (HEADER, GROUP))
FIXED_BYTES = SIGNATURE_BYTES + HEADER_BYTES + LONG_CHECKSUM  # of every file
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


@dataclass(frozen=True, kw_only=True)
class PaperInfo(Info):
    """Info of a file. Ranges and codebooks as in PaperStream; groups: bitwidth and Gaussians of each."""

    position_bits: int
    position_range: list[list[float]]
    factor_range: list[list[float]]
    codebooks: list[list[list[float]]]
    groups: list[dict[str, int]]


@dataclass(frozen=True)
class PaperStream:
    """All integer codes of a file, with the tables that give them meaning.

    position_range [2, 2]: for x and y the coordinate in pixels of code 0 and of the last code;
    factor_range [3, 2]: the same for l1, l2, l3; codebooks [2, 8, 3]: RGB entries of both stages.
    """

    VERSION: ClassVar[int] = 1
    MIN_BYTES: ClassVar[int] = FIXED_BYTES
    background: ClassVar[tuple[int, int, int]] = (0, 0, 0)
    alpha: ClassVar[None] = None

    profile: str
    width: int
    height: int
    position_bits: int
    position_range: NDArray[np.float32]
    factor_range: NDArray[np.float32]
    codebooks: NDArray[np.float16]
    groups: tuple[Group, ...]

    @classmethod
    def parse(cls, body: memoryview, limits: Limits = NO_LIMITS) -> PaperStream:
        """Read the bytes between signature and checksum.

        Raises BitstreamError for anything but a whole body, and beyond the limits before the records are read.
        """
        header = _read_fields(HEADER, body)
        at = HEADER_BYTES
        profile = next(name for name, code in PROFILE_CODES.items() if code == header["profile"])
        size = header["width"], header["height"], header["position_bits"]
        limits.check_size(header["width"], header["height"])
        if header["groups"] == 0:
            if len(body) != at:
                raise BitstreamError("the file has trailing bytes")
            empty = np.zeros((2, 2), np.float32), np.zeros((3, 2), np.float32), np.zeros((2, 8, 3), np.float16)
            return cls(profile, *size, *empty, ())
        tables = _read_tables(body[at : at + TABLE_BYTES])
        at += TABLE_BYTES
        counts = []
        for _ in range(header["groups"]):
            group = _read_fields(GROUP, body[at:])
            counts.append((group["bitwidth"], group["gaussians"]))
            at += GROUP_BYTES
        _check_count(sum(n for _, n in counts), header["width"] * header["height"], limits)
        return cls(profile, *size, *tables, _read_groups(body[at:], header["position_bits"], counts))

    def body(self) -> bytes:
        """Write the bytes between signature and checksum."""
        values = {
            "profile": PROFILE_CODES[self.profile],
            "width": self.width,
            "height": self.height,
            "position_bits": self.position_bits,
            "groups": len(self.groups),
        }
        body = bytearray(_fields(HEADER, values))
        if self.groups:
            body += self.position_range.astype(">f4").tobytes()
            body += self.factor_range.astype(">f4").tobytes()
            body += self.codebooks.astype(">f2").tobytes()
            for group in self.groups:
                body += _fields(GROUP, {"bitwidth": group.bitwidth, "gaussians": len(group.positions)})
            bits = [_records_to_bits(group, self.position_bits) for group in self.groups]
            body += np.packbits(np.concatenate(bits)).tobytes()
        return bytes(body)

    @property
    def gaussians(self) -> int:
        """Number of Gaussians."""
        return sum(len(g.positions) for g in self.groups)

    def dequantised(self) -> Gaussians:
        """Dequantise the Gaussians, exactly as every decoder must (docs/paper-format.md)."""
        if not self.groups:
            return Gaussians.empty(0)
        means = [_levels(g.positions, self.position_range, self.position_bits) for g in self.groups]
        factors = [_levels(g.factors, self.factor_range, g.bitwidth) for g in self.groups]
        first, second = self.codebooks.astype(np.float32)
        indices = np.concatenate([g.colors for g in self.groups])
        colors = first[indices[:, 0]] + second[indices[:, 1]]
        return Gaussians(np.concatenate(means), np.concatenate(factors), colors)

    def lay_out(self, prefix: float = 1.0, texture: bool = True) -> None:
        """Return None: only scene() can be drawn."""

    def scene(self, prefix: float = 1.0) -> Scene:
        """Return the scene to draw. Raises ViewError for a prefix below 1."""
        if prefix < 1:
            raise ViewError(f"a file of profile {self.profile} cannot be decoded from a prefix")
        return Scene(self.dequantised(), self.width, self.height, self.background, native.MAX_CUTOFF)

    def info(self, file_bytes: int, checksum: str, limits: Limits = NO_LIMITS) -> PaperInfo:
        """Describe the file. parse() has already checked the limits."""
        return PaperInfo(
            bytes=file_bytes,
            bpp=8 * file_bytes / (self.width * self.height),
            version=self.VERSION,
            checksum=checksum,
            profile=self.profile,
            width=self.width,
            height=self.height,
            gaussians=self.gaussians,
            position_bits=self.position_bits,
            position_range=self.position_range.tolist(),
            factor_range=self.factor_range.tolist(),
            codebooks=self.codebooks.astype(np.float64).tolist(),
            groups=[{"bitwidth": g.bitwidth, "gaussians": len(g.positions)} for g in self.groups],
            bits=self.size_bits(),
        )

    def size_bits(self) -> dict[str, int]:
        """Bits spent on headers (all that is not below), positions, covariances and colours; in sum the whole file."""
        n = self.gaussians
        parts = {
            "positions": 2 * self.position_bits * n,
            "covariances": sum(3 * g.bitwidth * len(g.positions) for g in self.groups),
            "colors": CODEBOOK_STAGES * COLOR_INDEX_BITS * n + (8 * CODEBOOK_BYTES if n else 0),
        }
        records = sum(record_bits(self.position_bits, g.bitwidth) * len(g.positions) for g in self.groups)
        total = 8 * (file_bytes(records, len(self.groups)) if n else FIXED_BYTES)
        return {"headers": total - sum(parts.values()), **parts}


def file_bytes(bits: int, groups: int) -> int:
    """Size of a file with this many bits of records and groups, at least one."""
    return FIXED_BYTES + TABLE_BYTES + GROUP_BYTES * groups + -(-bits // 8)


def smallest_file(settings: PaperSettings, _: bool = False) -> int:
    """Size of a file with one Gaussian."""
    return file_bytes(record_bits(settings.position_bits, settings.min_bitwidth), 1)


def record_bits(position_bits: int, bitwidth: int) -> int:
    """Size of one Gaussian's record."""
    return sum(_widths(position_bits, bitwidth))


def _read_fields(fields: Fields, data: memoryview) -> dict[str, int]:
    values, at = {}, 0
    for name, (size, low, high) in fields.items():
        if len(data) < at + size:
            raise BitstreamError("the file is truncated in its header")
        value = values[name] = int.from_bytes(data[at : at + size], "big")
        if not low <= value <= high:
            raise BitstreamError(f"header field {name} is {value}, outside {low}..{high}")
        at += size
    return values


def _fields(fields: Fields, values: dict[str, int]) -> bytes:
    """Write a value for each field. Raises ValueError for a value out of range."""
    for name, (_, low, high) in fields.items():
        if not low <= values[name] <= high:
            raise ValueError(f"{name} = {values[name]} is outside {low}..{high}")
    return b"".join(values[name].to_bytes(size, "big") for name, (size, *_) in fields.items())


def _widths(position_bits: int, bitwidth: int) -> tuple[int, ...]:
    return (position_bits,) * 2 + (bitwidth,) * 3 + (COLOR_INDEX_BITS,) * CODEBOOK_STAGES


def _check_count(gaussians: int, pixels: int, limits: Limits) -> None:
    if gaussians > pixels:
        raise BitstreamError(f"the file claims more Gaussians than its {pixels} pixels")
    if limits.max_gaussians is not None and gaussians > limits.max_gaussians:
        raise BitstreamError(f"the file exceeds the limit of {limits.max_gaussians} Gaussians")


def _levels(codes: NDArray[Any], value_range: FloatArray, bits: int) -> FloatArray:
    """Decode: low + code (high - low) / (2^bits - 1), computed in float64 and rounded once to float32."""
    low, high = value_range.astype(np.float64).T
    values: FloatArray = (low + codes * ((high - low) / (2**bits - 1))).astype(np.float32)
    return values


Tables = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float16]]


def _read_tables(data: memoryview) -> Tables:
    if len(data) < TABLE_BYTES:
        raise BitstreamError("the file is truncated in its tables")
    factors_at = POSITION_TABLE_BYTES + FACTOR_TABLE_BYTES
    positions = np.frombuffer(data[:POSITION_TABLE_BYTES], ">f4").astype(np.float32).reshape(2, 2)
    factors = np.frombuffer(data[POSITION_TABLE_BYTES:factors_at], ">f4").astype(np.float32).reshape(3, 2)
    codebooks = np.frombuffer(data[factors_at:], ">f2").astype(np.float16).reshape(2, 8, 3)
    if not all(np.isfinite(table).all() for table in (positions, factors, codebooks)):
        raise BitstreamError("a table in the file contains a value that is not finite")
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
    total = sum(n * record_bits(position_bits, bitwidth) for bitwidth, n in counts)
    if len(data) != -(-total // 8):
        raise BitstreamError(f"the file has {len(data)} bytes of records, its header says {-(-total // 8)}")
    if total % 8 and data[-1] & 0xFF >> total % 8:
        raise BitstreamError("the file's padding is not zero")
    groups, at = [], 0
    for bitwidth, n in counts:
        table = np.empty((n, 7), np.uint16)
        length = record_bits(position_bits, bitwidth)
        for first in range(0, n, BLOCK_RECORDS):
            block = table[first : first + BLOCK_RECORDS]
            _read_records(data, at + first * length, _widths(position_bits, bitwidth), block)
        groups.append(Group(bitwidth, table[:, :2], table[:, 2:5], table[:, 5:].astype(np.uint8)))
        at += n * length
    return tuple(groups)


def _read_records(data: memoryview, at: int, widths: tuple[int, ...], out: NDArray[np.uint16]) -> None:
    """Fill out [n, 7] with the elements of the records that begin at bit `at`."""
    length = sum(widths)
    end = at + len(out) * length
    # Up to 16 bits lie within three bytes, wherever they begin; the last element may need two bytes past the end.
    read = np.frombuffer(bytes(data[at // 8 : -(-end // 8)]) + bytes(2), np.uint8).astype(np.uint32)
    first = at % 8 + length * np.arange(len(out))
    for column, width in enumerate(widths):
        byte, bit = first >> 3, first & 7
        three = read[byte] << 16 | read[byte + 1] << 8 | read[byte + 2]
        out[:, column] = three >> (24 - width - bit) & ((1 << width) - 1)
        first += width
