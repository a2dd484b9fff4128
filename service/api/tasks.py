"""What the sandbox does for requests: headers of images, and pictures and previews, each kind with turns of its own."""

from __future__ import annotations

from typing import Any, BinaryIO

from service.api.metrics import Metrics
from service.api.problems import ProblemError
from service.api.turns import RETRY_AFTER, Turns
from service.jobs.job import SourceImage
from service.sandbox.client import Sandbox, SandboxGoneError
from service.sandbox.frames import Draw, HeaderFigures, MakePreview, MakeRival, PreviewFigures, ReadHeader, Result, Task
from service.sandbox.pictures import PictureFormat, PictureOptions, Rival
from service.settings import Settings

# The header of a photograph takes milliseconds and little memory. What takes more was made to.
HEADERS_AT_ONCE = 3
HEADER_CPU_S = 1.0
HEADER_MEMORY_BYTES = 256 << 20  # beside the file itself


class ClientTasks:
    """Tasks of the sandbox. client: whose turn a task takes.

    All raise TaskError, ProblemError 429 or 503, and OSError.
    """

    def __init__(self, settings: Settings, sandbox: Sandbox, metrics: Metrics) -> None:
        self._sandbox = sandbox
        self._metrics = metrics
        self._headers = Turns(HEADERS_AT_ONCE, settings.max_streams)
        self._drawings = Turns(settings.max_decodes, settings.max_waiting_decodes)
        self._limits: dict[str, Any] = {  # of what decodes an image or a bitstream
            "memory_bytes": settings.decode_memory_bytes,
            "cpu_s": settings.decode_time_s,
            "max_pixels": settings.max_pixels,
        }

    async def read_header(self, client: str, file: BinaryIO, size_bytes: int) -> SourceImage:
        """What an image's header says."""
        limits = {**self._limits, "memory_bytes": HEADER_MEMORY_BYTES + size_bytes, "cpu_s": HEADER_CPU_S}
        task = ReadHeader(**limits)
        header: HeaderFigures = (await self._ask(self._headers, client, file, task)).figures
        return SourceImage(header.format, header.width, header.height, size_bytes)

    async def draw(
        self,
        client: str,
        file: BinaryIO,
        options: PictureOptions,
        kind: PictureFormat,
        max_gaussians: int | None = None,
    ) -> bytes:
        """The picture file of a bitstream."""
        task = Draw(**self._limits, options=options, file_kind=kind, max_gaussians=max_gaussians)
        with self._metrics.decode_seconds.time():
            return (await self._ask(self._drawings, client, file, task)).file

    async def make_rival(self, client: str, file: BinaryIO, rival: Rival) -> bytes:
        """The rival that is made of an image."""
        return (await self._ask(self._drawings, client, file, MakeRival(**self._limits, rival=rival))).file

    async def preview(self, client: str, file: BinaryIO, most_bytes: int) -> PreviewFigures:
        """The preview of an image."""
        task = MakePreview(**self._limits, most_bytes=most_bytes)
        made: PreviewFigures = (await self._ask(self._drawings, client, file, task)).figures
        return made

    async def _ask(self, turns: Turns, client: str, file: BinaryIO, task: Task) -> Result:
        async with turns.turn(client):
            try:
                return await self._sandbox.ask(task, file)
            except SandboxGoneError as error:
                detail = "pictures cannot be read right now: try again"
                raise ProblemError(503, detail, reason="sandbox", headers=RETRY_AFTER) from error
