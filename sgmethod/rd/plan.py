"""Plan: the settings and the size of the picture that fit into the time there is, before the fit begins."""

from __future__ import annotations

from dataclasses import replace

from sgmethod.fitting.level import Level, Pyramid
from sgmethod.rd.request import Plan, Request
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings, hurried


def planned(request: Request, pyramid: Pyramid, gaussians: Gaussians) -> Plan:
    """The plan for a request whose first Gaussians are placed.

    Where time is too short for all steps, it takes the settings of a lower effort; where it is too short for that as
    well, a smaller picture is fitted. The time of a gradient is measured here, on this machine.
    """
    deadline, settings = request.deadline, request.settings
    if not deadline.has_limit():
        return Plan(request, settings, pyramid)

    def gradient_s(level: Level) -> float:
        return deadline.seconds_of(lambda: level.gradients(gaussians))

    whole_s = gradient_s(pyramid.whole)
    in_time = deadline.steps_in_time(whole_s)
    part = in_time / request.rate.steps(settings)
    settings = hurried(settings, request.rate.pixels, part * settings.effort.steps)
    step_s = whole_s * in_time * deadline.settings.gradients_per_step / request.rate.steps(settings)
    finest, took_s = pyramid.whole, whole_s
    for level in pyramid.levels[1:]:
        if took_s <= step_s:
            break
        took_s, before_s = gradient_s(level), took_s
        if took_s > before_s / 2:  # a level is worth the detail it lacks if it halves the time
            break
        finest = level
    return Plan(request, _with_narrowest(settings, finest), pyramid.from_level(finest))


def _with_narrowest(settings: RdSettings, finest: Level) -> RdSettings:
    """A narrower Gaussian would fall between the pixels of the finest level."""
    optimiser = settings.fit.optimiser
    narrowest = optimiser.min_scale_px * finest.frame.spacing
    return replace(settings, fit=replace(settings.fit, optimiser=replace(optimiser, min_scale_px=narrowest)))
