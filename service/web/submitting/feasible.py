"""Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the picture.

The encoder refuses them too. It cannot be asked here: it loads libraries that a web process does without.
"""

from __future__ import annotations

from dataclasses import replace

from service.jobs.job import SourceImage
from service.web.guards.problems import ProblemError
from service.web.submitting.fields import Asked
from sgmethod.bitstream.smallest import smallest_file
from sgmethod.budget import Budget, default_budget
from sgmethod.metrics.looks import SMALLEST_SIDE
from sgmethod.profiles import PROFILES
from sgmethod.settings.rd import RdSettings


def feasible(asked: Asked, image: SourceImage) -> Asked:
    """The same, with the default budget raised to the smallest file for a tiny image. Raises ProblemError 422 if no
    file of the image meets the budget."""
    request, settings = asked.request, PROFILES[asked.request.profile]
    budget, pixels = Budget(request.budget_kind, request.budget_value), image.width * image.height
    if not asked.has_budget:
        budget = default_budget(image.width, image.height, smallest_file(settings, has_alpha=True))
        return replace(asked, request=replace(request, budget_kind=budget.kind, budget_value=budget.value))
    if budget.kind in ("looks", "quality") and not isinstance(settings, RdSettings):
        detail = f"profile {request.profile} has no {budget.kind} scale; use bpp, bytes, psnr or gaussians"
        raise ProblemError(422, detail)
    if budget.kind == "looks" and min(image.width, image.height) < SMALLEST_SIDE:
        raise ProblemError(422, f"looks are undefined for sides below {SMALLEST_SIDE} pixels")
    if budget.kind == "gaussians" and budget.value > pixels:
        raise ProblemError(422, f"{budget.value:.0f} Gaussians exceed the image's {pixels} pixels")
    allowed, least = budget.max_bytes(image.width, image.height), smallest_file(settings)
    if allowed is not None and allowed < least:
        detail = f"a file of profile {request.profile} takes at least {least} bytes, the budget is {allowed}"
        raise ProblemError(422, detail)
    return asked
