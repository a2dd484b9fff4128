"""Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the picture.

The encoder refuses them too. It cannot be asked here: it takes torch.
"""

from __future__ import annotations

from service.jobs.job import EncodeRequest, SourceImage
from service.web.guards.problems import ProblemError
from sgmethod.bitstream.smallest import smallest_file
from sgmethod.budget import Budget
from sgmethod.profiles import PROFILES, RdSettings


def check_feasible(request: EncodeRequest, image: SourceImage) -> None:
    """Raises ProblemError 422 if no file of the image meets the budget."""
    budget, settings = Budget(request.budget_kind, request.budget_value), PROFILES[request.profile]
    pixels = image.width * image.height
    if budget.kind == "quality" and not isinstance(settings, RdSettings):
        detail = f"profile {request.profile} has no quality scale; give bpp, bytes, psnr or gaussians"
        raise ProblemError(422, detail)
    if budget.kind == "gaussians" and budget.value > pixels:
        raise ProblemError(422, f"{budget.value:.0f} Gaussians are more than the image's {pixels} pixels")
    allowed, least = budget.max_bytes(image.width, image.height), smallest_file(settings)
    if allowed is not None and allowed < least:
        detail = f"a file of profile {request.profile} takes at least {least} bytes, the budget is {allowed}"
        raise ProblemError(422, detail)
