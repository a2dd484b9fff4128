"""The fit of profiles paper and baseline: all Gaussians together, without any quantisation."""

from __future__ import annotations

import math

import torch

from sgmethod.fitting.adam import FrameAdam
from sgmethod.fitting.parameters import Parameters
from sgmethod.fitting.picture import Picture
from sgmethod.fitting.recorder import Recorder
from sgmethod.fitting.schedule import Schedule, Until, never
from sgmethod.profiles import PaperSettings
from sgmethod.scene import Gaussians


def add_energy_gradient(p: Parameters, grad: Parameters, weight: float) -> None:
    """Add the gradient of weight * sum |c|^2 pi l1 l3: what an error proportional to each colour would cost, and
    so a price on large colours that cancel each other."""
    area = math.pi * weight * p.factors[:, 0] * p.factors[:, 2]
    energy = p.colors.square().sum(1) * area
    grad.colors += 2 * p.colors * area[:, None]
    grad.factors[:, 0] += energy / p.factors[:, 0]
    grad.factors[:, 2] += energy / p.factors[:, 2]


def usable(start: Gaussians, picture: Picture) -> Parameters:
    """The start, less what no fit recovers from: places that are not finite become the middle of the picture, shapes
    that are singular or not finite a circle as large as what each Gaussian has to cover."""
    p = Parameters.of(start)
    p.means[~p.means.isfinite().all(1)] = torch.tensor([picture.width / 2, picture.height / 2])
    radius = math.sqrt(picture.width * picture.height / len(start) / math.pi)
    shaped = p.factors.isfinite().all(1) & (p.factors[:, 0::2] > 0).all(1)
    p.factors[~shaped] = torch.tensor([radius, 0.0, radius])
    return p


def fit(
    picture: Picture, start: Gaussians, settings: PaperSettings, recorder: Recorder, until: Until = never
) -> tuple[Gaussians, int]:
    """Fitted Gaussians without any quantisation, and the steps that took."""
    p = usable(start, picture)
    p.colors = picture.solve_colors(p.means, p.factors, settings.color_solve_steps)
    adam = FrameAdam(len(start), settings)

    def step(rate: float, _: float) -> tuple[float, tuple[int, int]]:
        mse, grad = picture.gradients(p)
        add_energy_gradient(p, grad, settings.lambda_e / picture.values)
        adam.step(p, grad, rate)
        return mse, (len(start), 0)

    done = Schedule("fit", settings.fit_steps, settings.final_rate, until).run(recorder, step)
    return p.numpy(), done
