"""Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the picture.

The encoder refuses them too. It cannot be asked here: it takes torch.
"""

from __future__ import annotations

from service.jobs.job import EncodeRequest, SourceImage
from service.web.guards.problems import ProblemError
from sgmethod.bitstream.v1 import CODEBOOK_STAGES, COLOR_INDEX_BITS, file_bytes
from sgmethod.bitstream.v4 import StreamV4
from sgmethod.budget import Budget
from sgmethod.profiles import PROFILES, PaperSettings, RdSettings


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


def smallest_file(settings: RdSettings | PaperSettings) -> int:
    """Bytes of the smallest file that a profile writes."""
    if isinstance(settings, RdSettings):
        return StreamV4.MIN_BYTES
    groups = settings.max_bitwidth - settings.min_bitwidth + 1 if settings.adaptive_bitwidth else 1
    record = 2 * settings.position_bits + 3 * settings.min_bitwidth + CODEBOOK_STAGES * COLOR_INDEX_BITS
    return file_bytes(record, groups)
