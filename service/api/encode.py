"""POST /encode: its options, the job that it makes, and the wait for the finished file.

Jobs that cannot succeed are refused when they are submitted, not when a worker has loaded the image.
"""

from __future__ import annotations

import errno
import hashlib
import time
from collections.abc import Iterable
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from mmap import ACCESS_READ, mmap
from typing import Annotated, Any, BinaryIO

from fastapi import Response
from fastapi.responses import JSONResponse
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, WithJsonSchema
from pydantic.dataclasses import dataclass
from pydantic.json_schema import SkipJsonSchema

from service.api import requests
from service.api.context import Context, UseCall
from service.api.decode import file_of_ended
from service.api.jobs import accepted, waited
from service.api.problems import ProblemError
from service.errors import KeyReusedError, LimitError
from service.jobs.job import (
    EncodeRequest,
    ImageView,
    Job,
    NewJob,
    Priority,
    new_job_id,
)
from service.jobs.table import JobTable
from service.storage.files import discard, source_key
from sgmethod import profiles
from sgmethod.budget import BUDGET_KINDS, QUALITIES, bytes_value
from sgmethod.encode_arguments import EncodeArguments, EncodeOptions, only_budget


def _given(description: str, example: float, **extra: Any) -> Any:
    return Field(default=None, description=description, examples=[example], json_schema_extra=extra)


_positive = partial(_given, exclusiveMinimum=0)
QUALITY_SCHEMA = {
    "anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": 100}, {"type": "string", "enum": [*QUALITIES]}]
}
BYTES_SCHEMA = {
    "anyOf": [
        {"type": "number", "exclusiveMinimum": 0},
        {"type": "string", "pattern": r"^[0-9]+(\.[0-9]+)?([kKmM][bB]?|[kKmM][iI][bB])$"},
    ]
}
Number = float | SkipJsonSchema[None]


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class EncodeQuery(EncodeOptions):
    """Everything that a client may ask of an encode.

    Give at most one budget. The default is a quality of 60 in at most 0.5 bits per pixel.
    """

    bpp: Number = _positive("budget: maximum bits per pixel", 0.3)
    bytes: Annotated[Number, BeforeValidator(bytes_value), WithJsonSchema(BYTES_SCHEMA)] = _given(
        "budget: maximum bytes, such as 20000, 20k, 1.5MB or 20KiB", 20_000
    )
    quality: Annotated[
        Number, BeforeValidator(lambda text: QUALITIES.get(text, text)), WithJsonSchema(QUALITY_SCHEMA)
    ] = _given("budget: target SSIMULACRA 2, up to 100, or preview (40), web (60), archive (80); profile rd only", 60)
    psnr: Number = _positive("budget: target PSNR in dB, at most 60", 32)
    gaussians: Number = _positive("budget: number of Gaussians", 1000)
    priority: Priority = Field(default="interactive", description="interactive jobs run before bulk jobs")

    def checked(self) -> EncodeArguments:
        """Return the arguments of the encode. Raises BudgetError."""
        budget = only_budget(None, {kind: getattr(self, kind) for kind in BUDGET_KINDS})
        return EncodeArguments.checked(budget, self.profile, self.tune, self.effort)

    def request(self, image: ImageView, max_s: float) -> EncodeRequest:
        """Return the encoder's part of the request. max_s: the longest and default time limit in seconds.

        Raises BudgetError or ProblemError 422 if no file of the image could meet it.
        """
        seconds = max_s if self.time_limit_s is None else self.time_limit_s
        if not 0 < seconds <= max_s:
            raise ProblemError(422, f"time_limit_s must be more than 0 and at most {max_s:g}")
        asked = self.checked()
        if not all(map(find_spec, profiles.method_of(asked.profile).packages)):
            raise ProblemError(422, f"profile {asked.profile} needs PyTorch, which this service lacks; use profile rd")
        asked = asked.for_size(image.width, image.height, has_alpha=True)
        asked.check_size(image.width, image.height)
        taken = {"budget": asdict(asked.budget), "tune": asked.tune, "effort": asked.effort, "time_limit_s": seconds}
        return EncodeRequest.model_validate({**self.options(), **taken})


queries = TypeAdapter(EncodeQuery)


def _of_parameter(schema: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a field as a parameter has it: without a title, and left out instead of null."""
    either = schema.get("anyOf", ())
    kind = {} if {"type": "null"} not in either else next(one for one in either if one != {"type": "null"})
    hidden = {"title", "anyOf"} if kind else {"title"}
    return {**kind, **{word: value for word, value in schema.items() if word not in hidden and value is not None}}


OPTION_SCHEMAS = {name: _of_parameter(schema) for name, schema in queries.json_schema()["properties"].items()}
BINARY: dict[str, Any] = {"type": "string", "format": "binary"}
FORM: dict[str, Any] = {
    "type": "object",
    "additionalProperties": False,
    "required": [requests.IMAGE_FIELD],
    "properties": {requests.IMAGE_FIELD: BINARY, **OPTION_SCHEMAS},
}
PARAMETERS: list[dict[str, Any]] = [
    {
        "name": "Idempotency-Key",
        "in": "header",
        "description": "repeating a request with the same key returns its first job; another request gets 422",
        "schema": {"type": "string", "maxLength": 255, "pattern": "^[!-~]+$"},
    },
    *({"name": name, "in": "query", "schema": schema} for name, schema in OPTION_SCHEMAS.items()),
]
ENCODE_BODY: dict[str, Any] = {
    "required": True,
    "description": "a form with the image and the options, or the image itself with the options in the query",
    "content": {requests.FORM_TYPE: {"schema": FORM}, "image/*": {"schema": BINARY}},
}


async def encode(call: UseCall, wait: requests.Wait = 0) -> Response:
    """Submit an image for encoding, with at most one budget.

    With `wait`, the response is the finished file (or the decoded picture, if the Accept header asks for one) when the
    job is done in time. If it fails in that time, 422 if the codec refused the image, else 500. Otherwise 202 and the
    job as JSON.
    """
    request, context, caller = call.request, call.context, call.caller
    kind, key = requests.picture_kind(request) if wait else None, requests.idempotency_key(request)
    await context.read(context.table.check_queue, caller.client, caller.owner, key)  # before the body is read
    async with requests.image_and_fields(request) as (image, fields):
        deadline = time.monotonic() + min(wait, requests.MAX_WAIT_S)  # a proxy's, too, counts from here
        query = read_options(fields)
        # First, since what would be refused now may have been accepted then.
        job, fingerprint = await context.read(_earlier, context.table, query, image.file, caller.owner, key)
        if job is None:
            header = await context.tasks.read_header(caller.client, image)
            wanted = query.request(header, context.settings.max_time_limit_s)
            new = NewJob(new_job_id(), wanted, header, fingerprint, key, caller.owner, query.priority, caller.client)
            job = await context.store(_accept, context, new, image.file)
    known = accepted(job, context.settings)
    headers, file = {"Location": known.status_url, **requests.NEVER_STORED}, None
    if wait:
        job = await waited(call, job, deadline)
        file = await file_of_ended(call, job, kind, headers)
    return file or JSONResponse(known.model_dump(), 202, headers)


def _earlier(
    table: JobTable, query: EncodeQuery, image: BinaryIO, owner: str | None, key: str | None
) -> tuple[Job | None, str]:
    """Return the job that a request with this key made before, and a digest of this one, independent of settings."""
    if key is None:
        return None, ""
    image.seek(0)
    digest = hashlib.file_digest(image, "sha256").hexdigest()  # type: ignore[arg-type]
    fingerprint = hashlib.sha256(queries.dump_json(query, exclude_defaults=True) + f" {digest}".encode()).hexdigest()
    return table.first(owner, key, fingerprint), fingerprint


def _accept(context: Context, new: NewJob, image: BinaryIO) -> Job:
    """Store the image, then insert the job. Only then may the client get an answer."""
    free_bytes = context.storage.free_bytes()  # a large upload is a temporary file there, and so counted already
    if free_bytes is not None and free_bytes < context.settings.min_free_bytes:
        raise OSError(errno.ENOSPC, f"No space left for new jobs: {free_bytes} bytes are free")
    # Mapped, since the images of many requests at once would fill the memory.
    context.storage.put(source_key(new.id), memoryview(mmap(image.fileno(), 0, access=ACCESS_READ)))
    try:  # after an error of the table, the image stays for the sweep: the row may have been written
        job, is_new = context.table.submit(new)
    except (LimitError, KeyReusedError):
        discard(context.storage, source_key(new.id))
        raise
    if not is_new:
        discard(context.storage, source_key(new.id))
    return job


def read_options(fields: Iterable[tuple[str, str]]) -> EncodeQuery:
    """Parse the options among the fields of the query and of a form. Raises ProblemError 422, BudgetError."""
    texts: dict[str, str] = {}
    for name, value in fields:
        if name in texts:
            raise ProblemError(422, f"the field {name} is given twice")
        texts[name] = value
    try:
        query = queries.validate_python(texts)
    except ValidationError as error:
        fault = error.errors()[0]
        field = fault["loc"][0]
        if fault["type"] == "unexpected_keyword_argument":
            raise ProblemError(422, f"unknown field {field!r}; the options are {', '.join(OPTION_SCHEMAS)}") from error
        raise ProblemError(422, f"{field}: {fault['msg']}") from error
    query.checked()
    return query
