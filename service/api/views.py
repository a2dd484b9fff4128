"""How a picture is asked for, and the pictures asked for last."""

from __future__ import annotations

import asyncio
import re
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from typing import Annotated, Any
from urllib.parse import quote

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from service.api.problems import ProblemError
from service.sandbox.drawing import Fit, Wish
from service.sandbox.picture_files import PictureFormat
from sgmethod.errors import ViewError
from sgmethod.view import MAX_SCALE, MIN_SCALE

REGION = r"^[0-9]{1,5},[0-9]{1,5},[0-9]{1,5},[0-9]{1,5}$"
# No slashes, control characters or ends of lines, and no dot first: systems hide such files.
FILE_NAME = r"^(?!\.)[^/\\\x00-\x1f\x7f-\x9f\u2028\u2029]{1,200}$"
Side = Annotated[int | None, Field(ge=1, le=65_535)]


def _refusing(pattern: str, detail: str) -> AfterValidator:
    """Refuses a text that does not match, as Field(pattern=...) does, but with a sentence instead of the pattern."""

    def checked(text: str | None) -> str | None:
        if text is not None and re.fullmatch(pattern, text) is None:
            raise ValueError(detail)
        return text

    return AfterValidator(checked)


class ViewQuery(BaseModel):
    """The query parameters that choose a view, the quality of its file, and a name to save it under."""

    model_config = ConfigDict(extra="forbid")

    scale: Annotated[float | None, Field(ge=MIN_SCALE, le=MAX_SCALE, description="output pixels per pixel")] = None
    width: Annotated[Side, Field(description="output size in pixels, instead of scale")] = None
    height: Annotated[Side, Field(description="output size in pixels, instead of scale")] = None
    fit: Annotated[
        Fit,
        Field(description="with width and height: fit inside them, cover them, or crop to them from the centre"),
    ] = "contain"
    region: Annotated[
        str | None,
        _refusing(REGION, "give four whole numbers of pixels: x,y,width,height"),
        Field(
            json_schema_extra={"pattern": REGION},
            description="x,y,width,height: decode only this part, in pixels of the picture",
            examples=["0,0,8,8"],
        ),
    ] = None
    prefix: Annotated[float, Field(gt=0, le=1, description="fraction of the file to decode; less is coarser")] = 1.0
    texture: Annotated[bool, Field(description="draw the file's synthesised texture")] = True
    quality: Annotated[int | None, Field(ge=1, le=100, description="quality of a jpg, webp or avif file")] = None
    download: Annotated[
        str | None,
        _refusing(FILE_NAME, "a file name has 1 to 200 characters, no slash or control character, and no dot first"),
        Field(json_schema_extra={"pattern": FILE_NAME}, description="file name to save the picture under"),
    ] = None

    def wish(self, kind: PictureFormat) -> Wish:
        """What is asked for, as a file of that kind. Raises ProblemError 422."""
        region = None
        if self.region is not None:
            x, y, w, h = (int(number) for number in self.region.split(","))
            region = (x, y, w, h)
        try:
            return Wish(
                kind, self.scale, self.width, self.height, self.fit, region, self.prefix, self.texture, self.quality
            )
        except ViewError as error:
            raise ProblemError(422, str(error)) from error

    def disposition(self) -> dict[str, str]:
        """The header that makes a browser save the file; none without a name."""
        if self.download is None:
            return {}
        plain = re.sub(r'[^ -~]|["\\%]', "_", self.download)
        # Browsers take the name in full; the other is for clients that do not know it (RFC 6266, appendix D).
        full = "" if plain == self.download else f"; filename*=UTF-8''{quote(self.download, safe='')}"
        return {"Content-Disposition": f'attachment; filename="{plain}"{full}'}


class _Making:
    """A file that is being made. waiting: how many requests it is for."""

    def __init__(self, making: Coroutine[Any, Any, bytes]) -> None:
        self.task = asyncio.create_task(making)
        self.waiting = 0


class PictureCache:
    """The picture files asked for last, by entity tag, as many as fit into max_bytes. For the event loop alone."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self._making: dict[str, _Making] = {}
        self.bytes = 0

    def __contains__(self, etag: str) -> bool:
        return etag in self._files

    async def get_or_make(self, etag: str, make: Callable[[], Coroutine[Any, Any, bytes]]) -> bytes:
        """The file, from memory or from `make`, which runs once for all who ask for it meanwhile, as long as one of
        them waits.
        """
        if etag in self._files:
            self._files.move_to_end(etag)
            return self._files[etag]
        if etag not in self._making:
            self._making[etag] = _Making(make())
        making = self._making[etag]
        making.waiting += 1
        try:
            file = await asyncio.shield(making.task)
        finally:
            making.waiting -= 1
            if making.task.done() or not making.waiting:
                making.task.cancel()
                if self._making.get(etag) is making:
                    del self._making[etag]
        self._put(etag, file)
        return file

    def _put(self, etag: str, file: bytes) -> None:
        """Keep the file if it fits at all; others go to make room."""
        if etag in self._files or len(file) > self._max_bytes:
            return
        self._files[etag] = file
        self.bytes += len(file)
        while self.bytes > self._max_bytes:
            _, oldest = self._files.popitem(last=False)
            self.bytes -= len(oldest)
