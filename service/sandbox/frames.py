"""What passes between the sandbox and its clients.

A client sends a task as one message of JSON, with two descriptors: a socket for the answer, and the file to read. It
closes the socket to end the task.

The answer is a sequence of frames. A frame is the lengths of its two parts (4 bytes each, big-endian), a message in
JSON, and a file, which most messages do not have. Begun comes first and Ended last. Between them, an encode sends
TracePoint; every task sends Result, Refused or Crashed once.

A malicious file may control the process that parses it, so every frame is checked. Each task names the messages that
it may send, the length of its files and the number of its frames. Anything else raises FrameError in the client, which
closes the socket.
"""

from __future__ import annotations

import math
import signal
import struct
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from service.jobs.job import EncodeRequest
from service.pictures import ComparisonFormat, PictureFormat, PictureOptions
from sgmethod.errors import BitstreamError, ImageError
from sgmethod.io.formats import name_of
from sgmethod.io.pictures import SUFFIXES

FRAME_HEADER = struct.Struct(">II")
MAX_TASK_BYTES = MAX_MESSAGE_BYTES = 1 << 16
FILE_BYTES, FILE_BYTES_PER_PIXEL = 1 << 20, 8  # no bitstream is longer than both together
PICTURE_BYTES_PER_PIXEL = 4  # PNG of noise, one pixel wide; JPEG of thin noise takes more, which the first MB covers
FORMAT_BYTES = 256  # the start of a file, which tells its format
MAX_SENTENCE_LENGTH = 1000
MAX_FRAMES = 3  # Begun, a result or why there is none, Ended
# An encode sends 10 trace points a second, and may run for longer than its time limit.
MAX_ENCODE_FRAMES, MAX_ENCODE_FRAMES_PER_S = 1000, 30
# A picture takes a few milliseconds on one thread. A second one shortens the worst of them, when an encode has the
# other core (p99 of GET /decode 53 -> 32 ms on two cores); more would only get in the encoders' way.
PICTURE_THREADS = 2
LIBRARIES = 4  # that may have a pool of threads each: the kernels, OpenCV, and PyTorch two

Count = Annotated[int, Field(ge=0, le=2**53)]  # which every database and JSON can hold
Sentence = Annotated[str, Field(max_length=MAX_SENTENCE_LENGTH)]
Figure = float | None
Refusal = Literal["ImageError", "BitstreamError", "ViewError", "BudgetError", "SgError", "MemoryError"]
REFUSALS = get_args(Refusal)


class FrameError(ValueError):
    """A task sent something that it may not send; one sentence."""


class Model(BaseModel):
    """A message or a task, which has no unknown fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Begun(Model):
    """The task has a process."""

    kind: Literal["begun"] = "begun"


class TracePoint(Model):
    """Progress of a fit: sgmethod.TracePoint.to_dict()."""

    kind: Literal["trace"] = "trace"
    seconds: float
    step: Count
    steps: Count
    psnr: Figure
    bytes: Count
    gaussians: Count
    phase: str = Field(max_length=20)
    share: float = Field(ge=0, le=1)


class Refused(Model):
    """The codec refused the file or the options. error: the name of a class in sgmethod.errors, or MemoryError."""

    kind: Literal["refused"] = "refused"
    error: Refusal
    detail: Sentence


class Crashed(Model):
    """The task raised an unexpected exception; one sentence."""

    kind: Literal["crashed"] = "crashed"
    detail: Sentence


class Ended(Model):
    """The task's process has ended. status: as subprocess.Popen.returncode."""

    kind: Literal["ended"] = "ended"
    status: int = Field(ge=-signal.NSIG, le=255)


Figures = TypeVar("Figures")


class Result(Model, Generic[Figures]):
    """The task is done."""

    kind: Literal["result"] = "result"
    figures: Figures
    file: Annotated[bytes, Field(exclude=True)] = b""  # follows the JSON


Common = Begun | Refused | Crashed | Ended  # to all tasks
Message = Common | TracePoint | Result[Any]
KIND = Field(discriminator="kind")


class HeaderFigures(Model):
    """The header of an image."""

    format: str = Field(max_length=20)
    width: int = Field(ge=1)
    height: int = Field(ge=1)


class PreviewFigures(Model):
    """A preview: sgmethod.Preview.to_dict()."""

    text: str = Field(
        pattern="^[A-Za-z0-9_-]+$", description="base64url of an .sg file, for the preview attribute of an <sg-img>"
    )
    width: Count = Field(description="pixels of the image as displayed")
    height: Count = Field(description="pixels of the image as displayed")
    color: str = Field(pattern=r"^#[0-9a-f]{6}$", description="average colour, #rrggbb")
    dark: bool = Field(description="whether white text reads better on that colour than black")


class EncodeFigures(Model):
    """The figures of an encode: sgmethod.Stats.to_dict(), advice, and notes on what was dropped from the image.

    Only those that the service uses have names here.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Count | Figure | Sentence | list[Sentence]]

    bytes: Count
    width: Count
    height: Count
    notes: list[Sentence] = Field(max_length=20)


class Task(Model):
    """What to do with a file, and the limits.

    memory_bytes: beyond what the codec itself takes; cpu_s: seconds of one core; max_pixels: of the image that is read
    or drawn; threads: of each library.
    """

    memory_bytes: int
    cpu_s: float
    max_pixels: int
    threads: int = PICTURE_THREADS

    messages: ClassVar[TypeAdapter[Any]] = TypeAdapter(Annotated[Common | Result[None], KIND])
    bytes_per_pixel: ClassVar[int | None] = PICTURE_BYTES_PER_PIXEL  # None if the result has no file

    def max_bytes_after(self, message: Message) -> int:
        """Bytes of the longest file that it may send with this message."""
        if not isinstance(message, Result) or self.bytes_per_pixel is None:
            return 0
        return FILE_BYTES + self.bytes_per_pixel * self.max_pixels

    @property
    def max_frames(self) -> int:
        return MAX_FRAMES

    @property
    def max_threads(self) -> int:
        return LIBRARIES * self.threads

    def check(self, result: Result[Any]) -> None:
        """Raise FrameError if this cannot be the result of the task."""
        figures = result.figures
        if figures is not None and figures.width * figures.height > self.max_pixels:
            raise FrameError("an image of more pixels than are allowed")


class ReadHeader(Task):
    """Read an image's header."""

    kind: Literal["header"] = "header"
    messages = TypeAdapter(Annotated[Common | Result[HeaderFigures], KIND])
    bytes_per_pixel = None


class Draw(Task):
    """Draw a bitstream as a picture file. max_gaussians: of the bitstream."""

    kind: Literal["draw"] = "draw"
    options: PictureOptions
    file_kind: PictureFormat = "png"
    max_gaussians: int | None = None

    def check(self, result: Result[Any]) -> None:
        _check_picture(result.file, self.file_kind)


class Compare(Task):
    """Encode an image by another codec. size: bytes that the file is to have."""

    kind: Literal["compare"] = "compare"
    file_kind: ComparisonFormat
    size: int

    def check(self, result: Result[Any]) -> None:
        _check_picture(result.file, self.file_kind)


class MakePreview(Task):
    """Make a preview of an image."""

    kind: Literal["preview"] = "preview"
    max_bytes: int
    messages = TypeAdapter(Annotated[Common | Result[PreviewFigures], KIND])
    bytes_per_pixel = None

    def check(self, result: Result[Any]) -> None:
        super().check(result)
        if len(result.figures.text) * 3 // 4 > self.max_bytes:
            raise FrameError("a preview of more bytes than are allowed")


class Encode(Task):
    """Encode an image of max_pixels pixels. job_id: for operators, who see it in the process list."""

    kind: Literal["encode"] = "encode"
    job_id: str
    request: EncodeRequest
    threads: int
    messages = TypeAdapter(Annotated[Common | TracePoint | Result[EncodeFigures], KIND])
    bytes_per_pixel = FILE_BYTES_PER_PIXEL

    @property
    def max_frames(self) -> int:
        return MAX_ENCODE_FRAMES + int(MAX_ENCODE_FRAMES_PER_S * self.request.time_limit_s)

    def check(self, result: Result[Any]) -> None:
        super().check(result)
        if result.figures.bytes != len(result.file):
            raise FrameError("a file of another size than its figures say")
        from sgmethod.bitstream.container import version_of  # needs the kernels, whose absence is reported at start

        try:
            version_of(result.file)
        except BitstreamError as error:
            raise FrameError(str(error)) from None


AnyTask = Annotated[ReadHeader | Draw | Compare | MakePreview | Encode, KIND]


def packed(message: Message) -> bytes:
    """Return the frame of a message."""
    text, file = message.model_dump_json().encode(), getattr(message, "file", b"")
    return FRAME_HEADER.pack(len(text), len(file)) + text + file


def finite(figures: dict[str, Any]) -> dict[str, Any]:
    """Replace figures that JSON lacks, such as the infinite PSNR of a picture without error, by None."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in figures.items()}


class FrameReader:
    """Reads the messages of a task from the bytes of its answer."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._data = bytearray()
        self._message: Message | None = None  # whose file is yet to come
        self._frames = 0

    def take(self, data: bytes) -> list[Message]:
        """Return the messages that these bytes complete. Raises FrameError."""
        self._data += data
        messages: list[Message] = []
        while (message := self._next()) is not None:
            messages.append(message)
        return messages

    def _next(self) -> Message | None:
        """Return the next message if it is complete. Its text comes first, and says how long its file may be."""
        if len(self._data) < FRAME_HEADER.size:
            return None
        text_bytes, file_bytes = FRAME_HEADER.unpack_from(self._data)
        if text_bytes > MAX_MESSAGE_BYTES:
            raise FrameError(f"a message of {text_bytes} bytes, which is too long")
        file_at = FRAME_HEADER.size + text_bytes
        if len(self._data) < file_at:
            return None
        if self._message is None:
            self._message = self._parsed(bytes(self._data[FRAME_HEADER.size : file_at]))
        message = self._message
        if file_bytes > self._task.max_bytes_after(message):
            raise FrameError(f"a file of {file_bytes} bytes after the message {message.kind}, which is too long")
        if len(self._data) < file_at + file_bytes:
            return None
        if isinstance(message, Result):
            with memoryview(self._data) as view:
                message = message.model_copy(update={"file": bytes(view[file_at : file_at + file_bytes])})
            self._task.check(message)
        del self._data[: file_at + file_bytes]
        self._message = None
        return message

    def _parsed(self, text: bytes) -> Message:
        self._frames += 1
        if self._frames > self._task.max_frames:
            raise FrameError("too many frames")
        try:
            message: Message = self._task.messages.validate_json(text)
        except ValidationError as error:  # whose text may hold what the task sent
            fault = error.errors()[0]
            raise FrameError(f"a message in which {fault['loc']} is wrong ({fault['type']})") from None
        return message


def _check_picture(file: bytes, kind: PictureFormat) -> None:
    wanted = SUFFIXES[f".{kind}"]
    try:
        found = name_of(file[:FORMAT_BYTES])
    except ImageError:
        found = "something else"
    if found != wanted:
        raise FrameError(f"{wanted} was asked for, and this is {found}")
