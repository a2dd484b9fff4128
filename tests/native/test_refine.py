"""Coordinate descent on coded integers: on wide Gaussians, for every number of threads, on odd sizes and values.

That it keeps to its limits of bytes and time is tested for each backend (tests/backend/test_refine.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from sgmethod.backend.protocol import Target
from sgmethod.bitstream.v2 import MAX_QUANTUM, MIN_QUANTUM
from sgmethod.native import native
from sgmethod.scene import FloatArray, Gaussians
from tests.backend.cases import scattered, single
from tests.native.test_codec import encoded, rows

CUTOFF = native.CUTOFF_V2

SIZE = (150, 70)  # a strip that is not full at the end
NO_LIMIT = 1 << 40


def picture(values: Gaussians, size: tuple[int, int] = SIZE) -> FloatArray:
    """Of Gaussians, [3, H, W]."""
    image = np.empty((3, size[1], size[0]), np.float32)
    native.Rasterization(values.means, values.factors, *size, CUTOFF, pyramid=True).render(values.colors, image)
    return image


def target_of(image: FloatArray) -> Target:
    levels = np.round(image * native.TARGET_WHITE)
    assert np.abs(levels).max() <= np.iinfo(np.int16).max
    return levels.astype(np.int16)


def refined(
    parameters: native.RdParameters,
    values: Gaussians,
    target: Target,
    *,
    price: float = 0.0,
    sweeps: int = 6,
    seconds: float = math.inf,
    max_bytes: int = NO_LIMIT,
    visibility: NDArray[np.int16] | None = None,
) -> bytes:
    arrays = (values.means, values.factors, values.colors)
    return native.rd_refine(parameters, *arrays, target, price, sweeps, seconds, max_bytes, visibility)


def error(parameters: native.RdParameters, payload: bytes, target: Target) -> float:
    found = Gaussians(*native.rd_decode(parameters, payload))
    return float(np.square(picture(found, target.shape[:0:-1]) - target / native.TARGET_WHITE, dtype=np.float64).sum())


def scene(seed: int = 0, n: int = 150) -> tuple[Gaussians, Target]:
    """Gaussians, and a target that they meet but for some noise."""
    values = scattered(n, seed, SIZE)
    noise = np.random.default_rng(seed).normal(0, 0.005, (3, SIZE[1], SIZE[0]))
    return values, target_of(picture(values) + noise)


def wide_scene(seed: int) -> tuple[Gaussians, Target]:
    """The same with Gaussians of several levels, most of them wide."""
    from tests.definitions import drawing  # torch, which takes seconds; tests/fitting does without

    rng, n = np.random.default_rng(seed), 80
    factors = np.exp(rng.uniform(0.5, 4.5, (n, 1)) + rng.normal(0, 0.5, (n, 3)))
    factors[:, 1] *= rng.choice([-1, 0, 1], n)
    values = single(scattered(n, seed, SIZE).means, factors, rng.normal(0, 0.2, (n, 3)))
    assert {drawing.level_of(*factor) for factor in values.factors.tolist()} >= set(range(5))
    return values, target_of(picture(values) + rng.normal(0, 0.005, (3, SIZE[1], SIZE[0])))


@pytest.mark.parametrize("seed", range(3))
def test_each_sweep_lowers_the_error_of_wide_gaussians(seed: int) -> None:
    """Seen: 43 to 63 % of the error of rounding is left after six sweeps. tests/backend has narrow ones."""
    values, target = wide_scene(seed)
    parameters = native.RdParameters(*SIZE, 0.4)
    errors = [error(parameters, refined(parameters, values, target, sweeps=n), target) for n in (0, 1, 2, 6)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.75 * errors[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_price_on_bits_buys_smaller_files(seed: int) -> None:
    values, target = scene(seed)
    parameters = native.RdParameters(*SIZE, 0.4)
    payloads = [refined(parameters, values, target, price=price) for price in (0.0, 0.02, 0.2, 2.0, 1e9)]
    sizes = [len(payload) for payload in payloads]
    errors = [error(parameters, payload, target) for payload in payloads]
    assert sizes == sorted(sizes, reverse=True)
    assert errors == sorted(errors)
    assert sizes[-1] == 0


@pytest.mark.parametrize(("size", "n"), [(SIZE, 150), ((700, 420), 1500)])
def test_the_same_for_every_number_of_threads(
    size: tuple[int, int], n: int, set_threads: Callable[[int], None]
) -> None:
    """On the larger one many cells are refined at once."""
    values = scattered(n, 0, size)
    target = target_of(picture(values, size) + np.random.default_rng(0).normal(0, 0.005, (3, size[1], size[0])))
    parameters = native.RdParameters(*size, 0.3)
    before, price = encoded(parameters, values), 0.01
    most = len(before) * 3 // 4
    found = []
    for count in (1, 2, 5):
        set_threads(count)
        found.append([refined(parameters, values, target, price=price, max_bytes=m) for m in (NO_LIMIT, most)])
    assert found[0] == found[1] == found[2]
    assert len(found[0][1]) <= most
    costs = [error(parameters, one, target) + price * 8 * len(one) for one in (found[0][0], before)]
    assert costs[0] < costs[1]


@pytest.mark.parametrize("size", [(1, 1), (16, 1), (1, 40), (17, 65)])
@pytest.mark.parametrize("quantum", [MIN_QUANTUM, 0.2, MAX_QUANTUM])
def test_odd_sizes_and_steps(size: tuple[int, int], quantum: float) -> None:
    values = scattered(size[0] * size[1] // 2 + 1, 0, size)
    target = target_of(picture(values, size))
    parameters = native.RdParameters(*size, quantum)
    payload = refined(parameters, values, target, price=1e-9)
    before = error(parameters, encoded(parameters, values), target)
    assert error(parameters, payload, target) <= before * (1 + 1e-5) + 1e-6
    assert np.isfinite(rows(Gaussians(*native.rd_decode(parameters, payload)))).all()


def test_gaussians_beyond_the_picture_or_the_numbers() -> None:
    values, target = scene()
    values.means[::3] = 1e6
    values.factors[1::3] = [1e9, 0, 1e-3]
    values.colors[2] = np.nan
    values.means[5] = np.inf
    parameters = native.RdParameters(*SIZE, 0.3)
    payload = refined(parameters, values, target)
    assert np.isfinite(error(parameters, payload, target))


def test_bad_arguments() -> None:
    values, target = scene()
    parameters = native.RdParameters(*SIZE, 0.3)
    with pytest.raises(ValueError, match="size"):
        refined(parameters, values, target[:, :-1].copy())
    with pytest.raises(ValueError, match="one row per Gaussian"):
        refined(parameters, Gaussians(values.means[:-1].copy(), values.factors, values.colors), target)


@pytest.mark.parametrize("size", [3.0, 40.0], ids=["pixels", "coarse level"])
@pytest.mark.parametrize("seen", [False, True])
@pytest.mark.parametrize("direction", [0, 1, 2, 3, 4, 5, 7, 8, 9])  # with 6, a smaller Gaussian, two integers change
def test_one_step_of_any_integer_is_found(direction: int, size: float, seen: bool) -> None:
    """Only steps that look promising are tried on pixels. Seen: no error is left."""
    parameters = native.RdParameters(*SIZE, 0.4)

    def decoded(change: float = 0.0) -> Gaussians:
        by = np.zeros(5)
        by[direction // 2] = change if direction % 2 else -change
        x, y, u, v, r = by
        l1, l3 = 1.2 * size * math.exp(u + v), size * math.exp(u - v)
        one = single([[70 + size * x, 35 + size * y]], [[l1, (0.4 + r) * l3, l3]], [[0.3, 0.2, 0.4]])
        return Gaussians(*native.rd_decode(parameters, encoded(parameters, one)))

    before = decoded()
    after = next(g for k in range(1, 1000) if not np.array_equal(rows(g := decoded(0.001 * k)), rows(before)))
    target = target_of(picture(after))
    visibility = np.full(SIZE[::-1], native.VISIBLE // 2, np.int16) if seen else None
    left = error(parameters, refined(parameters, before, target, sweeps=1, visibility=visibility), target)
    assert left < 0.02 * error(parameters, encoded(parameters, before), target)
