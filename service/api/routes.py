"""Every route of the API, in one list."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, get_args, get_type_hints

from fastapi import Depends, FastAPI, Query, Response
from fastapi.params import Query as QueryInfo

from service.api import decode, encode, health, jobs
from service.api.gate import OPEN_PATHS
from service.api.jobs import EXAMPLE_ID, AcceptedView
from service.api.problems import problems
from service.api.requests import BITSTREAM_TYPE, Parameters, no_body
from service.pictures import COMPARISONS, MEDIA_TYPES

HOST = "http://127.0.0.1:8000"  # in commands
PICTURES = tuple(MEDIA_TYPES.values())
BINARY = {"schema": {"type": "string", "format": "binary"}}
NOT_MODIFIED: dict[Any, Any] = {304: {"description": "the client has it already"}}


async def _no_query(_query: Annotated[Parameters, Query()]) -> None:
    """Raise RequestValidationError if there are parameters."""


def _body(media_type: str) -> dict[str, Any]:
    return {"requestBody": {"required": True, "content": {media_type: BINARY}}}


DONE_IN_TIME = {200: {"description": "done in time", "content": dict.fromkeys((BITSTREAM_TYPE, *PICTURES), BINARY)}}


@dataclass(frozen=True)
class Route:
    """A route of the API.

    curl: a command for the OpenAPI document and /docs, run by a test; HOST and ID stand for the service and a job.
    refusals: statuses of problem documents besides 404, 422 and 503; files: media types, if the answer is a file;
    answers: other responses; document: additions to the OpenAPI document; status: of a success; options: of FastAPI.
    """

    name: str  # method and path
    handler: Callable[..., Any]
    summary: str
    curl: str
    refusals: Sequence[int] = ()
    files: Sequence[str] = ()
    answers: dict[Any, Any] = field(default_factory=dict)
    document: dict[str, Any] = field(default_factory=dict)
    status: int = 200
    options: dict[str, Any] = field(default_factory=dict)


ROUTES = [
    Route(
        "POST /encode",
        encode.encode,
        "Encode an image",
        "--fail -F image=@photo.jpg -F bpp=0.3 'HOST/encode?wait=50' -o photo.sg",
        (400, 406, 409, 413, 415, 429, 500),
        answers=DONE_IN_TIME,
        document={"requestBody": encode.ENCODE_BODY, "parameters": encode.PARAMETERS},
        status=202,
        options={"response_model": AcceptedView},
    ),
    Route("GET /jobs/{job_id}", jobs.status, "Get a job", "HOST/jobs/ID"),
    Route("GET /jobs", jobs.jobs, "List jobs", "'HOST/jobs?state=done&limit=20'"),
    Route(
        "POST /jobs/{job_id}/links",
        jobs.links,
        "Create links that need no API key",
        "-X POST 'HOST/jobs/ID/links?expires_s=600'",
    ),
    Route("DELETE /jobs/{job_id}", jobs.remove, "Cancel and remove a job", "-X DELETE HOST/jobs/ID", status=204),
    Route(
        "GET /decode/{job_id}.{kind}",
        decode.picture,
        "The picture of a job",
        "'HOST/decode/ID.webp?width=320' -o photo.webp",
        (409, 429),
        PICTURES,
        NOT_MODIFIED,
    ),
    Route(
        "GET /decode/{job_id}",
        decode.picture_as_accepted,
        "The picture of a job, by Accept header",
        "-H 'Accept: image/avif' HOST/decode/ID -o photo.avif",
        (406, 409, 429),
        PICTURES,
        NOT_MODIFIED,
    ),
    Route(
        "POST /decode",
        decode.picture_of_body,
        "Decode a bitstream, by Accept header",
        "--data-binary @photo.sg HOST/decode -o photo.png",
        (406, 413, 429),
        PICTURES,
        document=_body(BITSTREAM_TYPE),
    ),
    Route(
        "POST /decode.{kind}",
        decode.picture_of_body_as,
        "Decode a bitstream",
        "--data-binary @photo.sg 'HOST/decode.jpg?quality=80&scale=0.5' -o small.jpg",
        (413, 429),
        PICTURES,
        document=_body(BITSTREAM_TYPE),
    ),
    Route(
        "GET /bitstreams/{job_id}.sg",
        decode.bitstream,
        "The bitstream of a job",
        "HOST/bitstreams/ID.sg -o photo.sg",
        (409,),
        [BITSTREAM_TYPE],
        NOT_MODIFIED,
    ),
    Route(
        "GET /jobs/{job_id}/comparison.{kind}",
        decode.comparison,
        "The same image in another codec, at the same size",
        "HOST/jobs/ID/comparison.avif -o comparison.avif",
        (409, 410, 429),
        [MEDIA_TYPES[kind] for kind in COMPARISONS],
        NOT_MODIFIED,
    ),
    Route(
        "POST /preview",
        decode.preview,
        "A preview of an image, as text",
        "--fail --data-binary @photo.jpg 'HOST/preview?bytes=200'",
        (413, 415, 429),
        document=_body("image/*"),
    ),
    Route("GET /livez", health.live, "Liveness", "HOST/livez"),
    Route("GET /readyz", health.ready, "Readiness", "HOST/readyz"),
    Route("GET /metrics", health.metrics, "Prometheus metrics", "HOST/metrics", files=["text/plain"]),
]


def _takes_query(handler: Callable[..., Any]) -> bool:
    hints = get_type_hints(handler, include_extras=True).values()
    return any(isinstance(note, QueryInfo) for hint in hints for note in get_args(hint)[1:])


def add_routes(app: FastAPI, key_check: Sequence[Any]) -> None:
    """Add all routes to the application. key_check: dependency that documents the API key."""
    for route in ROUTES:
        method, path = route.name.split()
        checks: list[Any] = []
        refusals = {*route.refusals, 422, 503}
        if not _takes_query(route.handler):
            checks.append(Depends(_no_query))
        if method != "GET" and "requestBody" not in route.document:
            checks.append(Depends(no_body))
        if "{" in path:
            refusals.add(404)
        if key_check and path not in OPEN_PATHS:
            checks += key_check
            refusals.add(401)
        answers, options = {**route.answers, **problems(*sorted(refusals))}, dict(route.options)
        if route.files:
            answers[200] = {"content": dict.fromkeys(route.files, BINARY)}
            options["response_class"] = Response
        source = f"curl {route.curl}".replace("HOST", HOST).replace("ID", EXAMPLE_ID)
        sample = {"lang": "Shell", "label": "curl", "source": source}
        app.add_api_route(
            path,
            route.handler,
            methods=[method],
            summary=route.summary,
            status_code=route.status,
            dependencies=checks,
            responses=answers,
            openapi_extra={**route.document, "x-codeSamples": [sample]},
            **options,
        )
