"""Version 4 in docs/format.md against the code, a decoder written from it alone against ours, and pinned bytes."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sgmethod import BitstreamError, decode
from sgmethod.bitstream import container, v3, v4
from sgmethod.bitstream.payload import MIN_QUANTUM
from sgmethod.bitstream.texture import Codes, cells, pack
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.native import native
from sgmethod.scene import Gaussians
from sgmethod.view import MAX_COORDINATE, View
from tests.bitstream import plain_decoder_v3, plain_decoder_v4
from tests.bitstream.plain_decoder import RefusedError
from tests.bitstream.plain_decoder_v3 import Gaussian, Header, Numbers
from tests.bitstream.plain_decoder_v4 import NUMBERS, Coder, Model, Number
from tests.bitstream.test_format_v1 import TEXT
from tests.bitstream.test_format_v3 import PARTS, assert_same_pixels, rows
from tests.harness.data import ROOT, damaged, golden, golden_path, with_checksum

GOLDEN = golden(4)
HASHES = json.loads(golden_path("v4-hashes.json").read_text())
NATIVE = ROOT / "sgmethod" / "native"
NOTHING = Gaussians(*(np.zeros((0, n), np.float32) for n in (2, 3, 3)))


def limits_in_the_code(version: int) -> Numbers:
    """Those of the kernels (symbols.h): 1e300 and 64 stand for no limit."""
    source = (NATIVE / "rd" / "symbols.h").read_text()
    found = re.findall(rf"kLimitsV{version} = \{{(.*)\}};", source)[0]
    color, v, r, steps, exponent, u_bits, part_bits, color_step = found.split(", ")
    one, shift = color.split(" << ")
    over = [float(part) for part in color_step.split(" / ")]
    return Numbers(
        version=version,
        most_colour=int(one) << int(shift),
        most_h=float(exponent) if exponent != "64" else float("inf"),
        most_u_bits=int(u_bits),
        most_part_bits=int(part_bits),
        most_shape=float(steps.replace("1e300", "inf")),
        most_v=float(v),
        most_r=float(r.replace("1e300", "inf")),
        least_colour_step=over[0] / over[1] if len(over) == 2 else over[0],
        most_flags={3: v3, 4: v4}[version].HEADER.fields[0].high,
    )


def test_the_numbers_are_the_codes() -> None:
    """Those of the table in the text, which the plain decoder reads, and those of version 3."""
    assert limits_in_the_code(4) == NUMBERS
    assert limits_in_the_code(3) == plain_decoder_v3.V3
    narrowest, top_level = f"= {plain_decoder_v4.NARROWEST:g}", f"= {plain_decoder_v4.TOP_LEVEL}"
    assert f"kMostRawDistanceBits = {plain_decoder_v4.MOST_RAW};" in (NATIVE / "rd" / "codec.cpp").read_text()
    kernels, reference = ((NATIVE / path).read_text() for path in ("raster/levels.h", "reference.py"))
    assert f"kNarrowest {narrowest};" in kernels
    assert f"kMaxLevel {top_level};" in kernels
    assert "kBorder = 2;" in kernels
    assert f"\nNARROWEST {narrowest}  #" in reference
    assert f"\nMAX_LEVEL {top_level}\n" in reference
    of_texture = native.TEXTURE_OCTAVES, native.TEXTURE_CELL, native.TEXTURE_STRENGTHS - 1
    assert of_texture == (plain_decoder_v4.OCTAVES, plain_decoder_v4.CELL, plain_decoder_v4.MOST_STRENGTH)


def test_the_version_and_the_views_in_the_text() -> None:
    assert f"# Version {StreamV4.VERSION}\n" in TEXT
    assert f"OX = floor(X * sx) mod {MAX_COORDINATE} " in TEXT
    assert MAX_COORDINATE % 2**plain_decoder_v4.TOP_LEVEL == 0


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bytes_and_pixels(name: str) -> None:
    """Exact: tests/bitstream/make_golden.py wrote the hashes when the streams were made."""
    assert hashlib.sha256(GOLDEN[name]).hexdigest() == HASHES[name]["bytes"]
    assert hashlib.sha256(decode(GOLDEN[name]).tobytes()).hexdigest() == HASHES[name]["pixels"]


def levels(gaussians: Gaussians) -> list[int]:
    return [plain_decoder_v4.level_of(*factor) for factor in gaussians.factors.astype(np.float64)]


def test_golden_streams_show_everything() -> None:
    assert GOLDEN.keys() == HASHES.keys()
    streams = {name: container.parse(data) for name, data in GOLDEN.items()}
    assert {(s.grey, s.upright) for s in streams.values()} == {
        (False, False),
        (True, False),
        (False, True),
        (True, True),
    }
    assert {(s.width, s.height, len(s.gaussians())) for s in streams.values()} >= {(7, 5, 0), (1, 1, 1)}
    assert set(levels(streams["v4-every-class"].gaussians())) == set(range(plain_decoder_v4.TOP_LEVEL + 1))
    assert len(set(levels(streams["v4-levels"].gaussians()))) > 5
    assert max(levels(streams["v4-color"].gaussians())) > 1
    codes = [s.texture for s in streams.values() if s.texture is not None]
    assert set(np.concatenate([c.ravel() for c in codes])) == set(range(native.TEXTURE_STRENGTHS))
    alphas = [s.alpha for s in streams.values() if isinstance(s, StreamV4) and s.alpha is not None]
    assert {len(alpha.gaussians()) > 0 for alpha in alphas} == {False, True}
    shown = decode(GOLDEN["v4-alpha"])[..., 3]
    assert 0.1 < np.isin(shown, (0, 255)).mean() < 0.9  # what is clamped, and what is not
    assert {bool(c[1].any()) for c in codes} == {False, True}  # the highest level of a picture without Gaussians


def test_a_golden_stream_has_needles_that_version_3_would_turn() -> None:
    needles = container.parse(GOLDEN["v4-needles"])
    assert needles.quantum == MIN_QUANTUM
    _, l2, l3 = needles.gaussians().factors.T
    assert np.abs(l2 / l3).max() > 5 * 64  # seen: 400; version 3 would make 64 of it


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_finds_the_same_gaussians(name: str) -> None:
    file = plain_decoder_v4.read(GOLDEN[name])
    header, plain = file.header, file.gaussians()
    s = container.parse(GOLDEN[name])
    textured = isinstance(s, StreamV4) and s.texture is not None
    alpha = s.alpha if isinstance(s, StreamV4) else None
    kinds = textured, alpha is not None
    assert header == Header(s.grey, s.upright, s.width, s.height, s.quantum, s.background, NUMBERS, *kinds)
    if alpha is not None:
        assert file.alpha is not None
        same = alpha.grey, alpha.upright, alpha.width, alpha.height, alpha.quantum, alpha.background
        assert file.alpha[0] == Header(*same, NUMBERS)
        assert rows(alpha.gaussians()) == file.alpha_gaussians()
    if textured:
        assert s.texture.tolist() == file.codes
    assert rows(s.gaussians()) == plain
    for part in PARTS:
        assert rows(s.gaussians(part)) == file.part(part)


@pytest.mark.parametrize("name", GOLDEN)
def test_the_plain_decoder_draws_the_same_picture(name: str) -> None:
    """Seen, here and in the views below: no sample differs."""
    assert_same_pixels(plain_decoder_v4.decode(GOLDEN[name]), decode(GOLDEN[name]))


@pytest.mark.parametrize("name", GOLDEN)
@pytest.mark.parametrize("scale", [0.4, 1.0, 2.3])
def test_the_plain_decoder_draws_the_same_views(name: str, scale: float) -> None:
    """Of all, and of a region that begins at odd places."""
    s = container.parse(GOLDEN[name])
    region = s.width // 3, s.height // 2, (s.width + 2) // 3, (s.height + 3) // 4
    for view in (View(scale), View(scale, region)):
        plain = plain_decoder_v4.view(GOLDEN[name], view.scale, view.region)
        assert_same_pixels(plain, decode(GOLDEN[name], view=view))


def test_the_plain_decoder_draws_the_same_views_far_out() -> None:
    """Where places are counted modulo MAX_COORDINATE, and just before and across that."""
    rng = np.random.default_rng(5)
    n, size = 60, (60_000, 50)
    factors = np.exp(rng.uniform(0, 4, (n, 1)) + rng.normal(0, 0.4, (n, 3))) * (1, rng.choice([-1, 1]), 1)
    for x in (MAX_COORDINATE // 2 - 10, 50_001):
        means = rng.uniform(0, 1, (n, 2)) * (60, 50) + (x - 20, 0)
        gaussians = Gaussians(*(a.astype(np.float32) for a in (means, factors, rng.normal(0, 0.1, (n, 3)))))
        data = container.serialise(StreamV4.of(gaussians, size, 0.01, (120, 110, 100), grey=False))
        view = View(2.0, (x, 11, 20, 12))
        assert_same_pixels(plain_decoder_v4.view(data, view.scale, view.region), decode(data, view=view))


def test_the_plain_decoder_shares_nothing() -> None:
    source = Path(plain_decoder_v4.__file__).read_text()
    imports = re.findall(r"^(?:from|import) ([\w.]+)", source, re.MULTILINE)
    others = {f"tests.bitstream{name}" for name in ("", ".plain_decoder", ".plain_decoder_v3")}
    assert set(imports) == {"__future__", "collections.abc", "dataclasses", "math", "re", "struct", *others}


@dataclass(frozen=True)
class Known(Number):
    """A number whose rest is known already."""

    value: int = 0


class Scribe(Coder):
    """Stands where the plain decoder has its entropy decoder: says given values, then zeros, and writes them down."""

    def __init__(self, values: list[int]) -> None:
        super().__init__(b"")
        self.payload = bytes(64)
        self.values = values
        self.steps: list[
            tuple[int, int, int]
        ] = []  # where a symbol begins, its share, its state; or bits fetched, 0, 0
        self.bits: list[int] = []
        self.states = [65536, 65536]

    @property
    def past_end(self) -> bool:
        return False

    def next(self) -> int:
        return self.values.pop(0) if self.values else 0

    def write(self, which: int, model: Model, symbol: int) -> None:
        self.steps.append((model.edge(symbol), model.edge(symbol + 1) - model.edge(symbol), which))
        model.adapt(symbol)

    def write_bits(self, value: int, count: int) -> None:
        self.bits += [value >> k & 1 for k in range(count)]

    def symbol(self, which: int, model: Model) -> int:
        symbol = self.next()
        self.write(which, model, symbol)
        return symbol

    def fetch(self, count: int) -> None:
        self.steps.append((count, 0, 0))

    def take(self, count: int) -> int:
        value = self.next()
        self.write_bits(value, count)
        return value

    def number(self, which: int, model: Model) -> Number:
        value = self.next()
        n = value.bit_length() - 1
        if value < 4:
            self.write(which, model, value)
            return Known(value, 0, value, value)
        if value < 192:
            symbol = 2 * n + (value >> n - 1) % 2
            self.write(which, model, symbol)
            return Known(value >> n - 1 << n - 1, n - 1, symbol, value)
        self.write(which, model, 15)
        for part, count in (n, 5), (value - 2**n, n):
            self.fetch(count)
            self.write_bits(part, count)
        return Known(value, 0, 15, value)

    def rest(self, number: Number) -> int:
        assert isinstance(number, Known)
        self.write_bits(number.value - number.least, number.rest)
        return number.value

    def written(self) -> bytes:
        """The payload: of each state, the last of the steps is coded first."""
        states, words = [65536, 65536], [b""] * len(self.steps)
        for i, (low, share, which) in reversed(list(enumerate(self.steps))):
            if share == 0:
                continue
            if states[which] >= share << 17:
                words[i] = (states[which] % 65536).to_bytes(2, "little")
                states[which] >>= 16
            states[which] = (states[which] // share << 15) + states[which] % share + low
        raw = sum(bit << k for k, bit in enumerate(self.bits)).to_bytes(len(self.bits) // 8 + 8, "little")
        queued = at = 0
        for i, (count, share, _) in enumerate(self.steps):
            if share == 0:
                more = (max(count - queued, 0) + 7) // 8
                words[i] = raw[at : at + more]
                queued, at = queued + 8 * more - count, at + more
        return b"".join(state.to_bytes(4, "little") for state in states) + b"".join(words)


def one_gaussian(y: int, v: int, r: int) -> bytes:
    """A file with one Gaussian of size 1 in the midst of 9 by 9 pixels; the integers may be out of their range."""
    # First and last class, number in it; distance in steps of 2^5, y, a, b, the rest of the distance; signs, v, r.
    scribe = Scribe([28, 0, 1, 3, y, 0, 0, 12, 0, v, r])
    header = Header(False, False, 9, 9, 1.0, (0, 0, 0), NUMBERS)
    refused = b""
    try:
        list(plain_decoder_v4.read_gaussians(header, scribe, part=False))
    except RefusedError:
        refused = bytes(16)  # so that the payload does not end there
    payload = scribe.written() + refused
    stream = StreamV4(9, 9, header.quantum, header.background, header.grey, header.upright, payload)
    return container.serialise(stream)


# Steps of v and r are no finer than this, however long the colour is.
PER_STEP = 2 ** int(NUMBERS.most_h)
MOST_Y, MOST_V, MOST_R = NUMBERS.most_colour, int(NUMBERS.most_v), int(NUMBERS.most_r) // 2


@pytest.mark.parametrize(
    ("within", "beyond"),
    [
        ((MOST_Y, 0, 0), (MOST_Y + 1, 0, 0)),
        ((1, MOST_V, 0), (1, MOST_V + 1, 0)),
        ((1, 0, MOST_R), (1, 0, MOST_R + 1)),
        ((PER_STEP, MOST_V * PER_STEP, 0), (PER_STEP, MOST_V * PER_STEP + 1, 0)),
        ((MOST_Y, MOST_V * PER_STEP, 0), (MOST_Y, MOST_V * PER_STEP + 1, 0)),
        ((MOST_Y, 7, MOST_R * PER_STEP), (MOST_Y, 7, MOST_R * PER_STEP + 1)),
    ],
)
def test_limits_of_the_integers(within: tuple[int, int, int], beyond: tuple[int, int, int]) -> None:
    data = one_gaussian(*within)
    found = rows(container.parse(data).gaussians())
    assert len(found) == 1
    assert found == plain_decoder_v4.parse(data)[1]
    data = one_gaussian(*beyond)
    with pytest.raises(BitstreamError, match=r"(shape|colour) is out of range"):
        container.parse(data).gaussians()
    with pytest.raises(RefusedError, match=r"shape|colour"):
        plain_decoder_v4.parse(data)


def textured(codes: Codes, size: tuple[int, int], gaussians: Gaussians = NOTHING, grey: bool = False) -> StreamV4:
    return replace(StreamV4.of(gaussians, size, 0.05, (120, 110, 100), grey), texture=codes)


def some_codes(size: tuple[int, int], seed: int) -> Codes:
    """Strengths of which half are 0."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(1, native.TEXTURE_STRENGTHS, (native.TEXTURE_OCTAVES, *cells(*size)))
    return (codes * rng.integers(0, 2, codes.shape)).astype(np.uint8)


@pytest.mark.parametrize("size", [(1, 1), (64, 64), (65, 128), (300, 200), (1, 5000)])
def test_texture_survives_packing(size: tuple[int, int]) -> None:
    for codes in (some_codes(size, 1), 0 * some_codes(size, 1), 0 * some_codes(size, 1) + 15):
        data = container.serialise(textured(codes, size))
        stream = container.parse(data)
        assert isinstance(stream, StreamV4)
        assert np.array_equal(stream.texture, codes)
        assert plain_decoder_v4.read(data).codes == codes.tolist()
        bits = container.info(data).bits
        assert bits["texture"] == 8 * len(pack(codes)) > 0
        assert sum(bits.values()) == 8 * len(data)
        assert container.info(data).to_dict()["texture"] is True


@pytest.mark.parametrize(
    ("part", "why"),
    [(b"", "within its texture"), (b"\xff" * 9, "within its texture"), (b"\x80", "range"), (b"\x20", "padding")],
)
def test_texture_that_is_refused(part: bytes, why: str) -> None:
    """Of a picture of one cell: -1, and a bit behind the last code."""
    whole = container.serialise(textured(some_codes((9, 7), 1), (9, 7)))
    data = with_checksum(whole[:18] + part)
    with pytest.raises(BitstreamError, match=why):
        container.parse(data)
    with pytest.raises(RefusedError):
        plain_decoder_v4.read(data)


def gaussians_of(data: bytes, part: float) -> tuple[Header, list[Gaussian]]:
    file = plain_decoder_v4.read(data)
    return file.header, file.gaussians() if part == 1 else file.part(part)


def assert_same_outcome(data: bytes, part: float = 1.0) -> None:
    """The same Gaussians in both decoders, or both refuse."""
    try:
        ours = rows(container.parse(data).gaussians(part))
    except BitstreamError:
        with pytest.raises(RefusedError):
            gaussians_of(data, part)
    else:
        header, plain = gaussians_of(data, part)
        assert ours == plain
        assert header.width * header.height >= len(plain)


@pytest.mark.parametrize("name", golden(3))
def test_files_of_version_3_under_another_number(name: str) -> None:
    """They mean something else, or nothing."""
    data = golden(3)[name]
    assert_same_outcome(data[:3] + b"\4" + data[4:])


@given(
    st.sampled_from(["v4-color", "v4-grey", "v4-upright", "v4-needles", "v4-empty", "v4-pixel", "v4-texture"]),
    st.floats(0, 1),
    st.binary(min_size=1, max_size=4),
    st.integers(-3, 12),
    st.sampled_from([1.0, 0.5]),
)
def test_both_take_and_refuse_the_same_files(name: str, place: float, value: bytes, growth: int, part: float) -> None:
    """Bytes changed, the end moved, the checksum made to fit."""
    assert_same_outcome(damaged(GOLDEN[name], place, value, growth), part)
