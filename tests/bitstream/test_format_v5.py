"""Version 5 in docs/format.md against the code, a decoder written from it alone against ours, and pinned bytes; and the
text of a file."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sgmethod import BitstreamError, decode, encode
from sgmethod.bitstream import container
from sgmethod.bitstream.payload import MIN_QUANTUM
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.text import from_text, to_text
from sgmethod.bitstream.v5 import SMALLEST_ALPHA, SMALLEST_FILE, StreamV5, alpha_bytes, coded_background
from sgmethod.scene import Gaussians
from sgmethod.view import View
from tests.bitstream import plain_decoder_v5
from tests.bitstream.plain_decoder import RefusedError
from tests.bitstream.plain_decoder_v3 import Header
from tests.bitstream.plain_decoder_v4 import NUMBERS
from tests.bitstream.test_format_v1 import TEXT, table
from tests.bitstream.test_format_v3 import PARTS, assert_same_pixels, rows
from tests.harness.data import damaged, golden, golden_path, with_checksum

GOLDEN = golden(5)
HASHES = json.loads(golden_path("v5-hashes.json").read_text())
NOTHING = Gaussians(*(np.zeros((0, n), np.float32) for n in (2, 3, 3)))


def test_the_versions_in_the_text() -> None:
    old = [int(n) for n in re.findall(r"\d+", table("Every version")[1]["value"])]
    assert [*old, StreamV5.VERSION] == sorted(container.STREAMS)
    assert f"# Version {StreamV5.VERSION}\n" in TEXT


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bytes_and_pixels(name: str) -> None:
    """Exact: tests/bitstream/make_golden.py wrote the hashes when the streams were made."""
    assert hashlib.sha256(GOLDEN[name]).hexdigest() == HASHES[name]["bytes"]
    assert hashlib.sha256(decode(GOLDEN[name]).tobytes()).hexdigest() == HASHES[name]["pixels"]


def stream_of(name: str) -> StreamV5:
    stream = container.parse(GOLDEN[name])
    assert isinstance(stream, StreamV5)
    return stream


def test_golden_streams_show_everything() -> None:
    assert GOLDEN.keys() == HASHES.keys()
    streams = [stream_of(name) for name in GOLDEN]
    assert {(s.grey, s.upright) for s in streams} == {(False, False), (True, False), (False, True), (True, True)}
    shown = {(s.is_short, s.texture is not None, s.alpha is not None) for s in streams}
    assert shown >= {(short, more, more) for short in (False, True) for more in (False, True)}
    assert {s.is_short for s in streams if len(s.gaussians()) == 0} == {False, True}


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_finds_the_same(name: str) -> None:
    file, s = plain_decoder_v5.read(GOLDEN[name]), stream_of(name)
    kinds = s.texture is not None, s.alpha is not None
    assert file.header == Header(s.grey, s.upright, s.width, s.height, s.quantum, s.background, NUMBERS, *kinds)
    assert (file.alpha is None) == (s.alpha is None)
    if s.alpha is not None and file.alpha is not None:
        assert file.alpha[0] == Header(True, False, s.width, s.height, s.alpha.quantum, s.alpha.background, NUMBERS)
        assert rows(s.alpha.gaussians()) == file.alpha_gaussians()
    assert file.codes == ([] if s.texture is None else s.texture.tolist())
    assert rows(s.gaussians()) == file.gaussians()
    for part in PARTS:
        assert rows(s.gaussians(part)) == file.part(part)
    assert container.serialise(s) == GOLDEN[name]
    assert s.file_bytes == len(GOLDEN[name])


@pytest.mark.parametrize("name", ["v5-color", "v5-texture", "v5-short-alpha", "v5-empty"])
def test_the_plain_decoder_draws_the_same_pictures(name: str) -> None:
    """And views of all, and of a region that begins at odd places. Seen: no sample differs."""
    assert_same_pixels(plain_decoder_v5.decode(GOLDEN[name]), decode(GOLDEN[name]))
    s = stream_of(name)
    region = s.width // 3, s.height // 2, (s.width + 2) // 3, (s.height + 3) // 4
    for view in (View(0.4), View(0.4, region), View(2.3, region)):
        plain = plain_decoder_v5.view(GOLDEN[name], view.scale, view.region)
        assert_same_pixels(plain, decode(GOLDEN[name], view=view))


def test_the_plain_decoder_shares_nothing() -> None:
    source = Path(plain_decoder_v5.__file__).read_text()
    imports = re.findall(r"^(?:from|import) ([\w.]+)", source, re.MULTILINE)
    others = {f"tests.bitstream{name}" for name in (".plain_decoder", ".plain_decoder_v4")}
    assert set(imports) == {"__future__", "functools", "zlib", *others}


@given(st.sampled_from([*GOLDEN]), st.floats(0, 1), st.binary(min_size=1, max_size=4), st.integers(-3, 12))
def test_both_take_and_refuse_the_same_files(name: str, place: float, value: bytes, growth: int) -> None:
    """Bytes changed, the end moved, the checksum made to fit."""
    data = damaged(GOLDEN[name], place, value, growth)
    try:
        ours = rows(container.parse(data, Limits(1 << 20)).gaussians())
    except BitstreamError as error:
        if "limit" not in str(error):
            with pytest.raises(RefusedError):
                plain_decoder_v5.parse(data)
    else:
        assert ours == plain_decoder_v5.parse(data)[1]


def test_headers_of_known_sizes() -> None:
    """Bytes without any Gaussian. In version 4 they are 18."""
    for size, is_short, grey, least in [
        ((64, 64), True, False, 9),
        ((64, 64), False, False, 14),
        ((768, 512), True, False, 10),
        ((768, 512), True, True, 9),
        ((768, 512), False, False, 15),
        ((65535, 65535), True, False, SMALLEST_FILE),
        ((1, 1), True, True, StreamV5.MIN_BYTES),
    ]:
        background = coded_background((100, 100, 100) if grey else (255, 3, 120), is_short)
        stream = StreamV5(*size, StreamV5.coded_quantum(0.3, is_short), background, grey, False, b"", is_short=is_short)
        data = container.serialise(stream)
        assert len(data) == stream.file_bytes == least
        assert container.parse(data) == stream
        assert container.info(data).to_dict()["short"] is is_short
    alpha = replace(stream, background=(255, 255, 255))
    for _ in range(3):
        assert replace(stream, alpha=alpha).file_bytes - stream.file_bytes <= alpha_bytes(alpha) <= SMALLEST_ALPHA + 2
        alpha = replace(alpha, payload=alpha.payload + b"\1")


@pytest.mark.parametrize("is_short", [False, True])
def test_quanta_are_near_to_those_asked_for(is_short: bool) -> None:
    most = 1 / 18 if is_short else 1 / 512  # by how much of the next, at the finest
    for quantum in np.geomspace(MIN_QUANTUM, 15.4, 300):
        coded = StreamV5.coded_quantum(quantum, is_short)
        assert abs(coded / quantum - 1) <= most * 1.01
        assert StreamV5.coded_quantum(coded, is_short) == coded
    assert StreamV5.coded_quantum(1e-9, is_short) >= MIN_QUANTUM
    assert 15 < StreamV5.coded_quantum(1e9, is_short) < 16


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\xd3", "too short"),
        (b"\xd3\xc5\x80\0\0\0", "too short"),
        (b"\xd3\xc6" + bytes(9), "version 6"),
        (b"\xd3\xc4" + bytes(9), r"not an \.sg"),
        (b"SGM\5" + bytes(20), "version 5"),
        (b"\xd3\xc5\0" + bytes(20), "checksum"),
        (with_checksum(b"\xd3\xc5\x87\xff\xff\xff\0"), "within its header"),
        (with_checksum(b"\xd3\xc5\x88\0\0\1\0"), "padding"),
        (with_checksum(GOLDEN["v5-alpha"][:40] + bytes(4)), "cut short"),
    ],
)
def test_what_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(BitstreamError, match=why):
        container.parse(data)
    with pytest.raises(RefusedError):
        plain_decoder_v5.read(data)


def test_small_budgets_make_short_files() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (12, 16, 3), np.uint8)
    for budget, is_short in (40, True), (1024, True), (1025, False):
        stream = container.parse(encode(picture, bytes=budget, effort=1).data)
        assert isinstance(stream, StreamV5)
        assert stream.is_short == is_short


@pytest.mark.parametrize("name", GOLDEN)
def test_a_text_is_a_file(name: str) -> None:
    text = to_text(GOLDEN[name])
    assert re.fullmatch(r"x[A-Za-z0-9_-]*", text)
    assert len(text) == -(-4 * (len(GOLDEN[name]) - 1) // 3)
    assert from_text(text) == GOLDEN[name]


def test_a_text_that_is_none_is_one_clear_error() -> None:
    text = to_text(GOLDEN["v5-color"])
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
    for wrong in (text + "=", text + "A", " " + text, text + "é", text.replace("x", "+", 1), ""):
        with pytest.raises(BitstreamError):
            from_text(wrong)
    padded = base64.urlsafe_b64encode(GOLDEN["v5-pixel"][1:]).decode()
    assert padded.endswith("=")
    with pytest.raises(BitstreamError, match="not the text"):
        from_text(padded)
    with pytest.raises(BitstreamError, match="exceed the limit"):
        from_text(text, Limits(max_pixels=10))
    with pytest.raises(BitstreamError, match="only files of version 5"):
        to_text(golden(4)["v4-color"])
