"""Files as answers: which format the client takes, what it has already, which part it asks for."""

from __future__ import annotations

import re
from collections.abc import Mapping

from fastapi import Request, Response

from service.sandbox.picture_files import MEDIA_TYPES, PictureFormat
from service.web.guards.headers import joined
from service.web.guards.problems import ProblemError

# Private, because an id is a secret that shared caches should not keep.
IMMUTABLE = "private, max-age=31536000, immutable"
VARIES = {"Vary": "Accept"}
NEVER_STORED = {"Cache-Control": "no-store"}

_RANGE = re.compile(r"bytes=([0-9]{0,18})-([0-9]{0,18})", re.ASCII | re.IGNORECASE)


def accepted_format(request: Request) -> PictureFormat:
    """The format that the Accept header prefers; PNG without a preference. Raises ProblemError 406."""
    accept = joined(request.headers, "accept") or "*/*"
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


def has_already(request: Request, etag: str | None) -> bool:
    """Whether If-None-Match names the tag of a file that is asked for (RFC 9110, 13.1); etag: None for what has none.

    Raises ProblemError 412 if a condition fails, or holds only for what the client has. There are no dates to compare.
    """
    if request.method == "POST":  # conditions are on what lies at the address: its answer is something else
        return False
    wanted, known = (_tags(request, name) for name in ("if-match", "if-none-match"))
    has = known == ["*"] or (etag is not None and etag in [tag.removeprefix("W/") for tag in known])
    if (wanted not in ([], ["*"]) and etag not in wanted) or (has and request.method != "GET"):
        raise ProblemError(412, "the file does not meet the request's precondition")
    return has


def _tags(request: Request, header: str) -> list[str]:
    return [tag for tag in map(str.strip, (joined(request.headers, header) or "").split(",")) if tag]


def not_modified(headers: Mapping[str, str]) -> Response:
    """What a client has already is not sent again."""
    return Response(status_code=304, headers={k: v for k, v in headers.items() if k != "Content-Disposition"})


def file_answer(request: Request, file: bytes, media_type: str, headers: Mapping[str, str]) -> Response:
    """The file, or the part that a Range header names (RFC 9110, 14.2). headers: ETag among them.

    Raises ProblemError 416. Several parts at once are answered with the whole file, as is a range of another version.
    """
    headers = {**headers, "Accept-Ranges": "bytes"}
    match = _RANGE.fullmatch((joined(request.headers, "range") or "").replace(" ", ""))
    if match is None or match.group() == "bytes=-" or request.method != "GET":
        return Response(file, headers=headers, media_type=media_type)
    if joined(request.headers, "if-range") not in (None, headers.get("ETag")):
        return Response(file, headers=headers, media_type=media_type)
    first, last = match[1], match[2]
    begin = int(first) if first else max(len(file) - int(last), 0)
    end = min(int(last) + 1, len(file)) if first and last else len(file)
    if first and last and int(last) < begin:
        return Response(file, headers=headers, media_type=media_type)  # no range at all
    if begin >= end:
        raise ProblemError(416, f"the file has {len(file)} bytes", headers={"Content-Range": f"bytes */{len(file)}"})
    headers["Content-Range"] = f"bytes {begin}-{end - 1}/{len(file)}"
    return Response(file[begin:end], status_code=206, headers=headers, media_type=media_type)
