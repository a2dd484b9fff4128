"""From a picture, with or without alpha, to a file of profile rd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sgmethod.bitstream import container
from sgmethod.budget import Budget
from sgmethod.encode_arguments import EncodeArguments
from sgmethod.fitting.deadline import Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.rd import alpha, encode as pipeline
from sgmethod.rd.aim import PsnrAim, QualityAim
from sgmethod.rd.byte_limit import ByteBudget
from sgmethod.rd.problem import Problem, Session
from sgmethod.rd.rate_control import GAUSSIANS_QUANTUM, GaussianCount, RateControl
from sgmethod.scene import Pixels
from sgmethod.settings.rd import Effort, RdSettings


def encode(pixels: Pixels, asked: EncodeArguments, time_limit_s: float | None, recorder: Recorder) -> tuple[bytes, int]:
    """Encode pixels [H, W, 3], or [H, W, 4] with alpha; return the file and the optimiser steps it took.

    Raises BudgetError for a budget that no file can meet.
    """
    settings = asked.settings
    assert isinstance(settings, RdSettings)
    height, width, channels = pixels.shape
    has_alpha = channels == 4
    deadline = Deadline.from_limit(recorder.clock, time_limit_s, height * width)
    colours = np.ascontiguousarray(pixels[..., :3])
    objective = Objective.from_pixels(colours, asked.objective)
    rate = rate_of(asked.budget, (width, height), settings.effort, has_alpha=has_alpha)
    problem = Problem(objective, rate.is_short(objective, has_alpha=has_alpha))
    session = Session(deadline, replace(recorder, tries=rate.usual_tries))
    if has_alpha:
        stream, steps = alpha.encode(problem, np.ascontiguousarray(pixels[..., 3]), settings, rate, session)
    else:
        stream, steps = pipeline.encode(problem, settings, rate, session)
    return container.serialise(stream), steps


def rate_of(budget: Budget, size: tuple[int, int], effort: Effort, *, has_alpha: bool = False) -> RateControl:
    """Create rate control for a picture of size (width, height). Raises BudgetError if no file can meet the budget."""
    pixels = size[0] * size[1]
    match budget.kind:
        case "gaussians":
            return GaussianCount(pixels, GAUSSIANS_QUANTUM, max_gaussians=budget.max_gaussians(*size))
        case "psnr":
            return PsnrAim.from_psnr(budget.value, pixels)
        case "quality":
            return QualityAim.from_score(budget.value, size, effort, budget.max_bytes(*size))
    return ByteBudget.from_bytes(budget.max_bytes(*size) or 0, pixels, has_alpha=has_alpha)
