"""Previews for pages: an image comes in as the body, its text leaves at once, and nothing is stored."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api import models
from service.api.context import UseCaller, UseContext
from service.api.files import NEVER_STORED
from service.api.problems import ProblemError
from service.api.uploads import FORM_TYPE, body_as_file, media_type, refusal
from service.api.waiting import while_client_waits
from service.sandbox.client import RefusedError, TaskError

LEAST_BYTES, MOST_BYTES = 12, 4096


class PreviewQuery(BaseModel):
    """How large a preview may be."""

    model_config = ConfigDict(extra="forbid")

    bytes: int = Field(default=200, ge=LEAST_BYTES, le=MOST_BYTES, description="of the .sg file, 4 characters for 3")


async def preview(
    request: Request,
    response: Response,
    context: UseContext,
    caller: UseCaller,
    query: Annotated[PreviewQuery, Query()],
) -> models.PreviewView:
    """A text that a page shows until the image has loaded, with the image's size and average colour. The image is the
    body. It is answered at once, without a job, within the limits of decodes."""
    if media_type(request) == FORM_TYPE:
        raise ProblemError(415, "the body must be the image itself, not a form", headers={"Accept": "image/*"})
    async with body_as_file(request) as image:
        try:
            made = await while_client_waits(request, context.tasks.preview(caller.client, image.file, query.bytes))
        except RefusedError as error:
            raise await refusal(error, image) from error
        except TaskError as error:
            raise ProblemError(422, f"the image cannot be encoded: {error}") from error
    response.headers.update(NEVER_STORED)
    return models.PreviewView(**made.model_dump())
