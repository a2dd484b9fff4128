"""Every route of the API, in one list."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

from fastapi import Depends, FastAPI, Query, Request, Response
from fastapi.sse import EventSourceResponse
from pydantic import BaseModel, ConfigDict

from service.api import encode, events, health, jobs, pictures, previews
from service.api.callers import OPEN_PATHS
from service.api.files import BITSTREAM_TYPE
from service.api.models import EXAMPLE_ID, AcceptedView
from service.api.problems import ProblemError, problems
from service.api.uploads import no_body
from service.sandbox.pictures import MEDIA_TYPES

HOST = "http://127.0.0.1:8000"  # in commands
BINARY = {"schema": {"type": "string", "format": "binary"}}
NOT_MODIFIED: dict[int | str, dict[str, Any]] = {304: {"description": "the client has it already"}}


class _NoQuery(BaseModel):
    """A query without parameters."""

    model_config = ConfigDict(extra="forbid")


def _no_query(_query: Annotated[_NoQuery, Query()]) -> None:
    """Raises RequestValidationError: a misspelt parameter would be ignored, and the answer kept for long."""


def _given_once(request: Request) -> None:
    """Raises ProblemError 422."""
    for name in request.query_params:
        if len(request.query_params.getlist(name)) > 1:
            raise ProblemError(422, f"the query parameter {name} is given twice")


def _files(*media_types: str) -> dict[int | str, dict[str, Any]]:
    return {200: {"content": dict.fromkeys(media_types, BINARY)}}


def _body(media_type: str) -> dict[str, Any]:
    return {"requestBody": {"required": True, "content": {media_type: BINARY}}}


PICTURES = {**_files(*MEDIA_TYPES.values()), **NOT_MODIFIED}
BITSTREAM = {**_files(BITSTREAM_TYPE), **NOT_MODIFIED}
ENCODED = {200: {"description": "done in time", **_files(BITSTREAM_TYPE, *MEDIA_TYPES.values())[200]}}
NO_QUERY, NO_BODY = Depends(_no_query), Depends(no_body)
FILE: dict[str, Any] = {"response_class": Response}


@dataclass(frozen=True)
class Route:
    """curl: a command to copy, in the OpenAPI document and so at /docs, which a test runs; HOST and ID stand for the
    service and for a job. refusals: statuses of problem documents; answers, document: more for the OpenAPI document;
    checks: dependencies; options: of FastAPI's.
    """

    method: str
    path: str
    handler: Callable[..., Any]
    summary: str
    curl: str
    refusals: Sequence[int] = ()
    answers: dict[Any, Any] = field(default_factory=dict)
    document: dict[str, Any] = field(default_factory=dict)
    checks: Sequence[Any] = ()
    options: dict[str, Any] = field(default_factory=dict)


ROUTES = [
    Route(
        *("POST", "/encode", encode.encode, "Encode an image"),
        "--fail -F image=@photo.jpg -F bpp=0.3 'HOST/encode?wait=50' -o photo.sg",
        (400, 406, 409, 413, 415, 422, 429, 500, 503),
        ENCODED,
        {"requestBody": encode.ENCODE_BODY, "parameters": encode.PARAMETERS},
        options={"status_code": 202, "response_model": AcceptedView},
    ),
    Route(
        *("POST", "/jobs/{job_id}/encode", encode.encode_again, "Re-encode a job's image"),
        "-X POST 'HOST/jobs/ID/encode?bpp=0.5'",
        (400, 404, 406, 409, 410, 413, 415, 422, 429, 500, 503),
        ENCODED,
        {"requestBody": encode.AGAIN_BODY, "parameters": encode.PARAMETERS},
        options={"status_code": 202, "response_model": AcceptedView},
    ),
    Route(*("GET", "/jobs/{job_id}", jobs.status, "Get a job", "HOST/jobs/ID"), (404, 422, 503), checks=(NO_QUERY,)),
    Route("GET", "/jobs", jobs.jobs, "List jobs", "'HOST/jobs?state=done&limit=20'", (422, 503)),
    Route(
        *("GET", "/jobs/{job_id}/events", events.events, "Follow a job", "-N HOST/jobs/ID/events"),
        (404, 422, 503),
        # The place comes first: too many streams are refused before a job is looked up.
        checks=(Depends(events.one_stream), NO_QUERY),
        options={"response_class": EventSourceResponse},
    ),
    Route(
        *("POST", "/jobs/{job_id}/links", jobs.links, "Create links that need no API key"),
        "-X POST 'HOST/jobs/ID/links?expires_s=600'",
        (404, 422, 503),
        checks=(NO_BODY,),
    ),
    Route(
        *("POST", "/jobs/{job_id}/stop", jobs.stop, "Finish an encode early", "-X POST HOST/jobs/ID/stop"),
        (404, 409, 422, 503),
        checks=(NO_QUERY, NO_BODY),
        options={"status_code": 202},
    ),
    Route(
        *("DELETE", "/jobs/{job_id}", jobs.remove, "Cancel and remove a job", "-X DELETE HOST/jobs/ID"),
        (404, 422, 503),
        checks=(NO_QUERY, NO_BODY),
        options={"status_code": 204},
    ),
    Route(
        *("GET", "/decode/{job_id}.{kind}", pictures.picture, "The picture of a job"),
        "'HOST/decode/ID.webp?width=320' -o photo.webp",
        (404, 409, 422, 429, 503),
        PICTURES,
        options=FILE,
    ),
    Route(
        *("GET", "/decode/{job_id}", pictures.picture_as_accepted, "The picture of a job, by Accept header"),
        "-H 'Accept: image/avif' HOST/decode/ID -o photo.avif",
        (404, 406, 409, 422, 429, 503),
        PICTURES,
        options=FILE,
    ),
    Route(
        *("POST", "/decode", pictures.picture_of_body, "Decode a bitstream, by Accept header"),
        "--data-binary @photo.sg HOST/decode -o photo.png",
        (406, 413, 422, 429, 503),
        _files(*MEDIA_TYPES.values()),
        _body(BITSTREAM_TYPE),
        options=FILE,
    ),
    Route(
        *("POST", "/decode.{kind}", pictures.picture_of_body_as, "Decode a bitstream"),
        "--data-binary @photo.sg 'HOST/decode.jpg?quality=80&scale=0.5' -o small.jpg",
        (404, 413, 422, 429, 503),
        _files(*MEDIA_TYPES.values()),
        _body(BITSTREAM_TYPE),
        options=FILE,
    ),
    Route(
        *("GET", "/bitstreams/{job_id}.sg", pictures.bitstream, "The bitstream of a job"),
        "HOST/bitstreams/ID.sg -o photo.sg",
        (404, 409, 422, 503),
        BITSTREAM,
        checks=(NO_QUERY,),
        options=FILE,
    ),
    Route(
        *("GET", "/jobs/{job_id}/preview.sg", pictures.preview, "Preview of a running job"),
        "HOST/jobs/ID/preview.sg -o preview.sg",
        (404, 422, 503),
        {**BITSTREAM, 204: {"description": "no preview yet"}},
        checks=(NO_QUERY,),
        options=FILE,
    ),
    Route(
        *("GET", "/jobs/{job_id}/rival.{kind}", pictures.rival, "The same image in another codec, at the same size"),
        "HOST/jobs/ID/rival.avif -o rival.avif",
        (404, 409, 410, 422, 429, 503),
        {**_files(*(MEDIA_TYPES[kind] for kind in ("jpg", "webp", "avif"))), **NOT_MODIFIED},
        checks=(NO_QUERY,),
        options=FILE,
    ),
    Route(
        *("POST", "/preview", previews.preview, "A preview of an image, as text"),
        "--fail --data-binary @photo.jpg 'HOST/preview?bytes=200'",
        (413, 415, 422, 429, 503),
        document=_body("image/*"),
    ),
    Route("GET", "/livez", health.live, "Liveness", "HOST/livez", (422,), checks=(NO_QUERY,)),
    Route("GET", "/readyz", health.ready, "Readiness", "HOST/readyz", (422, 503), checks=(NO_QUERY,)),
    Route(
        *("GET", "/metrics", health.metrics, "Prometheus metrics", "HOST/metrics"),
        (422,),
        {200: {"content": {"text/plain": {}}}},
        checks=(NO_QUERY,),
        options=FILE,
    ),
]


def add_routes(app: FastAPI, key_check: Sequence[Any]) -> None:
    """Give the application all routes. key_check: the dependency by which the document says that a key is needed."""
    for route in ROUTES:
        guarded = bool(key_check) and route.path not in OPEN_PATHS
        source = f"curl {route.curl}".replace("HOST", HOST).replace("ID", EXAMPLE_ID)
        sample = {"lang": "Shell", "label": "curl", "source": source}
        app.add_api_route(
            route.path,
            route.handler,
            methods=[route.method],
            summary=route.summary,
            dependencies=[*route.checks, Depends(_given_once), *(key_check if guarded else ())],
            responses={**route.answers, **problems(*route.refusals, *((401,) if guarded else ()))},
            openapi_extra={**route.document, "x-codeSamples": [sample]},
            **route.options,
        )
