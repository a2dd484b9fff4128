"""A file as text."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import numpy as np
import pytest

from sgmethod import BitstreamError, decode, info
from sgmethod.bitstream.text import from_text, to_text
from tests.support.data import golden

GOLDEN = golden()


@pytest.mark.parametrize("name", GOLDEN)
def test_a_text_is_a_file(name: str) -> None:
    text = to_text(GOLDEN[name])
    assert re.fullmatch(r"w[A-Za-z0-9_-]*", text)
    assert len(text) == -(-4 * (len(GOLDEN[name]) - 1) // 3)
    assert from_text(text) == GOLDEN[name]


@pytest.mark.parametrize("name", GOLDEN)
def test_a_file_may_hold_its_text(name: str, tmp_path: Path) -> None:
    text = to_text(GOLDEN[name])
    (tmp_path / "text").write_text(text + "\n")
    assert np.array_equal(decode(tmp_path / "text"), decode(GOLDEN[name]))
    assert info(text.encode()) == info(GOLDEN[name])
    with pytest.raises((OSError, BitstreamError), match=r"No such file|from_text\(\) reads a text"):
        decode(text)  # a path


@pytest.mark.parametrize("version", [3, 4, 15])
def test_a_text_of_a_later_version_is_recognised(version: int) -> None:
    text = to_text(bytes([0xD3, 0xC0 + version]) + bytes(20))
    with pytest.raises(BitstreamError, match=f"version {version} is not supported: update"):
        decode(text.encode())


def test_a_text_that_is_none_is_one_clear_error() -> None:
    text = to_text(GOLDEN["v2-color"])
    for end in range(0, len(text), 7):
        with pytest.raises(BitstreamError):
            from_text(text[:end])
    refused = 0
    for at in range(len(text)):
        other = text[:at] + ("A" if text[at] != "A" else "B") + text[at + 1 :]
        try:
            from_text(other)
        except BitstreamError:
            refused += 1
    assert refused >= 0.98 * len(text)  # a short file's checksum is one byte; 1.0 seen
    for wrong in (text + "=", text + "A", " " + text, text + "é", text.replace("w", "+", 1), ""):
        with pytest.raises(BitstreamError):
            from_text(wrong)
    padded = base64.urlsafe_b64encode(GOLDEN["v2-pixel"][1:]).decode()
    assert padded.endswith("=")
    with pytest.raises(BitstreamError, match="not the text"):
        from_text(padded)
    with pytest.raises(BitstreamError, match=r"not an \.sg"):
        to_text(b"SGM\1" + bytes(20))
