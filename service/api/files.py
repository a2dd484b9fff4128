"""Files as answers: which format the client takes, and what it has already."""

from __future__ import annotations

import re
from collections.abc import Mapping

from fastapi import Request, Response

from service.api.callers import header_line
from service.api.problems import ProblemError
from service.sandbox.pictures import MEDIA_TYPES, PictureFormat

# Private, because an id is a secret that shared caches should not keep.
IMMUTABLE = "private, max-age=31536000, immutable"
VARIES = {"Vary": "Accept"}
NEVER_STORED = {"Cache-Control": "no-store"}
BITSTREAM_TYPE = "application/octet-stream"


def accepted_format(request: Request) -> PictureFormat:
    """The format that the Accept header prefers; PNG without a preference. Raises ProblemError 406."""
    accept = header_line(request.headers, "accept") or "*/*"
    weights: dict[str, float] = {}
    for entry in accept.split(","):
        name, *parameters = (part.strip().lower() for part in entry.split(";"))
        given = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        weights[name] = float(given) if re.fullmatch(r"[01](\.[0-9]{0,3})?", given) else 1.0
    best: PictureFormat = "png"
    most = 0.0
    for kind, media_type in MEDIA_TYPES.items():  # PNG comes first
        weight = next((weights[name] for name in (media_type, "image/*", "*/*") if name in weights), 0.0)
        if weight > most:
            best, most = kind, weight
    if most == 0:
        raise ProblemError(406, f"pictures are available as {', '.join(MEDIA_TYPES.values())}", headers=VARIES)
    return best


def not_modified(request: Request, headers: Mapping[str, str]) -> Response | None:
    """304 if the client has the file of these headers (RFC 9110, 13.1.2); ETag is among them."""
    given = header_line(request.headers, "if-none-match") if request.method == "GET" else None
    known = [tag.strip().removeprefix("W/") for tag in (given or "").split(",")]
    if "*" not in known and headers["ETag"] not in known:
        return None
    kept = {name: value for name, value in headers.items() if name != "Content-Disposition"}
    return Response(status_code=304, headers=kept)
