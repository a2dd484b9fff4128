"""The tests' own pictures and files, wherever a test stands."""

from __future__ import annotations

import re
import zlib
from pathlib import Path

ROOT = Path(__file__).parents[2]  # of the repository
DATA = ROOT / "tests" / "data"
PHOTOGRAPHS = DATA / "photographs"
JAVASCRIPT = ROOT / "sgmethod" / "javascript" / "src"
STATIC = ROOT / "service" / "page"  # what the page is made of


GOLDEN = {1: ROOT / "tests" / "paper" / "golden", 2: DATA / "v2"}  # by the version that is in the files


EXAMPLES = "v1-paper", "v2-color"  # a golden file of each profile


def golden(*versions: int) -> dict[str, bytes]:
    """The golden files by name, such as "v2-color"; of some versions, or of all."""
    found = [(number, path) for number in versions or GOLDEN for path in sorted(GOLDEN[number].glob("*.sg"))]
    return {f"v{number}-{path.stem}": path.read_bytes() for number, path in found}


def golden_path(name: str) -> Path:
    """Where a golden file lies, or the picture of one, such as "v2-color.sg"."""
    version, _, rest = name.partition("-")
    return GOLDEN[int(version[1:])] / rest


def code_in(document: str, language: str = r"\w+", heading: str = "") -> list[str]:
    """The blocks of code in a document, or below one of its headings."""
    text = (ROOT / document).read_text()
    if heading:
        (text,) = re.findall(rf"^##+ {heading}$(.*?)(?=^##+ |\Z)", text, re.MULTILINE | re.DOTALL)
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


PICTURE = golden_path("v2-color.sg").read_bytes()  # 48 x 40 pixels, which are drawn at once


SIGNATURE = b"\xd3\xc2"  # with which a file of the default profile begins


def damaged(data: bytes, place: float, value: bytes, growth: int) -> bytes:
    """The data of an .sg file with other bytes at a place, 0 to 1 of what lies between signature and checksum, so many
    bytes more or fewer at the end, and the checksum that belongs to them."""
    begin, end = 2, checksum_at(data)
    at = begin + int(place * (end - begin))
    covered = data[:at] + (value + data[at + len(value) :])[: end - at]
    covered = covered[: len(covered) + growth] if growth < 0 else covered + bytes(growth)
    return with_checksum(covered + data[end:])


def checksum_at(data: bytes) -> int:
    return len(data) - _checksum_bytes(data)


def _checksum_bytes(data: bytes) -> int:
    return 1 if data[2:3] >= b"\x80" else 4


def with_checksum(data: bytes) -> bytes:
    """The data of an .sg file with the checksum that belongs to them, in the place of another."""
    end = max(checksum_at(data), 2)
    return data[:end] + zlib.crc32(data[:end]).to_bytes(4, "big")[-_checksum_bytes(data) :]
