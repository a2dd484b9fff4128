"""From the body of POST /encode to a job that may be accepted: everything is checked before."""

from __future__ import annotations

import hashlib
import json
import math
import re
from contextlib import AbstractAsyncContextManager
from dataclasses import asdict

from starlette.datastructures import FormData, UploadFile
from starlette.requests import Request

from service.jobs import EncodeRequest, NewJob, SourceImage, new_job_id
from service.problems import ProblemError
from service.settings import Settings
from sgmethod.budget import BUDGET_KINDS, Budget
from sgmethod.errors import BudgetError, ImageError
from sgmethod.image import PNG_MAGIC, TIFF_MAGICS, ImageLimits, read_header
from sgmethod.profiles import DEFAULT_PROFILE, PROFILE_NAMES

IMAGE_FIELD = "image"
FIELDS = (*BUDGET_KINDS, "profile", "time_limit_s")
MAX_FIELD_BYTES = 256
# What multipart adds to the image itself: boundaries, part headers, the other fields.
MULTIPART_OVERHEAD_BYTES = 16 * 1024

IMAGE_MAGICS = (PNG_MAGIC, b"\xff\xd8\xff", b"RIFF", *TIFF_MAGICS, b"BM")

# Stricter than float(), which also takes "1_0", "nan" and spaces around.
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
_IDEMPOTENCY_KEY = re.compile(r"[!-~]{1,255}")


def idempotency_key(request: Request) -> str | None:
    """The Idempotency-Key header. Raises ProblemError 400 if it is not 1 to 255 visible ASCII characters."""
    key = request.headers.get("idempotency-key")
    if key is not None and _IDEMPOTENCY_KEY.fullmatch(key) is None:
        raise ProblemError(400, "Idempotency-Key must be 1 to 255 visible ASCII characters")
    return key


def check_content_type(request: Request) -> None:
    """Raises ProblemError 415 unless the body is multipart/form-data."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "multipart/form-data":
        raise ProblemError(415, "the body must be multipart/form-data", headers={"Accept": "multipart/form-data"})


def open_form(request: Request) -> AbstractAsyncContextManager[FormData]:
    """The form, read as the body comes in; what is large goes to temporary files, closed with the context.

    Entering raises ProblemError 408 or 413, or HTTPException 400 on what is no form.
    """
    return request.form(max_files=1, max_fields=len(FIELDS), max_part_size=MAX_FIELD_BYTES)


def wanted_encode(form: FormData, settings: Settings) -> EncodeRequest:
    """What the form's fields ask for. Raises ProblemError 422."""
    fields = _text_fields(form)
    budget = _budget(fields)
    time_limit_s = _time_limit_s(fields, settings.max_time_limit_s)
    return EncodeRequest(budget.kind, budget.value, _profile(fields), time_limit_s)


async def image_bytes(form: FormData, max_bytes: int) -> bytes:
    """The form's image file. Raises ProblemError 413 or 422."""
    upload = form.get(IMAGE_FIELD)
    if not isinstance(upload, UploadFile):
        raise ProblemError(422, f"the field {IMAGE_FIELD} is missing, or is not a file")
    image = await upload.read(max_bytes + 1)
    if len(image) > max_bytes:
        raise ProblemError(413, f"the image is larger than {max_bytes} bytes", max_bytes=max_bytes)
    return image


def new_job(image: bytes, wanted: EncodeRequest, key: str | None, settings: Settings) -> NewJob:
    """The job to accept, once the image's header has been looked at; no pixel is decoded.

    Raises ProblemError 415 for what is none of the formats, 422 for a damaged header or a size beyond
    the limits.
    """
    header = _checked_header(image, settings)
    digest = hashlib.sha256(json.dumps(asdict(wanted)).encode())
    digest.update(image)
    return NewJob(new_job_id(), wanted, header, digest.hexdigest(), key)


def _text_fields(form: FormData) -> dict[str, str]:
    fields: dict[str, str] = {}
    for name, value in form.multi_items():
        if name == IMAGE_FIELD:
            continue
        if name not in FIELDS:
            raise ProblemError(422, f"unknown field {name!r}; the fields are {IMAGE_FIELD}, {', '.join(FIELDS)}")
        if name in fields:
            raise ProblemError(422, f"the field {name} is given twice")
        if not isinstance(value, str):
            raise ProblemError(422, f"the field {name} must be text, not a file")
        fields[name] = value
    return fields


def _number(name: str, text: str) -> float:
    if _NUMBER.fullmatch(text) is None:
        raise ProblemError(422, f"{name} must be a number, got {text!r}")
    return float(text)


def _budget(fields: dict[str, str]) -> Budget:
    kinds = [kind for kind in BUDGET_KINDS if kind in fields]
    if len(kinds) != 1:
        raise ProblemError(422, f"give exactly one of {', '.join(BUDGET_KINDS)}; got {len(kinds)}")
    try:
        return Budget(kinds[0], _number(kinds[0], fields[kinds[0]]))
    except BudgetError as error:
        raise ProblemError(422, str(error)) from error


def _profile(fields: dict[str, str]) -> str:
    profile = fields.get("profile", DEFAULT_PROFILE)
    if profile not in PROFILE_NAMES:
        raise ProblemError(422, f"unknown profile {profile!r}; use one of {', '.join(PROFILE_NAMES)}")
    return profile


def _time_limit_s(fields: dict[str, str], most_s: float) -> float:
    if "time_limit_s" not in fields:
        return most_s
    seconds = _number("time_limit_s", fields["time_limit_s"])
    if not (math.isfinite(seconds) and 0 < seconds <= most_s):
        raise ProblemError(422, f"time_limit_s must be more than 0 and at most {most_s:g}")
    return seconds


def _checked_header(image: bytes, settings: Settings) -> SourceImage:
    if image and not image.startswith(IMAGE_MAGICS):
        raise ProblemError(415, "the file is not a PNG, JPEG, WebP, TIFF or BMP image")
    try:
        header = read_header(image, ImageLimits(settings.max_pixels, settings.max_side))
    except ImageError as error:
        raise ProblemError(422, str(error)) from error
    return SourceImage(header.format, header.width, header.height, len(image))
