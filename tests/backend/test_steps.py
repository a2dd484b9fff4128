"""The compiled kernels against the reference: what a fit does to each Gaussian alone."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Coding, Descent, Frame, Moments, Visibility
from sgmethod.bitstream.v2 import StreamV2
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RD
from sgmethod.settings.shared import ADAM, OptimiserSettings
from tests.backend.cases import FRAMES, VISIBILITIES, scattered, single, target, visibility
from tests.definitions.backend import MAX_AMPLITUDE, MAX_SCALE, MAX_SLANT, Reference, step_by_step

KERNELS, REFERENCE = Kernels(), Reference()
BACKENDS = KERNELS, REFERENCE

each_backend = pytest.mark.parametrize("backend", BACKENDS, ids=["kernels", "reference"])


def various(n: int, seed: int) -> Gaussians:
    """Gaussians of 0.4 to 40 pixels, with colours from nothing to 1."""
    rng = np.random.default_rng(seed)
    l1, l3 = 0.4 * 100 ** rng.random((2, n))
    colors = rng.standard_normal((n, 3)) * rng.random((n, 1)) ** 3
    return single(500 * rng.random((n, 2)), np.stack([l1, l1 * rng.standard_normal(n), l3], 1), colors)


def moved(backend: Kernels | Reference, settings: OptimiserSettings, seen: Visibility | None) -> Gaussians:
    """Gaussians after six steps, of which the last hundred join after three."""
    before, gradient = various(1200, 7), various(1200, 8)
    frame = Frame(250, 250, spacing=2)
    descent = Descent(frame, np.empty((3, 0, 0), np.int16), seen, 0.1, 0.0, 7, 1, settings)
    early = before.rows(np.arange(1100))
    moments = Moments.none(1100)
    for _ in range(3):
        backend.step(early, gradient.rows(np.arange(1100)), moments, descent, 0.6)
    gaussians, moments = early.with_more(before.rows(np.arange(1100, 1200))), moments.with_more(100)
    for _ in range(3):
        backend.step(gaussians, gradient, moments, descent, 0.6)
    return gaussians


@pytest.mark.parametrize("settings", [ADAM, RD.optimiser], ids=["adam", "no longer than Gauss-Newton"])
@pytest.mark.parametrize("kind", VISIBILITIES)
def test_step(settings: OptimiserSettings, kind: str) -> None:
    seen = visibility(kind, 2)
    found, wanted = (moved(backend, settings, seen) for backend in BACKENDS)
    for values, exact in zip(found.arrays, wanted.arrays, strict=True):
        np.testing.assert_allclose(values, exact, rtol=1e-5, atol=1e-5)  # worst seen 1.5e-6
    free = moved(REFERENCE, replace(settings, newton_steps=np.inf), seen)
    held = np.concatenate([a != b for a, b in zip(free.arrays, wanted.arrays, strict=True)], 1).mean()
    assert held == 0 if settings.newton_steps == np.inf else 0.1 < held < 0.9  # of Adam's moves: both are met


@pytest.mark.parametrize("kind", VISIBILITIES)
@pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES)
def test_steps_together_are_those_one_by_one(frame: Frame, kind: str) -> None:
    size = frame.width * frame.spacing, frame.height * frame.spacing
    before = scattered(700, 5, size)
    descent = Descent(frame, target(3), visibility(kind, 3), 0.1, 1e-6, *size, RD.optimiser)
    found: list[np.ndarray] = []
    wanted: list[np.ndarray] = []
    for steps, out in ((KERNELS.steps, found), (partial(step_by_step, KERNELS), wanted)):
        gaussians, moments = before.copy(), Moments.none(700)
        errors = steps(gaussians, moments, descent, [1.0, 0.7, 0.5])
        out += [*gaussians.arrays, moments.first, moments.second, moments.bias, np.array(errors)]
    assert all(np.array_equal(a, b) for a, b in zip(found, wanted, strict=True))
    assert not np.array_equal(found[0], before.means)


@pytest.mark.parametrize("quantum", [0.01, 0.15, 2.0])
def test_add_rate_gradient(quantum: float) -> None:
    gaussians = various(1500, 1)
    found, wanted = (single(np.zeros((1500, 2)), np.ones((1500, 3)), np.ones((1500, 3))) for _ in BACKENDS)
    KERNELS.add_rate_gradient(gaussians, found, quantum, 0.7)
    REFERENCE.add_rate_gradient(gaussians, wanted, quantum, 0.7)
    assert not found.means.any()
    assert not wanted.means.any()
    for values, exact in zip(found.arrays[1:], wanted.arrays[1:], strict=True):
        size = np.abs(exact - 1).max(1, keepdims=True) + 1
        assert (np.abs(values - exact) <= 4e-5 * size).all()  # worst seen 1.7e-5: the axes cancel


@each_backend
def test_rate_gradient_is_finite_where_nothing_is_left(backend: Kernels | Reference) -> None:
    """A round Gaussian without colour: every term of the estimate has its kink there."""
    gaussians, gradient = single([[0, 0]], [[2, 0, 2]], [[0, 0, 0]]), single([[0, 0]], [[0, 0, 0]], [[0, 0, 0]])
    backend.add_rate_gradient(gaussians, gradient, 0.1, 1.0)
    assert not gradient.colors.any()
    assert np.isfinite(gradient.factors).all()


def kept(backend: Kernels | Reference, gaussians: Gaussians) -> Gaussians:
    """What keep_in_range makes of them."""
    copy = gaussians.copy()
    backend.keep_in_range(copy, 500, 300)
    return copy


def test_keep_in_range() -> None:
    gaussians, rng = various(1000, 3), np.random.default_rng(4)
    gaussians.means[:500] = gaussians.means[:500] * 4 - 750
    gaussians.factors[::2] *= 10 ** (8 * rng.random((500, 3)) - 3)
    gaussians.colors[::3] *= 10 ** (4 * rng.random((334, 1)))
    found, wanted = (kept(backend, gaussians) for backend in BACKENDS)
    for before, values, exact in zip(gaussians.arrays, found.arrays, wanted.arrays, strict=True):
        assert 0.05 < (before != values).any(1).mean() < 0.7
        np.testing.assert_allclose(values, exact, rtol=1e-6)  # worst seen 1.5e-7
    again = kept(KERNELS, found)
    assert all(np.array_equal(a, b) for a, b in zip(found.arrays, again.arrays, strict=True))


@each_backend
def test_what_is_in_range_stays(backend: Kernels | Reference) -> None:
    edge = [MAX_SCALE, -MAX_SLANT * MAX_SCALE, MAX_SCALE]
    colors = [[MAX_AMPLITUDE, -MAX_AMPLITUDE, 0], [0.1, 0.2, 0.3]]
    gaussians = single([[250, 150], [-4, 304]], [edge, [2.6, 0, 2.6]], colors)
    for values, after in zip(gaussians.arrays, kept(backend, gaussians).arrays, strict=True):
        assert np.array_equal(values, after)


@pytest.mark.parametrize("quantum", [2**-8, 0.3125, 4.0])
@pytest.mark.parametrize(("grey", "upright"), [(False, False), (True, False), (False, True)])
def test_rounded(grey: bool, upright: bool, quantum: float) -> None:
    gaussians = scattered(60, 1)
    gaussians.factors[:, 1] *= not upright
    coding = Coding(40, 35, quantum, grey, upright)
    found, wanted = (backend.rounded(gaussians, coding) for backend in BACKENDS)
    assert all(np.array_equal(a, b) for a, b in zip(found.arrays, wanted.arrays, strict=True))
    if quantum == 4.0:
        assert 0.1 < found.colors.any(1).mean() < 0.9
    decoded = StreamV2.from_gaussians(gaussians, (40, 35), quantum, (0, 0, 0), grey, with_shear=not upright).gaussians()
    assert as_set(found) == as_set(decoded)


def as_set(gaussians: Gaussians) -> set[bytes]:
    """All numbers of those with a colour."""
    return {row.tobytes() for row in np.concatenate(gaussians.arrays, 1)[gaussians.colors.any(1)]}
