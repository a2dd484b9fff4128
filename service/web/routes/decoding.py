"""From bitstreams to picture files: the view that was asked for, drawn in a thread, and kept for the next to ask."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, TypeVarTuple

import anyio
from anyio import to_thread
from pydantic import BaseModel, Field

import sgmethod
from service.web.guards.problems import ProblemError
from service.web.routes.picture_files import MAX_SIDES, PictureFormat, encode_picture
from sgmethod.errors import ViewError
from sgmethod.view import MAX_SCALE, MIN_SCALE, View

Arguments = TypeVarTuple("Arguments")

RETRY_AFTER_S = "1"


class ViewQuery(BaseModel):
    """The query parameters that choose a view."""

    scale: Annotated[float | None, Field(ge=MIN_SCALE, le=MAX_SCALE, description="output pixels for a pixel")] = None
    width: Annotated[int | None, Field(ge=1, le=65_535, description="of the output in pixels; instead of scale")] = None
    region: Annotated[
        str | None,
        Field(
            pattern=r"^[0-9]{1,5},[0-9]{1,5},[0-9]{1,5},[0-9]{1,5}$",
            description="x,y,width,height: this part alone, in pixels of the picture",
            examples=["0,0,8,8"],
        ),
    ] = None


@dataclass(frozen=True)
class Drawing:
    """One picture file to make of a bitstream: the view, what kind of file, and its size in pixels."""

    view: View
    kind: PictureFormat
    width: int
    height: int

    @classmethod
    def of(cls, query: ViewQuery, kind: PictureFormat, size: tuple[int, int], max_pixels: int) -> Drawing:
        """What the query asks of a picture of that size (width, height).

        Raises ProblemError 422 if it makes no picture, or one beyond max_pixels or what the kind of file holds.
        """
        if query.scale is not None and query.width is not None:
            raise ProblemError(422, "give scale or width, not both")
        region = None
        if query.region is not None:
            x, y, w, h = (int(number) for number in query.region.split(","))
            region = None if (x, y, w, h) == (0, 0, *size) else (x, y, w, h)
        scale = 1.0 if query.scale is None else query.scale
        if query.width is not None:
            scale = query.width / max(region[2] if region else size[0], 1)
        try:
            view = View(scale, region)
            width, height = view.size(*size)
        except ViewError as error:
            raise ProblemError(422, str(error)) from error
        if width * height > max_pixels or max(width, height) > MAX_SIDES[kind]:
            limit = f"{max_pixels:,} pixels and {MAX_SIDES[kind]:,} a side"
            raise ProblemError(422, f"{width} x {height} pixels are more than the limit of {limit}")
        return cls(view, kind, width, height)

    def etag(self, sha256: str) -> str:
        """An entity tag: the same bitstream, part, size and kind of file give the same bytes."""
        part = "".join(f"{number}-" for number in self.view.region or ())
        return f'"{sha256[:32]}-{part}{self.width}x{self.height}.{self.kind}"'


def draw(bitstream: bytes, drawing: Drawing) -> bytes:
    """The picture file. Raises BitstreamError if the bytes are no bitstream."""
    return encode_picture(sgmethod.decode(bitstream, view=drawing.view), drawing.kind)


def draw_unknown(bitstream: bytes, query: ViewQuery, max_pixels: int, max_gaussians: int) -> bytes:
    """PNG of a bitstream of which nothing is known yet. Raises BitstreamError, ProblemError 422."""
    fields = sgmethod.info(bitstream, max_gaussians)  # a few kilobytes can hold millions of equal ones
    size = (fields.width, fields.height)
    return draw(bitstream, Drawing.of(query, "png", size, max_pixels))


class PictureDecoder:
    """Draws in threads: max_running pictures at a time, with max_waiting callers in line."""

    def __init__(self, max_running: int, max_waiting: int) -> None:
        self._limiter = anyio.CapacityLimiter(max_running)
        self._max_waiting = max_waiting

    async def run(self, work: Callable[[*Arguments], bytes], *arguments: *Arguments) -> bytes:
        """What work makes of the arguments. Raises ProblemError 503 if too many callers wait already."""
        if self._limiter.available_tokens <= 0 and self._limiter.statistics().tasks_waiting >= self._max_waiting:
            detail = "too many pictures are being decoded"
            raise ProblemError(503, detail, headers={"Retry-After": RETRY_AFTER_S})
        return await to_thread.run_sync(work, *arguments, limiter=self._limiter)


class PictureCache:
    """The picture files asked for last, by entity tag, as many as fit into max_bytes. For the event loop alone."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self.bytes = 0

    def get(self, etag: str) -> bytes | None:
        """The file, which is then the last to go."""
        if etag in self._files:
            self._files.move_to_end(etag)
        return self._files.get(etag)

    def put(self, etag: str, file: bytes) -> None:
        """Keep the file if it fits at all; others go to make room."""
        if etag in self._files or len(file) > self._max_bytes:
            return
        self._files[etag] = file
        self.bytes += len(file)
        while self.bytes > self._max_bytes:
            _, oldest = self._files.popitem(last=False)
            self.bytes -= len(oldest)
