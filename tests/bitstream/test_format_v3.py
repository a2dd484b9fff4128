"""Version 3 in docs/format.md against the code, a decoder written from it alone against ours, and pinned bytes."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sgmethod import BitstreamError, decode
from sgmethod.bitstream import container
from sgmethod.bitstream.v3 import StreamV3
from sgmethod.scene import Gaussians
from sgmethod.view import MAX_SCALE, MIN_SCALE, PIXEL_VARIANCE, View
from tests.bitstream import plain_decoder_v3 as plain_decoder_rd
from tests.bitstream.test_format_v1 import TEXT, table
from tests.harness.data import ROOT, damaged, golden, golden_path, with_checksum

GOLDEN = golden(3)
HASHES = json.loads((golden_path("v3-hashes.json")).read_text())

# Seen on the golden streams and on 12 views of them: no sample differs. A difference needs an exact value within
# 1e-5 or so of the border between two levels.
MAX_LEVELS, MAX_SHARE = 1, 0.001
PARTS = (0.01, 0.1, 0.25, 0.5, 0.77, 0.99)


def rows(gaussians: Gaussians) -> list[plain_decoder_rd.Gaussian]:
    arrays = (gaussians.means, gaussians.factors, gaussians.colors)
    return [(*m, *f, tuple(c)) for m, f, c in zip(*(a.tolist() for a in arrays), strict=True)]


def assert_same_pixels(plain: tuple[int, int, bytes], pixels: np.ndarray) -> None:
    width, height, samples = plain
    assert pixels.shape == (height, width, len(samples) // (height * width))
    difference = np.abs(np.frombuffer(samples, np.uint8).reshape(pixels.shape).astype(int) - pixels)
    assert difference.max() <= MAX_LEVELS
    assert np.mean(difference > 0) < MAX_SHARE


def test_the_version_in_the_text() -> None:
    assert f"# Version {StreamV3.VERSION}\n" in TEXT
    assert f"fewer than {StreamV3.MIN_BYTES} bytes" in TEXT


def test_every_quantum_code() -> None:
    """The range in the table is exactly what our decoder takes."""
    single, low, high = (int(n) for n in re.findall(r"\d+", table("Header of version 3")[3]["range"]))
    empty = StreamV3(3, 2, 1.0, (0, 0, 0), False, False, b"")
    for code in (*range(520), *range(3500, 4200), 0xFFFF):
        data = bytearray(container.serialise(empty))
        data[13:15] = code.to_bytes(2, "big")
        coded = with_checksum(bytes(data))
        if code == single or low <= code <= high:
            assert container.parse(coded).quantum == plain_decoder_rd.parse_header(coded).quantum
        else:
            with pytest.raises(BitstreamError, match="quantum"):
                container.parse(coded)
            with pytest.raises(plain_decoder_rd.RefusedError):
                plain_decoder_rd.parse_header(coded)


def test_start_tables() -> None:
    """The table in the text, which the plain decoder reads, is the code's."""
    code = (ROOT / "sgmethod" / "native" / "rd" / "start_tables.h").read_text()
    rows = [[int(n) for n in row.split(",")] for row in re.findall(r"\{([\d, ]+)\}", code)]
    assert rows == [row for rows in plain_decoder_rd.start_tables().values() for row in rows]


def test_views_in_the_text() -> None:
    text = " ".join(TEXT.split())
    assert f"s, 1/{1 / MIN_SCALE:g} to {MAX_SCALE:g} output pixels" in text
    assert f"one output pixel wide is 1/{1 / PIXEL_VARIANCE:g}" in text


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bytes_and_pixels(name: str) -> None:
    """Exact: tests/bitstream/make_golden.py wrote the hashes when the streams were made."""
    assert hashlib.sha256(GOLDEN[name]).hexdigest() == HASHES[name]["bytes"]
    assert hashlib.sha256(decode(GOLDEN[name]).tobytes()).hexdigest() == HASHES[name]["pixels"]


def test_golden_streams_show_everything() -> None:
    assert GOLDEN.keys() == HASHES.keys()
    streams = {name: container.parse(data) for name, data in GOLDEN.items()}
    assert {(s.grey, s.upright) for s in streams.values()} == {(False, False), (True, False), (False, True)}
    assert {(s.width, s.height, len(s.gaussians())) for s in streams.values()} >= {(7, 5, 0), (1, 1, 1)}
    factors = streams["v3-every-class"].gaussians().factors.astype(np.float64)
    sizes = np.round(np.log2(factors[:, 0] * factors[:, 2]))  # a class is one in log2(s^2)
    assert set(sizes[sizes >= -2]) == set(range(-2, 29))


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_finds_the_same_gaussians(name: str) -> None:
    header, plain = plain_decoder_rd.parse(GOLDEN[name])
    stream = container.parse(GOLDEN[name])
    assert header == plain_decoder_rd.Header(
        stream.grey, stream.upright, stream.width, stream.height, stream.quantum, stream.background
    )
    assert rows(stream.gaussians()) == plain
    for part in PARTS:
        assert rows(stream.gaussians(part)) == plain_decoder_rd.parse_part(GOLDEN[name], part)[1]


@pytest.mark.parametrize("payload", ["0d22f0588931", "00000d188bc18931"])
def test_a_first_state_that_no_encoder_leaves_is_refused(payload: str) -> None:
    """Though the next words would lift it to one."""
    data = bytearray(container.serialise(StreamV3(9, 9, 1.0, (0, 0, 0), False, False, bytes.fromhex(payload))))
    data[18:20] = b"\0\0"
    refused = with_checksum(bytes(data))
    with pytest.raises(BitstreamError, match="begins"):
        container.parse(refused).gaussians()
    with pytest.raises(plain_decoder_rd.RefusedError, match="start"):
        plain_decoder_rd.parse(refused)


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_draws_the_same_picture(name: str) -> None:
    assert_same_pixels(plain_decoder_rd.decode(GOLDEN[name]), decode(GOLDEN[name]))


@pytest.mark.parametrize("name", GOLDEN)
@pytest.mark.parametrize("view", [View(0.4), View(2.5, (0, 0, 1, 1))])
def test_the_plain_decoder_draws_the_same_views(name: str, view: View) -> None:
    assert_same_pixels(plain_decoder_rd.view(GOLDEN[name], view.scale, view.region), decode(GOLDEN[name], view=view))


def test_the_plain_decoder_shares_nothing() -> None:
    source = Path(plain_decoder_rd.__file__).read_text()
    imports = re.findall(r"^(?:from|import) ([\w.]+)", source, re.MULTILINE)
    standard = {"__future__", "collections.abc", "dataclasses", "math", "pathlib", "re", "struct", "zlib"}
    assert set(imports) == {*standard, "tests.bitstream.plain_decoder"}


@given(
    st.sampled_from(["v3-color", "v3-grey", "v3-upright", "v3-empty", "v3-pixel"]),
    st.floats(0, 1),
    st.binary(min_size=1, max_size=4),
    st.integers(-3, 12),
    st.sampled_from([1.0, 0.5]),
)
def test_both_take_and_refuse_the_same_files(name: str, place: float, value: bytes, growth: int, part: float) -> None:
    """Bytes changed, the end moved, the checksum made to fit: the same Gaussians, or both refuse."""
    data = damaged(GOLDEN[name], place, value, growth)
    try:
        ours = rows(container.parse(data).gaussians(part))
    except BitstreamError:
        with pytest.raises(plain_decoder_rd.RefusedError):
            plain_decoder_rd.parse(data) if part == 1 else plain_decoder_rd.parse_part(data, part)
    else:
        header, plain = plain_decoder_rd.parse(data) if part == 1 else plain_decoder_rd.parse_part(data, part)
        assert ours == plain
        assert header.width * header.height >= len(plain)
