"""The same request answers with the file, when its job is done in time."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from typing import Any

from anyio import to_thread
from fastapi import Request, Response

from service.jobs.job import FINAL_STATES, Job
from service.sandbox.picture_files import MEDIA_TYPES
from service.web.guards.headers import joined
from service.web.guards.problems import ProblemError
from service.web.routes.decoding import ViewQuery
from service.web.routes.file_answers import VARIES, accepted_format
from service.web.routes.gone import set_within, while_client_waits
from service.web.routes.parts import Parts
from service.web.routes.pictures import BITSTREAM_TYPE, bitstream_answer, picture_answer
from service.web.submitting.submission import WAIT_FIELD

FIRST_POLL_S, POLL_S = 0.05, 0.2  # a small picture takes less than the latter; it is for those who wait for long
MAX_WAIT_S = 50  # proxies give up on an answer that has not begun after 60 s, unless told otherwise

_PREFER = re.compile(r"(?:^|[,;])\s*wait\s*=\s*([0-9]{1,6})\s*(?=[,;]|$)", re.IGNORECASE)

_BINARY = {"schema": {"type": "string", "format": "binary"}}
ENCODED: dict[int | str, dict[str, Any]] = {
    200: {"description": "done in time", "content": dict.fromkeys((BITSTREAM_TYPE, *MEDIA_TYPES.values()), _BINARY)}
}
WAIT_PARAMETERS: list[dict[str, Any]] = [
    {
        "name": WAIT_FIELD,
        "in": "query",
        "description": f"seconds to wait for the file; 202 after that, and after {MAX_WAIT_S} seconds at the latest",
        "schema": {"type": "integer", "minimum": 0, "maximum": 999_999},
    },
    {
        "name": "Prefer",
        "in": "header",
        "description": "`wait=30` is the same as the query parameter; what cannot be read is ignored",
        "schema": {"type": "string"},
    },
]


def wished_wait_s(request: Request) -> int:
    """Seconds that the client would wait; 0 unless it says so. Raises ProblemError 422."""
    given = request.query_params.getlist(WAIT_FIELD)
    if len(given) > 1:
        raise ProblemError(422, f"the query parameter {WAIT_FIELD} is given twice")
    if given:
        if not re.fullmatch(r"[0-9]{1,6}", given[0], re.ASCII):
            raise ProblemError(422, f"{WAIT_FIELD} must be a whole number of seconds (capped at {MAX_WAIT_S})")
        return min(int(given[0]), MAX_WAIT_S)
    preferred = _PREFER.search(joined(request.headers, "prefer") or "")  # RFC 7240
    return min(int(preferred[1]), MAX_WAIT_S) if preferred else 0


async def job_within(request: Request, job: Job, seconds: int, parts: Parts) -> Job | None:
    """The job once it has ended, None if it has not in time. Raises ProblemError 409 if it is removed meanwhile."""
    client = request.state.caller.client
    if parts.streams.refusal(client) is not None:  # too many wait already
        return None
    with parts.streams.taken(client):
        return await while_client_waits(request, _ended(job, time.monotonic() + seconds, parts))


async def _ended(job: Job, deadline: float, parts: Parts) -> Job | None:
    pause_s = FIRST_POLL_S
    while job.state not in FINAL_STATES:
        pause_s = min(1.1 * pause_s, POLL_S)
        if time.monotonic() >= deadline or await set_within(parts.stopping, pause_s):
            return None
        seen = await to_thread.run_sync(parts.table.get, job.id)
        if seen is None:
            raise ProblemError(409, "the job was removed before it was done")
        job = seen
    return job


async def outcome(request: Request, job: Job, parts: Parts, headers: Mapping[str, str]) -> Response:
    """The result of a finished job: its file, or its decoded picture. Raises ProblemError."""
    if job.error is not None and job.state == "failed":
        status = 422 if job.error.code == "refused" else 500
        raise ProblemError(status, job.error.detail, headers=headers, code=job.error.code, id=job.id)
    accept = (joined(request.headers, "accept") or "*/*").lower()
    if BITSTREAM_TYPE in accept or "image/" not in accept:
        answer = await bitstream_answer(request, job, parts)
    else:
        answer = await picture_answer(request, job, ViewQuery(), accepted_format(request), parts)
    answer.headers.update({**headers, **VARIES})
    return answer
