"""Every error answer is an RFC 9457 problem document."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import Match
from starlette.types import Scope

from service.errors import JobTableError, KeyReusedError, LimitError
from service.logs import log_seldom
from service.sandbox.client import OutOfMemoryError, SandboxUnavailableError, TaskError
from sgmethod.errors import BudgetError, ViewError

log = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"
PAGE = "/docs"  # which explains each reason
METHODS = ("DELETE", "GET", "POST")  # that any route has
PROBLEM: dict[str, Any] = {
    "schema": {
        "type": "object",
        "required": ["type", "title", "status", "detail"],
        "properties": {
            "type": {"type": "string", "description": "where the kind of problem is explained"},
            "title": {"type": "string"},
            "status": {"type": "integer"},
            "detail": {"type": "string", "description": "one sentence"},
        },
    },
    "example": {"type": "/docs#unknown", "title": "Not Found", "status": 404, "detail": "there is no such job"},
}
RETRYABLE = (429, 503)  # refusals that say when to ask again
RETRY_AFTER = {"Retry-After": "5"}  # seconds
FULL_DISK = ("disk is full", "No space left")  # in messages of SQLite, and of the system and PostgreSQL
# The reason in metrics, logs and the type of a problem, unless the problem names its own.
REASONS = {
    **{400: "malformed", 401: "key", 404: "unknown", 405: "method", 406: "format", 409: "state"},
    **{410: "deleted", 413: "large", 415: "type", 421: "host", 422: "invalid", 500: "fault"},
}
# The reasons that problems name themselves. The counter of each begins with 0.
NAMED_REASONS = (
    *("queue", "own_queue", "quota", "own_quota", "turns", "own_turns"),
    *("cut", "disk", "memory", "origin", "sandbox", "stall", "stop", "storage", "table"),
)
REFUSAL = "refusal"  # the attribute of request.state that holds the reason


class ProblemError(Exception):
    """A response that refuses a request: HTTP status, one sentence, extra members and headers.

    reason: a fixed word, never a client's, because each has a metric. 429 and 503 have many causes and always name one.
    """

    def __init__(
        self, status: int, detail: str, *, reason: str = "", headers: Mapping[str, str] | None = None, **members: Any
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.reason = reason or REASONS[status]
        self.headers = dict(headers or {})
        self.members = members


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the statuses as responses of the OpenAPI document."""
    return {status: {"content": {MEDIA_TYPE: PROBLEM}, "description": HTTPStatus(status).phrase} for status in statuses}


def refused(scope: Scope, problem: ProblemError) -> Response:
    """Build the response for a problem, and note its reason in the state of the request."""
    scope["state"][REFUSAL] = problem.reason
    title = HTTPStatus(problem.status).phrase
    # Within a mount, root_path includes the mount's path.
    kind = f"{scope.get('app_root_path', scope.get('root_path', ''))}{PAGE}#{problem.reason}"
    document = {"type": kind, "title": title, "status": problem.status, "detail": problem.detail}
    headers = {"Cache-Control": "no-store", **problem.headers}
    return JSONResponse({**document, **problem.members}, problem.status, headers, media_type=MEDIA_TYPE)


def install_problem_handlers(app: FastAPI) -> None:
    """Answer every error of the application with a problem document."""
    ours = (ProblemError, BudgetError, ViewError, TaskError, JobTableError, KeyReusedError, LimitError)
    for kind in (*ours, RequestValidationError, HTTPException, ClientDisconnect, OSError, Exception):
        app.add_exception_handler(kind, _on_error)


async def _on_error(request: Request, error: Exception) -> Response:
    return refused(request.scope, _problem_of(request, error))


def _problem_of(request: Request, error: Exception) -> ProblemError:
    match error:
        case ProblemError():
            return error
        case BudgetError() | ViewError() | TaskError() | KeyReusedError():  # whose messages describe the request
            return ProblemError(422, str(error))
        case LimitError():
            return ProblemError(429, str(error), reason=error.reason, headers=RETRY_AFTER)
        case RequestValidationError():
            return _invalid_parameters(error)
        case HTTPException(status_code=405):
            return ProblemError(405, error.detail, headers={"Allow": _allowed_methods(request)})
        case HTTPException():
            return ProblemError(error.status_code, error.detail, headers=error.headers)
        case ClientDisconnect():
            return ProblemError(400, "the request ended before its body did", reason="cut")
        case JobTableError() | OSError() if any(words in str(error) for words in FULL_DISK):
            log_seldom(log, "the disk is full: %s", error)
            return ProblemError(503, "the disk is full", reason="disk", headers=RETRY_AFTER)
        case JobTableError():
            return _unreachable("the job table", "table", error)
        case OutOfMemoryError():
            return ProblemError(503, "the service is out of memory right now", reason="memory", headers=RETRY_AFTER)
        case SandboxUnavailableError():
            return _unreachable("the sandbox", "sandbox", error)
        case OSError():
            return _unreachable("the storage", "storage", error)
        case _:  # The server logs the traceback; the client gets no details.
            return ProblemError(500, "an internal error, which has been logged")


def _invalid_parameters(error: RequestValidationError) -> ProblemError:
    if any(e["loc"][0] == "path" for e in error.errors()):
        return ProblemError(404, "there is nothing at this address")
    errors = [{"where": ".".join(map(str, e["loc"])), "detail": _explain(e)} for e in error.errors()]
    return ProblemError(422, "; ".join(f"{e['where']}: {e['detail']}" for e in errors), errors=errors)


def _explain(error: Mapping[str, Any]) -> str:
    if error["type"] == "extra_forbidden":
        return "unknown query parameter"
    return str(error["msg"]).removeprefix("Value error, ")


def _unreachable(what: str, reason: str, error: Exception) -> ProblemError:
    log_seldom(log, f"{what} is unreachable: %s", error)
    return ProblemError(503, f"{what} is unreachable right now", reason=reason, headers=RETRY_AFTER)


def _allowed_methods(request: Request) -> str:
    """Return the methods of all routes at this path; the exception knows only the first route's."""

    def is_allowed(method: str) -> bool:
        scope = {**request.scope, "method": method}
        return any(route.matches(scope)[0] is Match.FULL for route in request.app.routes if isinstance(route, APIRoute))

    return ", ".join(filter(is_allowed, METHODS)) or "GET"  # of a static file, which is no route
