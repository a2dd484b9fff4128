"""The tests' own pictures and files, wherever a test stands."""

from __future__ import annotations

import zlib
from pathlib import Path

ROOT = Path(__file__).parents[2]  # of the repository
DATA = ROOT / "tests" / "data"
PHOTOGRAPHS = DATA / "photographs"


def golden(version: int) -> dict[str, bytes]:
    """The golden files of one version of the format by name, such as "v3-color"."""
    return {f"v{version}-{path.stem}": path.read_bytes() for path in sorted((DATA / f"v{version}").glob("*.sg"))}


def golden_path(name: str) -> Path:
    """Where a golden file lies, or the picture of one: "v3-color.sg", "v1-paper.png"."""
    version, _, rest = name.partition("-")
    return DATA / version / rest


def damaged(data: bytes, place: float, value: bytes, growth: int) -> bytes:
    """The data of an .sg file with other bytes at a place, 0 to 1 of what the checksum covers, so many bytes more or
    fewer at the end, and the checksum that belongs to them."""
    at = 8 + int(place * (len(data) - 8))
    data = data[:at] + value + data[at + len(value) :]
    return with_checksum(data[: len(data) + growth] if growth < 0 else data + bytes(growth))


def with_checksum(data: bytes) -> bytes:
    """The data of an .sg file with the checksum that belongs to them; the eight bytes of its prefix come first."""
    return data[:4] + zlib.crc32(data[8:]).to_bytes(4, "big") + data[8:]
