"""The fit of profile paper: all Gaussians together, without any quantisation."""

from __future__ import annotations

import math

import numpy as np

from sgmethod.backend.kernels import Kernels, Loss
from sgmethod.backend.protocol import MAX_CUTOFF, Descent, Frame, Moments
from sgmethod.errors import GaussiansError
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.level import Level, target_of
from sgmethod.fitting.recorder import Recorder
from sgmethod.paper.schedule import Schedule
from sgmethod.paper.settings import PaperSettings
from sgmethod.scene import Gaussians

KERNELS = Kernels()


def level_of(pixels: np.ndarray) -> Level:
    """Build the level that Gaussians of a file are fitted to, from pixels uint8 [H, W, 3]."""
    return Level(KERNELS, Frame(pixels.shape[1], pixels.shape[0], MAX_CUTOFF, pyramid=False), target_of(pixels))


def loss_of(level: Level, lambda_g: float) -> Loss:
    """Build the loss MSE + lambda_g L_g, a function of Gaussians."""
    if lambda_g == 0:
        return level.gradients
    return KERNELS.regularised(level.frame, level.image(), lambda_g)


def descent_on(level: Level, settings: PaperSettings) -> Descent:
    """Describe the steps on a level. Their gradient has the price of bits and all other terms."""
    size = level.frame.width, level.frame.height
    return Descent(level.frame, level.target, level.visibility, 0.0, 0.0, *size, settings.optimiser)


def usable(start: Gaussians, level: Level) -> Gaussians:
    """Replace values of a start that no fit recovers from.

    Means that are not finite move to the middle of the picture; factors that are singular or not finite become a
    circle with each Gaussian's share of the picture's area.
    """
    gaussians, frame = start.copy(), level.frame
    gaussians.means[~np.isfinite(gaussians.means).all(1)] = frame.width / 2, frame.height / 2
    radius = math.sqrt(level.pixels / len(start) / math.pi)
    shaped = np.isfinite(gaussians.factors).all(1) & (gaussians.factors[:, 0::2] > 0).all(1)
    gaussians.factors[~shaped] = radius, 0.0, radius
    return gaussians


def fit(
    level: Level, start: Gaussians, settings: PaperSettings, recorder: Recorder, deadline: Deadline
) -> tuple[Gaussians, int]:
    """Fit all Gaussians without quantisation; return them and the number of steps.

    Raises GaussiansError if the fit diverged to values that are not finite.
    """
    s, loss = settings, loss_of(level, settings.lambda_g)
    gaussians, moments, descent = usable(start, level), Moments.none(len(start)), descent_on(level, settings)

    def step(rate: float) -> tuple[float, int, int]:
        mse, gradient = loss(gaussians)
        KERNELS.step(gaussians, gradient, moments, descent, rate)
        return mse, len(start), 0

    schedule = Schedule("fit", s.fit_steps, s.optimiser.final_rate)
    steps = schedule.run(deadline, recorder, step)
    if not all(np.isfinite(values).all() for values in gaussians.arrays):
        raise GaussiansError("the fit diverged to values that are not finite; its learning rates are too high")
    return gaussians, steps
