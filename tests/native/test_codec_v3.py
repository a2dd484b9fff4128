"""The native codec of profile rd: what goes in comes out rounded, by no more than the steps say."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sgmethod import BitstreamError
from sgmethod.bitstream import container, v3
from sgmethod.bitstream.stream import Limits
from sgmethod.bitstream.v3 import MAX_QUANTUM, MIN_QUANTUM, StreamV3, quantum_code, quantum_of
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from tests.harness.data import with_checksum

CLASS_WIDTH = math.log(2) / 2
BASIS = np.array([[3**-0.5] * 3, [2**-0.5, 0, -(2**-0.5)], [6**-0.5, -2 * 6**-0.5, 6**-0.5]])
MIN_SCALE = np.float32(0.3)


def gaussians(means: object, factors: object, colors: object) -> Gaussians:
    return Gaussians(*(np.ascontiguousarray(values, np.float32) for values in (means, factors, colors)))


def scattered(n: int, size: tuple[int, int], seed: int = 0) -> Gaussians:
    """Of the sizes and colours that fits have, some around the picture."""
    rng = np.random.default_rng(seed)
    factors = np.exp(rng.uniform(-1, 3.5, (n, 1)) + rng.normal(0, 0.5, (n, 3)))
    factors[:, 1] *= rng.choice([-1, 0, 1], n)
    return gaussians(rng.uniform(-0.1, 1.1, (n, 2)) * size, factors, rng.normal(0, 0.2, (n, 3)))


def quantised(parameters: native.RdParameters, values: Gaussians) -> Gaussians:
    out = gaussians(*(np.full_like(a, np.nan) for a in (values.means, values.factors, values.colors)))
    native.rd_quantise(parameters, values.means, values.factors, values.colors, out.means, out.factors, out.colors)
    return out


def encoded(parameters: native.RdParameters, values: Gaussians) -> bytes:
    return native.rd_encode(parameters, values.means, values.factors, values.colors)


def decoded(parameters: native.RdParameters, payload: bytes, prefix: bool = False) -> Gaussians:
    return Gaussians(*native.rd_decode(parameters, payload, prefix))


def rows(values: Gaussians) -> FloatArray:
    return np.concatenate([values.means, values.factors, values.colors], 1)


def as_set(values: Gaussians) -> FloatArray:
    """The rows with a colour, sorted."""
    table = rows(values)[values.colors.any(1)]
    return table[np.lexsort(table.T)]


def assert_round_trip(parameters: native.RdParameters, values: Gaussians) -> Gaussians:
    payload = encoded(parameters, values)
    found = decoded(parameters, payload)
    assert np.isfinite(rows(found)).all()
    assert (found.factors[:, [0, 2]] >= MIN_SCALE).all()
    assert np.array_equal(as_set(found), as_set(quantised(parameters, values)))
    return found


@pytest.mark.parametrize("seed", range(30))
def test_decoding_gives_what_rounding_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = tuple(int(v) for v in rng.integers(60, 900, 2))
    grey, upright = bool(seed & 1), bool(seed & 2)
    values = scattered(int(rng.integers(0, 1500)), size, seed)
    if upright:
        values.factors[:, 1] = 0
    assert_round_trip(native.RdParameters(*size, 0.003 * 4.0 ** (seed % 5), grey, upright), values)


@pytest.mark.parametrize("n", range(12))
def test_few(n: int) -> None:
    """Short payloads, where the first state is most of what there is."""
    for seed in range(40):
        values = scattered(n, (40, 30), seed)
        assert_round_trip(native.RdParameters(40, 30, 0.05), values)


def hostile(size: tuple[int, int], n: int = 900) -> Gaussians:
    """Scales, shears, places and colours over all that float32 has, and what is no number."""
    rng = np.random.default_rng(5)
    means = rng.normal(0, 1, (n, 2)) * 10 ** rng.uniform(-40, 38, (n, 2))
    means[::2] = rng.uniform(0, 1, (len(means[::2]), 2)) * size
    factors = 10 ** rng.uniform(-44, 38, (n, 3))
    factors[::3] = 10 ** rng.uniform(-3, 5, (len(factors[::3]), 3))
    factors[:, 1] *= rng.choice([-1, 1], n)
    colors = rng.normal(0, 1, (n, 3)) * 10 ** rng.uniform(-10, 38, (n, 1))
    special = [np.nan, np.inf, -np.inf, 0.0, -1.0]
    for column, array in itertools.product(range(3), (means, factors, colors)):
        if column < array.shape[1]:
            at = rng.integers(0, n, len(special))
            array[at, column] = special
    with np.errstate(over="ignore"):
        return gaussians(means, factors, colors)


@pytest.mark.parametrize("quantum", [MIN_QUANTUM, 0.1, MAX_QUANTUM])
@pytest.mark.parametrize("size", [(1, 1), (30, 30), (1, 65535), (65535, 65535)])
def test_extreme_values(size: tuple[int, int], quantum: float) -> None:
    """Everything finite with positive scales is coded, and lands in or near the picture."""
    values = hostile(size)
    if size == (1, 1):
        values = Gaussians(*(a[:1] for a in (values.means, values.factors, values.colors)))
    parameters = native.RdParameters(*size, quantum)
    found = assert_round_trip(parameters, values)
    assert (found.means > -3 * 2**14).all()
    assert (found.means < np.array(size) + 4 * 2**14).all()


@pytest.mark.parametrize("where", [(0, 0), (0, 1), (1, 0), (1, 2), (2, 1)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_left_out(where: tuple[int, int], value: float) -> None:
    values = scattered(1, (20, 20))
    (values.means, values.factors, values.colors)[where[0]][0, where[1]] = value
    parameters = native.RdParameters(20, 20, 0.01)
    assert encoded(parameters, values) == encoded(parameters, scattered(0, (20, 20)))
    assert not quantised(parameters, values).colors.any()


def test_what_rounds_to_no_colour_is_left_out() -> None:
    values = scattered(300, (100, 100))
    values.colors[::2] = 0
    found = assert_round_trip(native.RdParameters(100, 100, 1e-3), values)
    assert len(found) == 150
    assert len(assert_round_trip(native.RdParameters(100, 100, 16.0), values)) < 30


def test_errors_stay_within_the_steps() -> None:
    """Half a step of each parameter, from the formulas in docs/format.md."""
    quantum, size = 0.02, (300, 200)
    values = scattered(2000, size)
    values.means[:] = np.random.default_rng(1).uniform(0, 1, (2000, 2)) * size
    rounded = quantised(native.RdParameters(*size, quantum), values)
    kept = rounded.colors.any(1) & (values.factors[:, [0, 2]] > 1).all(1)  # no scale at its minimum
    assert kept.sum() > 800
    before, after = (
        (g.means[kept].astype(float), g.factors[kept].astype(float), g.colors[kept] @ BASIS.T)
        for g in (values, rounded)
    )
    k = np.round(0.5 * np.log(before[1][:, 0] * before[1][:, 2]) / CLASS_WIDTH)
    color_step = quantum / (2 ** (k / 2) * 1.5)
    slack = 1 + 1e-4
    assert (np.abs(after[2] - before[2]) <= slack * 0.5 * color_step[:, None]).all()
    m = np.linalg.norm(after[2], axis=1) / color_step
    h = np.round(np.log2(m))

    def frame(factors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        l1, l2, l3 = factors.T
        return 0.5 * np.log(l1 * l3), 0.5 * np.log(l1 / l3), l2 / l3

    (u0, v0, _), (u1, v1, r1) = frame(before[1]), frame(after[1])
    # The slope l2 / l1 is what is kept, in the scales that are decoded.
    r0 = before[1][:, 1] / before[1][:, 0] * after[1][:, 0] / after[1][:, 2]
    assert (np.abs(u1 - u0) <= slack * 0.5 * CLASS_WIDTH / 2 ** np.clip(h - 1, 0, 8)).all()
    assert (np.abs(v1 - v0) <= slack * 0.5 * 2**-h + 1e-6).all()
    assert (np.abs(r1 - r0) <= slack * 2**-h + 1e-6).all()
    l1, _, l3 = after[1].T
    step = math.sqrt(2) / m
    moved = np.abs(after[0] - before[0])
    assert (moved[:, 0] <= slack * 0.5 * step * l1 / np.sqrt(1 + r1**2) + 1e-5).all()
    assert (moved[:, 1] <= slack * 0.5 * step * l3 + 1e-5).all()


def test_a_finer_quantum_is_closer_and_larger() -> None:
    values, size = scattered(400, (200, 150)), (200, 150)
    sizes, errors = [], []
    for quantum in (1.0, 0.25, 0.06, 0.015, 0.004):
        parameters = native.RdParameters(*size, quantum)
        sizes.append(len(encoded(parameters, values)))
        errors.append(float(np.abs(quantised(parameters, values).colors - values.colors).mean()))
    assert sizes == sorted(sizes)
    assert errors == sorted(errors, reverse=True)


def test_what_is_not_in_the_picture_costs_little() -> None:
    values = scattered(500, (200, 200))
    values.colors[:] = values.colors[:, 1:2]
    plain, grey = (len(encoded(native.RdParameters(200, 200, 0.02, flag), values)) for flag in (False, True))
    assert plain - 40 < grey < plain
    values.factors[:, 1] = 0
    sheared, upright = (len(encoded(native.RdParameters(200, 200, 0.02, True, flag), values)) for flag in (False, True))
    assert sheared - 40 < upright < sheared <= grey


def test_grey_drops_chroma_and_upright_drops_shear() -> None:
    values = scattered(200, (100, 100))
    found = assert_round_trip(native.RdParameters(100, 100, 0.01, True, True), values)
    assert not found.factors[:, 1].any()
    assert np.ptp(found.colors, axis=1).max() < 1e-6


def test_an_empty_payload_has_no_bytes() -> None:
    parameters = native.RdParameters(50, 50, 0.1)
    assert encoded(parameters, scattered(0, (50, 50))) == b""
    assert len(decoded(parameters, b"")) == 0


def test_thousands_in_one_place() -> None:
    """They cost next to nothing, but a payload is as long as a decoder needs it to be to believe in them."""
    one = gaussians([[50.5, 50.5]], [[1, 0, 1]], [[0.5, 0.5, 0.5]])
    many = Gaussians(*(np.repeat(a, 9000, 0) for a in (one.means, one.factors, one.colors)))
    parameters = native.RdParameters(100, 100, 1.5)
    payload = encoded(parameters, many)
    assert 9000 <= 8 * len(payload) + 64 <= 9000 + 8
    assert_round_trip(parameters, many)
    for cut in (1, 100, len(payload) - 1):
        found = decoded(parameters, payload[:cut], prefix=True)
        assert len(found) <= 8 * cut + 64
        assert (rows(found) == rows(quantised(parameters, one))).all()


def test_more_gaussians_than_pixels() -> None:
    with pytest.raises(ValueError, match="more Gaussians than pixels"):
        encoded(native.RdParameters(2, 2, 1e-3), scattered(5, (2, 2)))
    assert_round_trip(native.RdParameters(5, 1, 1e-3), scattered(5, (5, 1)))


def test_the_far_end_of_the_largest_picture() -> None:
    """Cells have 16-bit coordinates, so the smallest Gaussians on the last pixels move by up to two."""
    last = 65534.5
    for scale, moved in ((0.3, 2.0), (1.0, 2.0), (2.0, 0.1), (50.0, 1.0)):
        values = gaussians([[last, last]], [[scale, 0, scale]], [[0.5, 0.5, 0.5]])
        found = assert_round_trip(native.RdParameters(65535, 65535, 0.01), values)
        assert np.abs(found.means - last).max() <= moved


@pytest.mark.parametrize("seed", range(4))
def test_every_cut_gives_the_first_gaussians(seed: int) -> None:
    parameters = native.RdParameters(120, 90, 0.1, bool(seed & 1))
    payload = encoded(parameters, scattered(150, (120, 90), seed))
    whole = rows(decoded(parameters, payload))
    counts = []
    for cut in range(len(payload) + 1):
        part = rows(decoded(parameters, payload[:cut], prefix=True))
        assert np.array_equal(part, whole[: len(part)])
        counts.append(len(part))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[len(payload) // 2] > 0.35 * len(whole)
    assert counts[-1] == len(whole)


def test_prefix_of_a_stream() -> None:
    values = scattered(300, (120, 90))
    stream = StreamV3.of(values, (120, 90), 0.05, (1, 2, 3), False)
    whole = stream.gaussians()
    sizes = np.sqrt(whole.factors[:, 0] * whole.factors[:, 2])
    sizes = sizes[sizes > 1]  # of the smallest, one side may be at its least
    assert (sizes[1:] <= sizes[:-1] * math.sqrt(2) * 1.001).all()  # by classes, from the largest down
    for prefix in (1e-9, 0.2, 0.5, 0.999):
        part = stream.gaussians(prefix)
        assert np.array_equal(rows(part), rows(whole)[: len(part)])
        assert len(part) == pytest.approx(prefix * len(whole), abs=0.12 * len(whole))


@pytest.mark.parametrize("cut", [1, 9, 40])
def test_a_cut_payload_is_refused(cut: int) -> None:
    parameters = native.RdParameters(120, 90, 0.1)
    payload = encoded(parameters, scattered(150, (120, 90)))
    with pytest.raises(RuntimeError):
        decoded(parameters, payload[:-cut])
    with pytest.raises(RuntimeError, match="behind the last"):
        decoded(parameters, payload + b"\0" * 8 + b"\1")
    assert np.array_equal(rows(decoded(parameters, payload + b"\0" * cut)), rows(decoded(parameters, payload)))
    with pytest.raises(RuntimeError, match="begins"):
        decoded(parameters, b"\0\0\xff\xff" + payload)


def test_exact_bytes() -> None:
    """Values well within their steps, so that no machine's logarithm matters."""
    values = gaussians(
        [[10.3, 20.4], [40.6, 5.2], [40.7, 5.3], [1.1, 46.2]],
        [[8.3, 1.2, 5.1], [2.2, 0, 2.3], [0.9, -0.4, 1.7], [0.4, 0.1, 0.5]],
        [[0.31, 0.22, 0.13], [-0.2, 0.1, 0.3], [0.5, 0.4, 0.4], [0.9, -0.9, 0.8]],
    )
    data = container.serialise(StreamV3.of(values, (64, 48), 0.1, (128, 64, 32), False))
    assert data.hex() == (
        "53474d03ff74d1ef00004000300" + "89a80402005fd21d79042ace09b7ef0239b28feb4040634421dc4a7950ad091c11dafad4c"
    )


@pytest.mark.parametrize("quantum", [1e-9, MIN_QUANTUM, 0.0123, 0.1, 0.999, 1.0, 1.9999, 3.3, MAX_QUANTUM, 1e9])
def test_quantum_round_trip(quantum: float) -> None:
    code = quantum_code(quantum)
    assert quantum_code(quantum_of(code)) == code
    clamped = min(max(quantum, MIN_QUANTUM), MAX_QUANTUM)
    assert quantum_of(code) == pytest.approx(clamped, rel=1 / 511)


def test_quantum_is_monotone() -> None:
    found = [quantum_of(quantum_code(q)) for q in np.geomspace(MIN_QUANTUM / 2, 2 * MAX_QUANTUM, 20_000)]
    assert found == sorted(found)
    assert len(set(found)) == 14 * 256 + 1
    assert all(quantum_code(q) == code for code in (0, *range(256, 3840)) for q in [quantum_of(code)])


def test_stream_round_trip() -> None:
    for grey, shear in itertools.product((False, True), (0, 1)):
        values = scattered(40, (70, 50))
        values.factors[:, 1] *= shear
        stream = StreamV3.of(values, (70, 50), 0.1, (9, 8, 7), grey)
        assert (stream.grey, stream.upright) == (grey, not shear)
        data = container.serialise(stream)
        assert container.parse(data) == stream
        assert sum(stream.size_bits().values()) == 8 * len(data)


@pytest.mark.parametrize(
    ("at", "value", "why"),
    [
        (4, b"\0\0\0\0", "checksum"),
        (8, b"\4", "flags"),
        (9, b"\0\0", "size is 0 x"),
        (11, b"\0\0", "x 0"),
        (13, b"\0\1", "quantum"),
        (13, b"\x0f\0", "quantum"),
        (18, b"\0\0", "begins"),
    ],
)
def test_refused_headers(at: int, value: bytes, why: str) -> None:
    data = container.serialise(StreamV3.of(scattered(40, (70, 50)), (70, 50), 0.1, (9, 8, 7), False))
    data = data[:at] + value + data[at + len(value) :]
    with pytest.raises(BitstreamError, match=why):
        container.parse(data if at == 4 else with_checksum(data)).gaussians()


def test_a_limit_of_gaussians() -> None:
    stream = StreamV3.of(
        gaussians([[35, 25]] * 3000, [[9, 0, 9]] * 3000, [[0.5, 0, 0]] * 3000), (70, 50), 0.1, (9, 8, 7), False
    )
    assert len(stream.gaussians(limits=Limits(max_gaussians=3000))) == 3000
    for prefix in (1.0, 0.9):
        with pytest.raises(BitstreamError, match=r"limit of 2999$"):
            stream.gaussians(prefix, Limits(max_gaussians=2999))


def test_limits_of_parse() -> None:
    data = container.serialise(StreamV3.of(scattered(40, (70, 50)), (70, 50), 0.1, (9, 8, 7), False))
    assert container.parse(data, Limits(max_pixels=3500)).width == 70
    with pytest.raises(BitstreamError, match="limit of 3499"):
        container.parse(data, Limits(max_pixels=3499))
    for length in range(v3.HEADER_BYTES):
        with pytest.raises(BitstreamError):
            container.parse(with_checksum(data[:length]) if length > 8 else data[:length])
