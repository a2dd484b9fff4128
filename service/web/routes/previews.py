"""Previews for pages: an image comes in as the body, its text leaves at once, and nothing is stored."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from service.sandbox.client import RefusedError, TaskError
from service.web.guards.problems import ProblemError, problems
from service.web.routes import answers
from service.web.routes.answers import curl
from service.web.routes.file_answers import NEVER_STORED
from service.web.routes.gone import while_client_waits
from service.web.routes.parts import UseCaller, UseParts
from service.web.submitting.bodies import body_as_file
from service.web.submitting.submission import FORM_TYPE, refusal

router = APIRouter()

LEAST_BYTES, MOST_BYTES = 12, 4096
IMAGE_BODY: dict[str, Any] = {
    "required": True,
    "content": {"image/*": {"schema": {"type": "string", "format": "binary"}}},
}


@router.post(
    "/preview",
    responses=problems(408, 413, 415, 422, 429, 503),
    summary="A preview of an image, as text",
    openapi_extra={"requestBody": IMAGE_BODY, **curl("--fail --data-binary @photo.jpg 'HOST/preview?bytes=200'")},
)
async def preview(
    request: Request,
    response: Response,
    parts: UseParts,
    caller: UseCaller,
    most_bytes: Annotated[
        int, Query(alias="bytes", ge=LEAST_BYTES, le=MOST_BYTES, description="of the .sg file, 4 characters for 3")
    ] = 200,
) -> answers.PreviewView:
    """A text that a page shows until the image has loaded, with the image's size and average colour. The image is the
    body. It is answered at once, without a job, within the limits of decodes."""
    if request.headers.get("content-type", "").startswith(FORM_TYPE):
        raise ProblemError(415, "the body must be the image itself, not a form", headers={"Accept": "image/*"})
    async with body_as_file(request, parts.settings.max_upload_bytes) as image:
        try:
            made = await while_client_waits(request, parts.work.preview(caller.client, image.file, most_bytes))
        except RefusedError as error:
            raise await refusal(error, image) from error
        except TaskError as error:
            raise ProblemError(422, f"the image cannot be encoded: {error}") from error
    response.headers.update(NEVER_STORED)
    return answers.PreviewView(**made)
