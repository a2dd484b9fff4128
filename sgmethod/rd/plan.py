"""Plan: the settings and the size of the picture that fit into the time there is, before the fit begins."""

from __future__ import annotations

from dataclasses import replace

from sgmethod.fitting.level import Level, Pyramid
from sgmethod.rd.request import Plan, Request
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RdSettings, hurried, sized


def planned(request: Request, pyramid: Pyramid, gaussians: Gaussians) -> Plan:
    """The plan for a request whose first Gaussians are placed.

    Where time is too short for all steps, it takes the settings of a lower effort; where it is too short for that as
    well, a smaller picture is fitted. The time of a gradient is measured here, on this machine.
    """
    rate, deadline = request.rate, request.deadline
    most = pyramid.coarsest(request.settings.pyramid.pixels_per_gaussian * rate.expected_gaussians())
    settings = sized(request.settings, most.pixels)
    if not deadline.has_limit():
        return Plan(request, _within_pixels(settings, pyramid), pyramid)

    def gradient_s(level: Level) -> float:
        return deadline.seconds_of(lambda: level.gradients(gaussians))

    most_s = gradient_s(most)
    in_time = deadline.steps_in_time(most_s)
    part = in_time / rate.steps(settings)
    settings = hurried(settings, most.pixels, part * settings.effort.steps)
    step_s = most_s * in_time * deadline.settings.gradients_per_step / rate.steps(settings)
    finest, took_s = pyramid.finest if most_s <= step_s else most, most_s
    for level in pyramid.from_level(most).levels[1:]:
        if took_s <= step_s:
            break
        took_s, before_s = gradient_s(level), took_s
        if took_s > before_s / 2:  # a level is worth the detail it lacks if it halves the time
            break
        finest = level
    pyramid = pyramid.from_level(finest)
    return Plan(request, _within_pixels(settings, pyramid), pyramid)


def _within_pixels(settings: RdSettings, pyramid: Pyramid) -> RdSettings:
    """With a limit below which a Gaussian would fall between the pixels of the finest level."""
    optimiser, spacing = settings.fit.optimiser, pyramid.finest.frame.spacing
    narrowest = optimiser.min_scale_px if spacing == 1 else settings.pyramid.narrowest * spacing
    return replace(settings, fit=replace(settings.fit, optimiser=replace(optimiser, min_scale_px=narrowest)))
