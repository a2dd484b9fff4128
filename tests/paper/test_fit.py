"""The fit of profile paper: colours by least squares, schedule, clock and trace, and whole fits.

Gradients and steps have their tests with the backends (tests/backend).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from sgmethod.backend.protocol import MAX_CUTOFF
from sgmethod.errors import GaussiansError
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.level import Level
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_input
from sgmethod.paper.fit import fit, level_of
from sgmethod.paper.placement import place_by_structure
from sgmethod.paper.schedule import Schedule, Step
from sgmethod.paper.settings import PAPER, PaperSettings
from sgmethod.scene import Gaussians
from sgmethod.trace import TracePoint
from tests.backend.cases import single
from tests.definitions import drawing
from tests.rd.short import SlowClock
from tests.support.pictures import photo

PHOTO = photo() / np.float32(255)
FloatArray = NDArray[np.float32]


def level(image: FloatArray) -> Level:
    return level_of(read_input(image))


def unlimited() -> Deadline:
    return Deadline.from_limit(SlowClock())


def recorder(tick: float = 1.0, seen: Callable[[TracePoint], None] | None = None) -> Recorder:
    """Each look at its clock takes `tick` seconds."""
    return Recorder(SlowClock(look_s=tick), seen)


def small_case() -> tuple[FloatArray, Gaussians]:
    """A picture [12, 17, 3] and ten Gaussians on it."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (12, 17, 3)).astype(np.float32) / 255
    means = rng.random((10, 2)) * (17, 12)
    factors = np.stack([rng.uniform(1, 4, 10), rng.uniform(-2, 2, 10), rng.uniform(1, 4, 10)], 1)
    return image, single(means, factors, rng.normal(0, 1, (10, 3)))


def design(shapes: Gaussians, size: tuple[int, int]) -> NDArray[np.float64]:
    """Weights [pixels, Gaussians] in float64."""
    one = torch.ones(1, 3, dtype=torch.float64)
    means, factors = (torch.tensor(values).double() for values in (shapes.means, shapes.factors))
    columns = [drawing.render(m[None], f[None], one, size, MAX_CUTOFF)[0] for m, f in zip(means, factors, strict=True)]
    return torch.stack(columns, -1).reshape(-1, len(means)).numpy()


def test_solved_colours_reach_the_least_squares_residual(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sgmethod.fitting.level.DAMPING", 0.0)
    image, shapes = small_case()
    found = level(image).solve_colors(shapes, steps=60).colors.astype(np.float64)
    matrix, target = design(shapes, (17, 12)), image.reshape(-1, 3).astype(np.float64)
    best = np.linalg.lstsq(matrix, target)[0]
    residual, least = (np.square(matrix @ c - target).sum() for c in (found, best))
    assert residual == pytest.approx(least, rel=1e-6)  # worst seen 3e-13
    assert np.abs(found - best).max() < 1e-4  # worst seen 2e-6
    assert least < 0.7 * np.square(target).sum()
    assert not level(image).solve_colors(shapes, steps=0).colors.any()


def test_damping_is_that_of_a_ridge_weighed_by_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    image, shapes = small_case()
    matrix, target = design(shapes, (17, 12)), image.reshape(-1, 3).astype(np.float64)
    energy = math.pi * (shapes.factors[:, 0] * shapes.factors[:, 2]).astype(np.float64)
    for damping in (1e-2, 1.0):
        monkeypatch.setattr("sgmethod.fitting.level.DAMPING", damping)
        found = level(image).solve_colors(shapes, steps=60).colors
        ridge = np.linalg.solve(matrix.T @ matrix + damping * np.diag(energy), matrix.T @ target)
        assert np.abs(found - ridge).max() < 1e-4  # worst seen 2e-6


def falling(rates: list[float] | None = None) -> Step:
    """A step whose error falls by a hundredth each time. rates: records the rates it is given."""
    taken = 0

    def step(rate: float) -> tuple[float, int, int]:
        nonlocal taken
        taken += 1
        if rates is not None:
            rates.append(rate)
        return 0.99**taken, 5, 0

    return step


def test_the_rate_falls_from_one_to_the_last() -> None:
    rates: list[float] = []
    assert Schedule("fit", 50, 0.03).run(unlimited(), recorder(), falling(rates)) == len(rates) == 50
    assert rates[0] == pytest.approx(1)
    assert rates[-1] == pytest.approx(0.03, abs=0.002)
    assert rates == sorted(rates, reverse=True)


def test_a_time_limit_shortens_the_schedule() -> None:
    rates: list[float] = []
    clock = SlowClock()
    done = Schedule("fit", 10**9, 0.03).run(Deadline.from_limit(clock, 2.0), Recorder(clock), falling(rates))
    assert 10 < done == len(rates) < 201
    assert clock.now == pytest.approx(2.0, abs=0.1)
    assert rates[-1] == pytest.approx(0.03, abs=0.01)
    assert rates == sorted(rates, reverse=True)
    for limit_s in (1e-9, -5.0):  # which has passed
        deadline = Deadline.from_limit(SlowClock(), limit_s)
        assert Schedule("fit", 1000, 0.03).run(deadline, recorder(), falling()) == 1


def test_the_recorder_keeps_its_interval_but_every_beginning_and_end() -> None:
    seen: list[TracePoint] = []
    kept = recorder(0.001, seen.append)
    for phase in ("fit", "tune"):
        Schedule(phase, 500, 0.03).run(unlimited(), kept, falling())
    assert seen == kept.points
    assert 6 <= len(seen) <= 30
    for phase in ("fit", "tune"):
        points = [p for p in seen if p.phase == phase]
        assert points[0].step == 1
        assert points[-1].step == points[-1].steps == 500
    assert all(b.seconds > a.seconds for a, b in pairwise(seen))


def test_no_error_at_all_is_a_finite_number_of_decibels() -> None:
    kept = recorder()
    kept.report("fit", 1, 2, 0.0, 1)
    assert 100 < kept.points[0].psnr < math.inf


def psnr_of(gaussians: Gaussians, image: FloatArray) -> float:
    mse, _ = level(image).gradients(gaussians)
    return -10 * math.log10(max(mse, 1e-12))


def started(image: FloatArray, n: int, settings: PaperSettings = PAPER) -> Gaussians:
    return place_by_structure(image, n, settings.start, np.random.default_rng(0))


def test_a_fit_improves_the_picture_and_leaves_a_trace() -> None:
    settings = replace(PAPER, fit_steps=400)
    start = started(PHOTO, 150, settings)
    kept = recorder(0.02)
    fitted, steps = fit(level(PHOTO), start, settings, kept, unlimited())
    assert psnr_of(fitted, PHOTO) > psnr_of(start, PHOTO) + 3
    assert len(fitted) == 150
    assert steps == 400
    points = kept.points
    assert len(points) > 5
    assert all(b.seconds > a.seconds and b.step > a.step for a, b in pairwise(points))
    assert {(p.phase, p.steps, p.gaussians, p.bytes) for p in points} == {("fit", 400, 150, 0)}
    assert points[-1].step == 400
    assert points[-1].psnr == pytest.approx(psnr_of(fitted, PHOTO), abs=0.1)
    assert points[-1].psnr > points[0].psnr + 3


def test_nothing_to_draw_is_soon_done() -> None:
    image = np.zeros((30, 40, 3), np.float32)
    fitted, steps = fit(level(image), started(image, 20), replace(PAPER, fit_steps=400), recorder(), unlimited())
    assert steps < 200
    assert not fitted.colors.any()


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0])
@pytest.mark.parametrize("name", ["means", "factors"])
def test_a_start_that_no_fit_could_begin_with_is_mended(name: str, value: float) -> None:
    image = np.ascontiguousarray(PHOTO[:64, :64])
    spoiled = started(image, 40).copy()
    getattr(spoiled, name)[::2, 0] = value
    kept = recorder(0.02)
    fitted, _ = fit(level(image), spoiled, replace(PAPER, fit_steps=60), kept, unlimited())
    assert all(np.isfinite(values).all() for values in fitted.arrays)
    assert kept.points[-1].psnr > kept.points[0].psnr + 1


def test_a_fit_that_diverges_is_one_clear_error() -> None:
    image = np.ascontiguousarray(PHOTO[:64, :64])
    rates = replace(PAPER.optimiser, mean_rate=1000.0, factor_rate=1000.0, color_rate=1000.0)
    settings = replace(PAPER, fit_steps=400, optimiser=rates)
    with pytest.raises(GaussiansError, match="rates are too high"):
        fit(level(image), started(image, 40), settings, recorder(), unlimited())
