"""Version 2 in docs/format.md against the code, a decoder written from it alone against ours, and pinned bytes."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from sgmethod import BitstreamError, decode, encode
from sgmethod.bitstream import container
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.texture import Codes, cells, pack
from sgmethod.bitstream.v2 import MIN_QUANTUM, SMALLEST_ALPHA, SMALLEST_FILE, StreamV2, alpha_bytes, coded_background
from sgmethod.native import native
from sgmethod.scene import Gaussians
from sgmethod.view import MAX_COORDINATE, View
from tests.backend.cases import single
from tests.bitstream import plain_decoder_v2, remake
from tests.bitstream.document import rows, table
from tests.bitstream.plain_decoder_v2 import Gaussian, Header, RefusedError
from tests.support.data import damaged, golden, golden_path, with_checksum

GOLDEN = golden(2)
PARTS = (0.01, 0.1, 0.25, 0.5, 0.77, 0.99)


def test_golden_files_are_as_they_were_made() -> None:
    hashes = json.loads(golden_path("v2-hashes.json").read_text())
    made = {name: one["bytes"] for name, one in hashes.items()}
    assert {name: hashlib.sha256(data).hexdigest() for name, data in GOLDEN.items()} == made


def test_tables() -> None:
    """The tables beside the text, which the plain decoder reads, are the kernels'."""
    tables = plain_decoder_v2.tables()
    assert tables == remake.models(), "python -m tests.bitstream.remake"
    seconds = iter(("luma_by_group", "a_by_group", "b_by_luma", "v_by_group", "r_by_direction"))
    for row in table("i-th number of its row in [models.json](format/models.json). Symbols and their models are"):
        assert len(tables[row["symbol"]]) == int(row["first model: rows, chosen by"].split(":")[0])
        if row["second model"]:
            assert len(tables[next(seconds)]) == int(row["second model"].split(":")[0])


def stream_of(name: str) -> StreamV2:
    stream = container.parse(GOLDEN[name])
    assert isinstance(stream, StreamV2)
    return stream


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_finds_the_same(name: str) -> None:
    file, s = plain_decoder_v2.read(GOLDEN[name]), stream_of(name)
    assert file.header == Header(s.grey, s.upright, s.is_short, s.width, s.height, s.quantum, s.background)
    assert (file.alpha is None) == (s.alpha is None)
    if s.alpha is not None and file.alpha is not None:
        same = s.alpha.width, s.alpha.height, s.alpha.quantum, s.alpha.background
        assert file.alpha[0] == Header(True, False, s.is_short, *same)
        assert rows(s.alpha.gaussians()) == file.alpha_gaussians()
    assert file.codes == ([] if s.texture is None else s.texture.tolist())
    assert rows(s.gaussians()) == file.gaussians()
    for part in PARTS:
        assert rows(s.gaussians(part)) == file.part(math.ceil(part * len(s.payload)))
    assert container.serialise(s) == GOLDEN[name]
    assert sum(container.info(GOLDEN[name]).bits.values()) == 8 * len(GOLDEN[name])
    assert s.file_bytes == len(GOLDEN[name])


def test_views_far_out_are_crops() -> None:
    """Places are counted modulo MAX_COORDINATE; some are just before that, and across it."""
    rng = np.random.default_rng(5)
    n, size = 60, (60_000, 50)
    factors = np.exp(rng.uniform(0, 4, (n, 1)) + rng.normal(0, 0.4, (n, 3))) * (1, rng.choice([-1, 1]), 1)
    for x in (MAX_COORDINATE // 2 - 10, 50_001):
        means = rng.uniform(0, 1, (n, 2)) * (60, 50) + (x - 20, 0)
        gaussians = single(means, factors, rng.normal(0, 0.1, (n, 3)))
        data = container.serialise(StreamV2.from_gaussians(gaussians, size, 0.01, (120, 110, 100), grey=False))
        whole = decode(data, view=View(2.0, (x - 20, 0, 60, 50)))[22:46]
        for left in (0, 12, 20):  # before MAX_COORDINATE and behind it
            part = decode(data, view=View(2.0, (x + left, 11, 20, 12)))
            assert np.array_equal(part, whole[:, 40 + 2 * left : 80 + 2 * left])


def some_codes(size: tuple[int, int], seed: int) -> Codes:
    """Strengths of which half are 0."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(1, native.TEXTURE_STRENGTHS, (native.TEXTURE_OCTAVES, *cells(*size)))
    return (codes * rng.integers(0, 2, codes.shape)).astype(np.uint8)


@pytest.mark.parametrize("size", [(1, 1), (64, 64), (65, 128), (300, 200), (1, 5000)])
def test_texture_survives_packing(size: tuple[int, int]) -> None:
    for codes in (some_codes(size, 1), 0 * some_codes(size, 1), 0 * some_codes(size, 1) + 15):
        data = container.serialise(
            replace(StreamV2.from_gaussians(Gaussians.empty(0), size, 0.05, (9, 9, 9), False), texture=codes)
        )
        stream = container.parse(data)
        assert isinstance(stream, StreamV2)
        assert np.array_equal(stream.texture, codes)
        assert plain_decoder_v2.read(data).codes == codes.tolist()
        bits = container.info(data).bits
        assert bits["texture"] == 8 * len(pack(codes)) > 0
        assert sum(bits.values()) == 8 * len(data)
        assert container.info(data).to_dict()["texture"] is True


@given(
    st.sampled_from([*GOLDEN]),
    st.floats(0, 1),
    st.binary(min_size=1, max_size=4),
    st.integers(-3, 12),
    st.sampled_from([1.0, 0.5]),
)
def test_both_take_and_refuse_the_same_files(name: str, place: float, value: bytes, growth: int, part: float) -> None:
    """Bytes changed, the end moved, the checksum made to fit."""
    data = damaged(GOLDEN[name], place, value, growth)
    try:
        ours = rows(container.parse(data, Limits(1 << 20)).gaussians(part))
    except BitstreamError as error:
        if "limit" not in str(error):
            with pytest.raises(RefusedError):
                plain_gaussians(data, part)
    else:
        assert ours == plain_gaussians(data, part)


@given(
    st.sampled_from([(1, 1), (40, 50), (65, 3000), (1500, 900), (65_535, 65_535)]),
    st.integers(0, 3),
    st.integers(0, 32),
    st.integers(0, 32),
    st.binary(max_size=60),
    st.sampled_from([1.0, 0.5]),
)
def test_both_make_the_same_of_any_payload(
    size: tuple[int, int], flags: int, first: int, more: int, rest: bytes, part: float
) -> None:
    """Its classes are as they may be."""
    start = (first | min(more, 32 - first) << 6).to_bytes(2, "little")
    payload = (2**20).to_bytes(4, "little") + start + rest
    data = container.serialise(StreamV2(*size, 0.5078125, (123,) * 3, flags % 2 > 0, flags > 1, payload, is_short=True))
    try:
        ours = rows(container.parse(data).gaussians(part))
    except BitstreamError:
        with pytest.raises(RefusedError):
            plain_gaussians(data, part)
    else:
        assert ours == plain_gaussians(data, part)


def plain_gaussians(data: bytes, part: float) -> list[Gaussian]:
    file = plain_decoder_v2.read(data)
    return file.gaussians() if part == 1 else file.part(math.ceil(part * len(file.payload)))


def test_headers_of_known_sizes() -> None:
    for size, is_short, grey, least in [
        ((64, 64), True, False, 9),
        ((64, 64), False, False, 14),
        ((768, 512), True, False, 10),
        ((768, 512), True, True, 9),
        ((768, 512), False, False, 15),
        ((65535, 65535), True, False, SMALLEST_FILE),
        ((1, 1), True, True, StreamV2.MIN_BYTES),
    ]:
        background = coded_background((100, 100, 100) if grey else (255, 3, 120), is_short)
        stream = StreamV2(*size, StreamV2.coded_quantum(0.3, is_short), background, grey, False, b"", is_short=is_short)
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
        coded = StreamV2.coded_quantum(quantum, is_short)
        assert abs(coded / quantum - 1) <= most * 1.01
        assert StreamV2.coded_quantum(coded, is_short) == coded
    assert StreamV2.coded_quantum(1e-9, is_short) >= MIN_QUANTUM
    assert 15 < StreamV2.coded_quantum(1e9, is_short) < 16


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"\xd3\xc2\x80\0\0\0", "too short"),
        (with_checksum(b"\xd3\xc2\x87\xff\xff\xff\0"), "within its header"),
        (with_checksum(b"\xd3\xc2\x88\0\0\1\0"), "padding"),
        (with_checksum(GOLDEN["v2-alpha"][:40] + bytes(4)), "cut short"),
    ],
)
def test_what_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(BitstreamError, match=why):
        container.parse(data)
    with pytest.raises(RefusedError):
        plain_decoder_v2.read(data)


def test_small_budgets_make_short_files() -> None:
    picture = np.random.default_rng(1).integers(0, 256, (12, 16, 3), np.uint8)
    for budget, is_short in (40, True), (1024, True), (1025, False):
        stream = container.parse(encode(picture, bytes=budget, effort=1).data)
        assert isinstance(stream, StreamV2)
        assert stream.is_short == is_short
