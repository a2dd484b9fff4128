"""What helpers do for requests: headers of images, and pictures and previews, each kind with turns of its own."""

from __future__ import annotations

from typing import Any, BinaryIO

from service.api.turns import Turns
from service.jobs.job import SourceImage
from service.settings import Settings
from service.web.helpers.drawing import Wish
from service.web.helpers.helper import Errand
from service.web.helpers.picture_files import Rival
from service.web.helpers.pool import Helpers

# The header of a photograph takes milliseconds and little memory. What takes more was made to.
HEADERS_AT_ONCE = 3
HEADER_CPU_S = 1.0
HEADER_MEMORY_BYTES = 256 << 20  # beside the file itself


class Work:
    """Both kinds of errand. client: whose turn an errand takes."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._helpers = Helpers()
        self._headers = Turns(HEADERS_AT_ONCE, settings.max_streams)
        self._drawings = Turns(settings.max_decodes, settings.max_waiting_decodes)

    async def read_header(self, client: str, file: BinaryIO, size_bytes: int) -> SourceImage:
        """What an image's header says. Raises HelperError, ProblemError 429 or 503, OSError."""
        limits = self._settings
        memory_bytes = HEADER_MEMORY_BYTES + size_bytes
        async with self._headers.turn(client):
            errand = Errand(memory_bytes, HEADER_CPU_S, limits.max_pixels)
            header, _ = await self._helpers.ask(errand, file)
        return SourceImage(header["format"], header["width"], header["height"], size_bytes)

    async def draw(self, client: str, file: BinaryIO, wish: Wish, max_gaussians: int | None = None) -> bytes:
        """The picture file of a bitstream. Raises HelperError, ProblemError 429 or 503, OSError."""
        limits = self._settings
        errand = Errand(
            limits.decode_memory_bytes,
            limits.decode_time_s,
            limits.max_pixels,
            max_gaussians=max_gaussians,
            wish=wish,
        )
        return await self._picture(client, file, errand)

    async def make_rival(self, client: str, file: BinaryIO, rival: Rival) -> bytes:
        """The rival that is made of an image. Raises HelperError, ProblemError 429 or 503, OSError."""
        limits = self._settings
        errand = Errand(limits.decode_memory_bytes, limits.decode_time_s, limits.max_pixels, rival=rival)
        return await self._picture(client, file, errand)

    async def preview(self, client: str, file: BinaryIO, most_bytes: int) -> dict[str, Any]:
        """The preview of an image, as Preview.to_dict(). Raises HelperError, ProblemError 429 or 503, OSError."""
        limits = self._settings
        errand = Errand(limits.decode_memory_bytes, limits.decode_time_s, limits.max_pixels, preview_bytes=most_bytes)
        made, _ = await self._ask(client, file, errand)
        return made

    async def _picture(self, client: str, file: BinaryIO, errand: Errand) -> bytes:
        _, picture = await self._ask(client, file, errand)
        return picture

    async def _ask(self, client: str, file: BinaryIO, errand: Errand) -> tuple[dict[str, Any], bytes]:
        async with self._drawings.turn(client):
            return await self._helpers.ask(errand, file)

    def close(self) -> None:
        """End the helpers."""
        self._helpers.close()
