"""What passes between the sandbox and its clients.

A client sends a task as one message of JSON, with two descriptors: a socket for the answer, and the file to read.
It closes the socket to have the task ended, and writes a byte into it to have an encode end early, with what it has.

The answer is frames: a letter, the payload's length (32 bits, big-endian) and the payload.

    B  the task has begun            from the sandbox itself, first
    T  a trace point (JSON)          any number of times
    P  a bitstream of what there is  now and then
    S  figures (JSON)                and with a file or without one, that is the result
    F  a file, the end of the result
    R  a refusal (JSON)              in place of a result
    C  the words of a crash (JSON)   in place of a result
    E  how its process ended (JSON)  from the sandbox itself, last

Tasks may have been taken over by what they read. Each says how many frames and bytes may come of it, and on how many
threads. A frame too many, one that is too long or says something else than it may, and a result that is not what was
asked for are the end of the task for its client, which learns of it as FrameError.
"""

from __future__ import annotations

import math
import signal
import struct
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from service.jobs.job import EncodeRequest
from service.sandbox.pictures import PictureFormat, PictureOptions, Rival
from sgmethod.errors import BitstreamError, ImageError
from sgmethod.io.formats import name_of
from sgmethod.io.pictures import SUFFIXES

END_EARLY = signal.SIGUSR1  # how the sandbox tells an encode
FRAME_HEADER = struct.Struct(">cI")
TASK_BYTES = 1 << 16  # the longest task
FILE_BYTES, FILE_BYTES_PER_PIXEL = 1 << 20, 8  # no bitstream is longer than both together
PICTURE_BYTES_PER_PIXEL = 4  # PNG of noise, one pixel wide; JPEG of thin noise takes more, which the first MB covers
FORMAT_BYTES = 256  # of a file, which tell its format
SENTENCE_LENGTH = 1000
# Of an encode: 10 points of the trace and a preview in each second, and its time limit is not the end of it.
FRAMES, FRAMES_PER_S = 1000, 30
# A picture takes a few milliseconds on one thread. A second one shortens the worst of them, when an encode has the
# other core (p99 of GET /decode 53 -> 32 ms on two cores); more would only get in the encoders' way.
PICTURE_THREADS = 2
LIBRARIES = 4  # that may have a pool of threads each: the kernels, OpenCV, and PyTorch two

Count = Annotated[int, Field(ge=0, le=2**53)]  # which every database and JSON can hold


class FrameError(ValueError):
    """A task said something that it may not say: one sentence."""


class Model(BaseModel):
    """Takes nothing that it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Frame(Model):
    """One frame of JSON. letter: by which it is known; longest: its payload in bytes."""

    letter: ClassVar[bytes]
    longest: ClassVar[int] = 1 << 12


class Figures(Frame):
    """The figures of a result."""

    letter = b"S"
    longest = 1 << 16


class Task(Model):
    """What to do with a file, and what it may take.

    memory_bytes: more than the codec itself takes; cpu_s: seconds of a core; max_pixels: of what is read or drawn;
    threads: that each library computes on.
    """

    memory_bytes: int
    cpu_s: float
    max_pixels: int
    threads: int = PICTURE_THREADS

    answer: ClassVar[type[Figures] | None] = None  # None for a file without figures
    gives_file: ClassVar[bool] = True
    bytes_per_pixel: ClassVar[int] = PICTURE_BYTES_PER_PIXEL

    @property
    def file_bytes(self) -> int:
        """The longest file it may send."""
        return FILE_BYTES + self.bytes_per_pixel * self.max_pixels if self.gives_file else 0

    @property
    def most_frames(self) -> int:
        """How many frames it may send: that it has begun, figures, a file, how it ended."""
        return 4

    @property
    def most_threads(self) -> int:
        """How many threads it may have."""
        return LIBRARIES * self.threads

    def check(self, figures: Any, file: bytes) -> None:
        """Raises FrameError unless this can be what was asked for."""
        if figures is not None and figures.width * figures.height > self.max_pixels:
            raise FrameError("an image of more pixels than are allowed")


class HeaderFigures(Figures):
    """The answer of ReadHeader: what an image's header says."""

    format: str = Field(max_length=20)
    width: int = Field(ge=1)
    height: int = Field(ge=1)


class ReadHeader(Task):
    """Read an image's header."""

    kind: Literal["header"] = "header"
    answer = HeaderFigures
    gives_file = False


class Draw(Task):
    """Make a picture file of a bitstream. max_gaussians: of the bitstream."""

    kind: Literal["draw"] = "draw"
    options: PictureOptions
    file_kind: PictureFormat = "png"
    max_gaussians: int | None = None

    def check(self, figures: Any, file: bytes) -> None:
        _check_picture(file, self.file_kind)


class MakeRival(Task):
    """Make a picture file of an image, as large as its bitstream."""

    kind: Literal["rival"] = "rival"
    rival: Rival

    def check(self, figures: Any, file: bytes) -> None:
        _check_picture(file, self.rival.kind)


class PreviewFigures(Figures):
    """The answer of MakePreview, as Preview.to_dict() has it."""

    text: str = Field(
        pattern="^[A-Za-z0-9_-]+$", description="base64url of an .sg file, for the preview attribute of an <sg-img>"
    )
    width: Count = Field(description="pixels of the image as displayed")
    height: Count = Field(description="pixels of the image as displayed")
    color: str = Field(pattern=r"^#[0-9a-f]{6}$", description="average colour, #rrggbb")
    dark: bool = Field(description="whether white text reads better on that colour than black")


class MakePreview(Task):
    """Make a preview of an image, of at most this many bytes."""

    kind: Literal["preview"] = "preview"
    most_bytes: int
    answer = PreviewFigures
    gives_file = False

    def check(self, figures: Any, file: bytes) -> None:
        super().check(figures, file)
        if len(figures.text) * 3 // 4 > self.most_bytes:
            raise FrameError("a preview of more bytes than are allowed")


Sentence = Annotated[str, Field(max_length=SENTENCE_LENGTH)]
Figure = float | None


class EncodeFigures(Figures):
    """The figures of an encode: Stats.to_dict() with advice, and what of the image was dropped."""

    bytes: Count
    bpp: float
    psnr: Figure
    ms_ssim: Figure
    ssimulacra2: Figure
    gaussians: Count
    steps: Count
    seconds: float
    width: Count
    height: Count
    profile: str = Field(max_length=20)
    tune: str = Field(max_length=20)
    effort: Count
    source_bytes: Count
    psnr_missed_db: Figure
    quality_missed: Figure
    warnings: list[Sentence] = Field(max_length=20)
    advice: Sentence | None
    better: Literal["avif", "webp"] | None
    notes: list[Sentence] = Field(default=[], max_length=20)


class Encode(Task):
    """Encode an image. job_id: for operators, who see it in the process list; max_pixels: those of the image."""

    kind: Literal["encode"] = "encode"
    job_id: str
    request: EncodeRequest
    threads: int
    answer = EncodeFigures
    bytes_per_pixel = FILE_BYTES_PER_PIXEL

    @property
    def most_frames(self) -> int:
        return FRAMES + int(FRAMES_PER_S * self.request.time_limit_s)

    def check(self, figures: Any, file: bytes) -> None:
        super().check(figures, file)
        if figures.bytes != len(file):
            raise FrameError("a file of another size than its figures say")
        from sgmethod.bitstream.container import version_of  # needs the kernels, whose absence is told in one line

        try:
            version_of(file)
        except BitstreamError as error:
            raise FrameError(str(error)) from None


AnyTask = Annotated[ReadHeader | Draw | MakeRival | MakePreview | Encode, Field(discriminator="kind")]


class Begun(Frame):
    """The task has a process."""

    letter = b"B"


class TracePoint(Frame):
    """How far the fit is, as sgmethod's TracePoint has it."""

    letter = b"T"
    seconds: float
    step: Count
    steps: Count
    psnr: Figure
    bytes: Count
    gaussians: Count
    phase: str = Field(max_length=20)


class Preview(Model):
    """A bitstream of what there is so far."""

    bitstream: bytes


Refusal = Literal["ImageError", "BitstreamError", "ViewError", "BudgetError", "SgError", "MemoryError"]


class Refused(Frame):
    """The codec refused the file, or what is asked of it. error: the name of the class, of sgmethod.errors."""

    letter = b"R"
    error: Refusal
    detail: Sentence


class Crashed(Frame):
    """The task failed in a way that nobody foresaw; one sentence."""

    letter = b"C"
    detail: Sentence


class Ended(Frame):
    """The task's process has ended; the status is Popen's."""

    letter = b"E"
    status: int = Field(ge=-signal.NSIG, le=255)


class Result(Model):
    """The task is done."""

    figures: Any = None
    file: bytes = b""


Message = Begun | TracePoint | Preview | Refused | Crashed | Ended | Result

BY_LETTER: dict[bytes, type[Frame]] = {frame.letter: frame for frame in (Begun, TracePoint, Refused, Crashed, Ended)}
REFUSALS = get_args(Refusal)
PREVIEW, FILE = b"P", b"F"


def packed(letter: bytes, payload: bytes) -> bytes:
    """One frame."""
    return FRAME_HEADER.pack(letter, len(payload)) + payload


def packed_json(frame: Frame) -> bytes:
    """One frame of JSON."""
    return packed(frame.letter, frame.model_dump_json(exclude_unset=True).encode())


def finite(figures: dict[str, Any]) -> dict[str, Any]:
    """Figures as JSON can say them: a PSNR of infinity (a picture without error) becomes None."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in figures.items()}


class FrameReader:
    """From the bytes of an answer to messages."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._data = bytearray()
        self._figures: Figures | None = None
        self._frames = 0

    def take(self, data: bytes) -> list[Message]:
        """The messages that are whole with these bytes. Raises FrameError."""
        self._data += data
        messages: list[Message] = []
        while len(self._data) >= FRAME_HEADER.size:
            letter, length = FRAME_HEADER.unpack_from(self._data)
            if length > (most := self._longest(letter)):
                raise FrameError(f"a frame {letter!r} of {length} bytes, where {most} are allowed")
            end = FRAME_HEADER.size + length
            if len(self._data) < end:
                break
            with memoryview(self._data) as view:
                payload = bytes(view[FRAME_HEADER.size : end])
            del self._data[:end]
            self._frames += 1
            if self._frames > self._task.most_frames:
                raise FrameError("too many frames")
            try:
                messages += self._said(letter, payload)
            except ValidationError as error:  # which may hold what the task said
                fault = error.errors()[0]
                raise FrameError(f"a frame {letter!r} in which {fault['loc']} is wrong ({fault['type']})") from None
        return messages

    def _longest(self, letter: bytes) -> int:
        if letter in BY_LETTER and (letter != TracePoint.letter or isinstance(self._task, Encode)):
            return BY_LETTER[letter].longest
        if letter == Figures.letter and self._task.answer:
            return Figures.longest
        if letter == FILE or (letter == PREVIEW and isinstance(self._task, Encode)):
            return self._task.file_bytes
        raise FrameError(f"a frame of unknown kind {letter!r}")

    def _said(self, letter: bytes, payload: bytes) -> list[Message]:
        if letter == PREVIEW:
            return [Preview(bitstream=payload)]
        if letter == FILE:
            if self._task.answer and self._figures is None:
                raise FrameError("a file without its figures")
            return [self._result(payload)]
        if letter == Figures.letter:
            assert self._task.answer
            self._figures = self._task.answer.model_validate_json(payload)
            return [] if self._task.gives_file else [self._result(b"")]
        return [BY_LETTER[letter].model_validate_json(payload)]  # type: ignore[list-item]

    def _result(self, file: bytes) -> Result:
        self._task.check(self._figures, file)
        return Result(figures=self._figures, file=file)


def _check_picture(file: bytes, kind: PictureFormat) -> None:
    wanted = SUFFIXES[f".{kind}"]
    try:
        found = name_of(file[:FORMAT_BYTES])
    except ImageError:
        found = "something else"
    if found != wanted:
        raise FrameError(f"{wanted} was asked for, and this is {found}")
