"""The native codec of profile rd: what goes in comes out rounded, by no more than the steps say, within its limits."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sgmethod.bitstream.v2 import MAX_QUANTUM, MIN_QUANTUM
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from tests.backend.cases import scattered, single

U_BITS = 12  # by which a class is divided at most
CLASS_WIDTH = math.log(2) / 2
BASIS = np.array([[3**-0.5] * 3, [2**-0.5, 0, -(2**-0.5)], [6**-0.5, -2 * 6**-0.5, 6**-0.5]])
MIN_SCALE = np.float32(0.3)


def quantised(parameters: native.RdParameters, values: Gaussians) -> Gaussians:
    out = single(*(np.full_like(a, np.nan) for a in (values.means, values.factors, values.colors)))
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
    values = scattered(int(rng.integers(0, 1500)), seed, size)
    if upright:
        values.factors[:, 1] = 0
    assert_round_trip(native.RdParameters(*size, 0.003 * 4.0 ** (seed % 5), grey, upright), values)


@pytest.mark.parametrize("n", range(12))
def test_few(n: int) -> None:
    """Short payloads, where the first state is most of what there is."""
    for seed in range(40):
        values = scattered(n, seed, (40, 30))
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
        return single(means, factors, colors)


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


def test_what_rounds_to_no_colour_is_left_out() -> None:
    values = scattered(300, 0, (100, 100))
    values.colors[::2] = 0
    found = assert_round_trip(native.RdParameters(100, 100, 1e-3), values)
    assert len(found) == 150
    assert len(assert_round_trip(native.RdParameters(100, 100, 16.0), values)) < 30


@pytest.mark.parametrize("quantum", [0.02, 0.002])
def test_errors_stay_within_the_steps(quantum: float) -> None:
    """Half a step of each parameter, from the formulas in docs/format.md."""
    size = (300, 200)
    values = scattered(2000, 0, size)
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
    assert (np.abs(u1 - u0) <= slack * 0.5 * CLASS_WIDTH / 2 ** np.clip(h - 1, 0, U_BITS)).all()
    assert (np.abs(v1 - v0) <= slack * 0.5 * 2**-h + 1e-6).all()
    assert (np.abs(r1 - r0) <= slack * 2**-h + 1e-6).all()
    l1, _, l3 = after[1].T
    # The parts of a cell are counted by logarithms in sixteenths. So they may be a little wider than a step: 1.08 times
    # is the worst seen.
    step = math.sqrt(2) / m * 1.13
    moved = np.abs(after[0] - before[0])
    assert (moved[:, 0] <= slack * 0.5 * step * l1 / np.sqrt(1 + r1**2) + 1e-5).all()
    assert (moved[:, 1] <= slack * 0.5 * step * l3 + 1e-5).all()


def test_what_is_not_in_the_picture_costs_little() -> None:
    values = scattered(500, 0, (200, 200))
    values.colors[:] = values.colors[:, 1:2]
    plain, grey = (len(encoded(native.RdParameters(200, 200, 0.02, flag), values)) for flag in (False, True))
    assert plain - 40 < grey < plain
    values.factors[:, 1] = 0
    sheared, upright = (len(encoded(native.RdParameters(200, 200, 0.02, True, flag), values)) for flag in (False, True))
    assert sheared - 80 < upright < sheared <= grey  # shear has many models, each of which has to learn


def test_thousands_in_one_place() -> None:
    """They cost little more than the three bits that a distance has without a model."""
    one = single([[50.5, 50.5]], [[1, 0, 1]], [[0.5, 0.5, 0.5]])
    many = Gaussians(*(np.repeat(a, 9000, 0) for a in (one.means, one.factors, one.colors)))
    parameters = native.RdParameters(100, 100, 1.5)
    payload = encoded(parameters, many)
    assert 3 * 9000 < 8 * len(payload) < 3.1 * 9000
    assert_round_trip(parameters, many)
    for cut in (1, 100, len(payload) - 1):
        found = decoded(parameters, payload[:cut], prefix=True)
        assert len(found) <= 8 * cut + 64
        assert (rows(found) == rows(quantised(parameters, one))).all()


def test_more_gaussians_than_pixels() -> None:
    with pytest.raises(ValueError, match="more Gaussians than pixels"):
        encoded(native.RdParameters(2, 2, 1e-3), scattered(5, 0, (2, 2)))
    assert_round_trip(native.RdParameters(5, 1, 1e-3), scattered(5, 0, (5, 1)))


def test_the_far_end_of_the_largest_picture() -> None:
    """Cells have 16-bit coordinates, so the smallest Gaussians on the last pixels move by up to two."""
    last = 65534.5
    for scale, moved in ((0.3, 2.0), (1.0, 2.0), (2.0, 0.1), (50.0, 1.0)):
        values = single([[last, last]], [[scale, 0, scale]], [[0.5, 0.5, 0.5]])
        found = assert_round_trip(native.RdParameters(65535, 65535, 0.01), values)
        assert np.abs(found.means - last).max() <= moved


@pytest.mark.parametrize("cut", [1, 9, 40])
def test_a_cut_payload_is_refused(cut: int) -> None:
    parameters = native.RdParameters(120, 90, 0.1)
    payload = encoded(parameters, scattered(150, 0, (120, 90)))
    with pytest.raises(RuntimeError):
        decoded(parameters, payload[:-cut])
    with pytest.raises(RuntimeError, match="behind the last"):
        decoded(parameters, payload + b"\0" * 8 + b"\1")
    assert np.array_equal(rows(decoded(parameters, payload + b"\0" * cut)), rows(decoded(parameters, payload)))
    with pytest.raises(RuntimeError, match="begins"):
        decoded(parameters, b"\0\0\xff\xff" + payload)


# The ends of what fits keep to (sgmethod/native/core/constants.h), in corners where several come together.
CORNERS = {
    "needle": ([60, 60, 0.3], [0.5, 0.4, 0.3]),
    "needle of the largest slant": ([614.4, 614.4, 0.3], [1, 1, 1]),
    "longest, along x": ([8192, 614.4, 0.3], [32, 32, 32]),
    "longest, along y": ([0.3, 2048 * 8192, 8192], [32, -32, 32]),
    "largest": ([8192, 2048 * 8192, 8192], [-32, -32, -32]),
    "smallest": ([0.3, -614.4, 0.3], [-32, 32, -32]),
}


def clipped(parameters: native.RdParameters, values: Gaussians) -> int:
    """Values that quantising moves to the end of their range."""
    before = native.rd_clipped_values()
    found = native.rd_quantise(parameters, *values.arrays, *Gaussians.empty(len(values)).arrays)
    assert native.rd_clipped_values() - before == found
    return found


@pytest.mark.parametrize("quantum", [MIN_QUANTUM, 0.1, MAX_QUANTUM])
@pytest.mark.parametrize("name", CORNERS)
def test_no_fineness_clips_what_fits_keep_to(name: str, quantum: float) -> None:
    factor, color = CORNERS[name]
    scale = 1.6 * math.sqrt(factor[0] * factor[2])
    for mean in ((150, 100), (-scale, 200 + scale), (300 + scale, -scale)):
        values = single([mean], [factor], [color])
        assert clipped(native.RdParameters(300, 200, quantum), values) == 0


def test_a_needle_keeps_its_shape_in_a_fine_file() -> None:
    factor, color = CORNERS["needle"]
    needle = single([[150, 100]], [factor], [color])
    found = quantised(native.RdParameters(300, 200, MIN_QUANTUM), needle).factors[0]
    assert found == pytest.approx(factor, rel=2e-4)  # worst seen 9.5e-5: half a step of u


BEYOND = {
    "mean, left": ([-9, 50], [2, 0, 2], [1, 1, 1]),
    "mean, below": ([50, 109], [2, 0, 2], [1, 1, 1]),
    "size": ([50, 50], [1e5, 0, 1e5], [1, 1, 1]),
    "aspect": ([50, 50], [1e4, 0, 1e-4], [1, 1, 1]),
    "slant": ([50, 50], [2, 1e5, 2], [1, 1, 1]),
    "colour": ([50, 50], [50, 0, 50], [100, 100, 100]),
}


@pytest.mark.parametrize("name", BEYOND)
def test_what_is_clipped_is_counted(name: str) -> None:
    mean, factor, color = BEYOND[name]
    assert clipped(native.RdParameters(100, 100, MIN_QUANTUM), single([mean], [factor], [color])) == 1
    far = single([mean] * 700, [factor] * 700, [color] * 700)  # by several threads
    assert clipped(native.RdParameters(100, 100, MIN_QUANTUM), far) == 700


def test_steps_are_no_finer_than_single_precision_can_use() -> None:
    """Of colours 2^-16 at least; of r 2^-17, however long the colour is in its steps."""
    values = single([[150, 100]] * 2, [[4000, 70, 1000]] * 2, [[0.123, 0.123, 0.123], [32, 32, 32]])
    found = quantised(native.RdParameters(300, 200, MIN_QUANTUM), values)
    factors = found.factors[1].astype(float)
    for steps in (found.colors[0] @ BASIS[0] * 2**16, factors[1] / factors[2] * 2**17):
        assert steps > 8000
        assert steps == pytest.approx(round(steps), abs=0.002)  # worst seen 2e-4
