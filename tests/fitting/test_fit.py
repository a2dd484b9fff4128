"""The fit: colours by least squares, the optimiser in each Gaussian's frame, schedule, clock and trace."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from sgmethod.fitting.adam import FrameAdam
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.picture import Picture, target_of
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.schedule import Schedule
from sgmethod.io.levels import to_8_bit
from sgmethod.native import native, reference
from sgmethod.paper.fit import fit
from sgmethod.profiles import BASELINE, PAPER, PaperSettings
from sgmethod.scene import Gaussians
from sgmethod.start.placement import place
from sgmethod.trace import TracePoint
from tests.harness.data import PHOTOGRAPHS

CUTOFF = native.CUTOFF_V1

FloatArray = NDArray[np.float32]


@cache
def photo() -> FloatArray:
    return np.asarray(Image.open(PHOTOGRAPHS / "kodim23-crop.png").convert("RGB"), np.float32) / 255


class FakeClock(Clock):
    """Each look at it takes `tick` seconds."""

    def __init__(self, tick: float) -> None:
        super().__init__()
        self.tick, self.now = tick, 0.0

    def seconds(self) -> float:
        self.now += self.tick
        return self.now


def recorder(tick: float = 1.0) -> Recorder:
    return Recorder(FakeClock(tick), None)


def small_case() -> tuple[FloatArray, Tensor, Tensor]:
    """A picture [12, 17, 3] and the geometry of ten Gaussians on it."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (12, 17, 3)).astype(np.float32) / 255
    means = torch.tensor(rng.random((10, 2)) * (17, 12), dtype=torch.float32)
    factors = torch.tensor(np.stack([rng.uniform(1, 4, 10), rng.uniform(-2, 2, 10), rng.uniform(1, 4, 10)], 1))
    return image, means, factors.float()


def design(means: Tensor, factors: Tensor, size: tuple[int, int]) -> NDArray[np.float64]:
    """Weights [pixels, Gaussians] in float64."""
    one = torch.ones(1, 3, dtype=torch.float64)
    columns = [
        reference.render(m[None], f[None], one, size, CUTOFF)[0]
        for m, f in zip(means.double(), factors.double(), strict=True)
    ]
    return torch.stack(columns, -1).reshape(-1, len(means)).numpy()


# --- colours by least squares


def test_solved_colours_reach_the_least_squares_residual() -> None:
    image, means, factors = small_case()
    found = (
        Picture(target_of(to_8_bit(image)), 0.0, CUTOFF)
        .solve_colors(means, factors, steps=60, damping=0.0)
        .double()
        .numpy()
    )
    matrix, target = design(means, factors, (17, 12)), image.reshape(-1, 3).astype(np.float64)
    best = np.linalg.lstsq(matrix, target)[0]
    residual, least = (np.square(matrix @ c - target).sum() for c in (found, best))
    assert residual == pytest.approx(least, rel=1e-6)  # worst seen 3e-13
    assert np.abs(found - best).max() < 1e-4  # worst seen 2e-6
    assert least < 0.7 * np.square(target).sum()


def test_damping_is_that_of_a_ridge_weighed_by_energy() -> None:
    image, means, factors = small_case()
    matrix, target = design(means, factors, (17, 12)), image.reshape(-1, 3).astype(np.float64)
    energy = math.pi * (factors[:, 0] * factors[:, 2]).double().numpy()
    for damping in (1e-2, 1.0):
        found = (
            Picture(target_of(to_8_bit(image)), 0.0, CUTOFF)
            .solve_colors(means, factors, steps=60, damping=damping)
            .double()
            .numpy()
        )
        ridge = np.linalg.solve(matrix.T @ matrix + damping * np.diag(energy), matrix.T @ target)
        assert np.abs(found - ridge).max() < 1e-4  # worst seen 2e-6


def test_more_steps_of_the_solver_do_not_make_it_worse() -> None:
    image, means, factors = small_case()
    matrix, target = design(means, factors, (17, 12)), image.reshape(-1, 3).astype(np.float64)
    errors = []
    for steps in (0, 1, 2, 4, 8, 16, 32):
        colors = (
            Picture(target_of(to_8_bit(image)), 0.0, CUTOFF)
            .solve_colors(means, factors, steps, damping=0.0)
            .double()
            .numpy()
        )
        errors.append(np.square(matrix @ colors - target).sum())
    assert errors[0] == pytest.approx(np.square(target).sum())
    assert all(b <= a * (1 + 1e-6) for a, b in pairwise(errors))


# --- gradients and the optimiser


def test_gradients_are_those_of_the_mean_squared_error() -> None:
    image, means, factors = small_case()
    colors = torch.randn(10, 3, generator=torch.Generator().manual_seed(0))
    leaves = [t.double().requires_grad_() for t in (means, factors, colors)]
    target = torch.from_numpy(image).double().permute(2, 0, 1)
    mse = (reference.render(leaves[0], leaves[1], leaves[2], (17, 12), CUTOFF) - target).square().mean()
    expected = torch.autograd.grad(mse, leaves)
    found_mse, found = Picture(target_of(to_8_bit(image)), 0.0, CUTOFF).gradients(Parameters(means, factors, colors))
    assert found_mse == pytest.approx(mse.item(), rel=1e-5)  # worst seen 2e-7
    for mine, true in zip((found.means, found.factors, found.colors), expected, strict=True):
        assert (mine - true).abs().max() < 1e-4 * true.abs().max()  # worst seen 5e-6


def one_gaussian(scale: float) -> tuple[Parameters, Parameters]:
    """A Gaussian and a gradient, the same but for the unit of length."""
    p = Parameters(
        torch.tensor([[3.0, 4.0]]) * scale, torch.tensor([[2.0, -1.0, 3.0]]) * scale, torch.tensor([[0.5, 0.2, -0.1]])
    )
    grad = Parameters(
        torch.tensor([[0.3, -0.2]]) / scale, torch.tensor([[0.1, 0.4, -0.7]]) / scale, torch.tensor([[0.2, -0.3, 0.1]])
    )
    return p, grad


def test_a_step_is_relative_to_the_gaussians_own_scale() -> None:
    moved = []
    for scale in (1.0, 16.0):
        p, grad = one_gaussian(scale)
        adam = FrameAdam(1, PAPER)
        for _ in range(5):
            adam.step(p, grad, 1.0)
        moved.append((p.means / scale, p.factors / scale, p.colors))
    for one, other in zip(*moved, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=0)  # worst seen 0: 16 is a power of two


@pytest.mark.parametrize("rate", [1e-3, 0.1])
def test_a_step_lowers_the_error(rate: float) -> None:
    image, means, factors = small_case()
    picture = Picture(target_of(to_8_bit(image)), 0.0, CUTOFF)
    p = Parameters(means, factors, picture.solve_colors(means, factors, 10))
    before, grad = picture.gradients(p)
    FrameAdam(10, PAPER).step(p, grad, rate)
    after, _ = picture.gradients(p)
    assert after < before


def test_no_scale_falls_below_the_least() -> None:
    p, grad = one_gaussian(0.2)
    grad.factors = torch.tensor([[5.0, 0.0, 5.0]])
    adam = FrameAdam(1, PAPER)
    for _ in range(100):
        adam.step(p, grad, 1.0)
    assert p.factors[0, 0] == p.factors[0, 2] == torch.tensor(PAPER.min_scale_px)


# --- schedule, clock, trace


def falling() -> Callable[..., tuple[float, tuple[int, int]]]:
    error = 1.0

    def step(*_: float) -> tuple[float, tuple[int, int]]:
        nonlocal error
        error *= 0.99
        return error, (5, 0)

    return step


def test_the_rate_falls_from_one_to_the_last() -> None:
    rates: list[float] = []
    inner = falling()

    def step(rate: float, *_: float) -> tuple[float, tuple[int, int]]:
        rates.append(rate)
        return inner(rate)

    assert Schedule("fit", 50, 0.03).run(recorder(), step) == len(rates) == 50
    assert rates[0] == pytest.approx(1)
    assert rates[-1] == pytest.approx(0.03, abs=0.002)
    assert rates == sorted(rates, reverse=True)


def test_a_time_limit_shortens_the_schedule() -> None:
    rates: list[float] = []
    inner = falling()

    def step(rate: float, *_: float) -> tuple[float, tuple[int, int]]:
        rates.append(rate)
        return inner(rate)

    clock = FakeClock(0.01)
    done = Schedule("fit", 10**9, 0.03, lambda: 2.0).run(Recorder(clock, None), step)
    assert 10 < done == len(rates) < 201
    assert clock.now == pytest.approx(2.0, abs=0.1)
    assert rates[-1] == pytest.approx(0.03, abs=0.01)
    assert rates == sorted(rates, reverse=True)


def test_a_limit_that_has_passed_leaves_one_step() -> None:
    for until in (0.0, -5.0):
        assert Schedule("fit", 1000, 0.03, partial(float, until)).run(recorder(), falling()) == 1


def test_a_fit_that_no_longer_improves_ends_early() -> None:
    best = falling()

    def step(rate: float, *_: float) -> tuple[float, tuple[int, int]]:
        return (0.5, (5, 0)) if len(seen) > 200 else best(rate)

    seen: list[TracePoint] = []
    found = Recorder(FakeClock(1.0), seen.append)
    assert 200 < Schedule("fit", 1000, 0.03).run(found, step) < 700
    assert Schedule("fit", 1000, 0.03).run(recorder(), lambda *_: (0.5, (5, 0))) < 500
    assert Schedule("fit", 1000, 0.03).run(recorder(), falling()) == 1000


def test_the_recorder_keeps_its_interval_but_every_beginning_and_end() -> None:
    seen: list[TracePoint] = []
    kept = Recorder(FakeClock(0.001), seen.append)
    Schedule("fit", 500, 0.03).run(kept, falling())
    Schedule("tune", 500, 0.03).run(kept, falling())
    assert seen == kept.points
    assert 6 <= len(seen) <= 30
    for phase in ("fit", "tune"):
        points = [p for p in seen if p.phase == phase]
        assert points[0].step == 1
        assert points[-1].step == points[-1].steps == 500
    assert all(b.seconds > a.seconds for a, b in pairwise(seen))


def test_no_error_at_all_is_a_finite_number_of_decibels() -> None:
    kept = recorder()
    kept.report("fit", 1, 2, 0.0, (1, 0))
    assert 100 < kept.points[0].psnr < math.inf


def test_a_report_that_raises_ends_the_run() -> None:
    def abandon(_: TracePoint) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Schedule("fit", 500, 0.03).run(Recorder(FakeClock(1.0), abandon), falling())


# --- whole fits


def psnr_of(gaussians: Gaussians, image: FloatArray) -> float:
    mse, _ = Picture(target_of(to_8_bit(image)), 0.0, CUTOFF).gradients(Parameters.of(gaussians))
    return -10 * math.log10(max(mse, 1e-12))


@pytest.mark.parametrize("profile", [PAPER, BASELINE], ids=("paper", "baseline"))
def test_a_fit_improves_the_picture_and_leaves_a_trace(profile: PaperSettings) -> None:
    settings = replace(profile, fit_steps=200)
    start = place(photo(), 150, settings, np.random.default_rng(0))
    picture = Picture(target_of(to_8_bit(photo())), settings.lambda_g, CUTOFF)
    p = Parameters.of(start)
    solved = picture.solve_colors(p.means, p.factors, steps=60)
    begun = psnr_of(Gaussians(start.means, start.factors, solved.numpy()), photo())
    kept = Recorder(FakeClock(0.02), None)
    fitted, steps = fit(picture, start, settings, kept)
    assert psnr_of(fitted, photo()) > begun + 3
    assert len(fitted) == 150
    assert steps == 200
    points = kept.points
    assert len(points) > 5
    assert all(b.seconds > a.seconds and b.step > a.step for a, b in pairwise(points))
    assert {(p.phase, p.steps, p.gaussians, p.bytes) for p in points} == {("fit", 200, 150, 0)}
    assert points[-1].step == 200
    assert points[-1].psnr == pytest.approx(psnr_of(fitted, photo()), abs=0.1)
    assert points[-1].psnr > points[0].psnr + 3


def grey(values: NDArray[np.float64]) -> FloatArray:
    return np.repeat(values[:, :, None], 3, 2).astype(np.float32)


EXTREMES = {
    "black": lambda: grey(np.zeros((30, 40))),
    "white": lambda: grey(np.ones((30, 40))),
    "checkerboard": lambda: grey(np.indices((30, 40)).sum(0) % 2 * 1.0),
    "one white pixel": lambda: grey(np.pad([[1.0]], ((11, 18), (9, 30)))),
    "step": lambda: grey((np.indices((30, 40))[1] > 19) * 1.0),
    "noise": lambda: np.random.default_rng(0).random((30, 40, 3)).astype(np.float32),
    "1 x 1": lambda: grey(np.ones((1, 1))),
    "2 x 2": lambda: grey(np.eye(2)),
    "row": lambda: grey(np.random.default_rng(0).random((1, 300))),
    "column": lambda: grey(np.random.default_rng(0).random((300, 1))),
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_pictures_stay_finite(name: str) -> None:
    image = EXTREMES[name]()
    settings = replace(PAPER, fit_steps=80)
    pixels = image.shape[0] * image.shape[1]
    for n in sorted({1, min(40, pixels), pixels}):
        start = place(image, n, settings, np.random.default_rng(0))
        kept = recorder()
        fitted, _ = fit(Picture(target_of(to_8_bit(image)), settings.lambda_g, CUTOFF), start, settings, kept)
        for array in (fitted.means, fitted.factors, fitted.colors):
            assert np.isfinite(array).all()
        assert (fitted.factors[:, [0, 2]] >= np.float32(settings.min_scale_px)).all()
        assert all(math.isfinite(p.psnr) for p in kept.points)
        assert psnr_of(fitted, image) > kept.points[0].psnr - 3  # -0.8 seen, from 46.5 dB on; mostly far above


def test_nothing_to_draw_is_soon_done() -> None:
    settings = replace(PAPER, fit_steps=400)
    image = np.zeros((30, 40, 3), np.float32)
    start = place(image, 20, settings, np.random.default_rng(0))
    fitted, steps = fit(Picture(target_of(to_8_bit(image)), settings.lambda_g, CUTOFF), start, settings, recorder())
    assert steps < 200
    assert not fitted.colors.any()


def test_the_same_start_gives_the_same_fit() -> None:
    settings = replace(PAPER, fit_steps=40)
    start = place(photo(), 60, settings, np.random.default_rng(0))
    fits = [
        fit(Picture(target_of(to_8_bit(photo())), settings.lambda_g, CUTOFF), start, settings, recorder())[0]
        for _ in range(2)
    ]
    for one, other in zip(*((f.means, f.factors, f.colors) for f in fits), strict=True):
        assert np.array_equal(one, other)
    assert np.array_equal(start.colors, place(photo(), 60, settings, np.random.default_rng(0)).colors)


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0])
@pytest.mark.parametrize("name", ["means", "factors"])
def test_a_start_that_no_fit_could_begin_with_is_mended(name: str, value: float) -> None:
    image = np.ascontiguousarray(photo()[:64, :64])
    settings = replace(PAPER, fit_steps=60)
    picture = Picture(target_of(to_8_bit(image)), settings.lambda_g, CUTOFF)
    start = place(image, 40, settings, np.random.default_rng(0))
    spoiled = Gaussians(*(np.array(values) for values in (start.means, start.factors, start.colors)))
    getattr(spoiled, name)[::2, 0] = value
    recorder = Recorder(Clock(), None)
    fitted, _ = fit(picture, spoiled, settings, recorder)
    assert all(np.isfinite(values).all() for values in (fitted.means, fitted.factors, fitted.colors))
    assert recorder.points[-1].psnr > recorder.points[0].psnr + 1
