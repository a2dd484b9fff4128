"""A helper process: `service.web.helpers.helper DESCRIPTOR`, started confined by the web process.

Over the socket of that descriptor comes an errand, one line of JSON with an open file beside it (see Errand). The
answer is the lengths of the two parts that follow, some JSON and the bytes of a picture file. Then comes the next
errand. One that takes more time than it may is the end of the process, which its parent sees.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import signal
import socket
import struct
import sys
import warnings
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import sgmethod
from service.web.helpers.drawing import Drawing, Wish
from service.web.helpers.picture_files import Rival
from sgmethod.errors import ImageError, ImageWarning, SgError
from sgmethod.io.compositing import WHITE, composited
from sgmethod.io.image import ImageLimits, read_header, read_image_8_bit

READY = b"!"  # said once, at the start
ANSWER_HEADER = struct.Struct(">IQ")
ERRAND_BYTES = 1 << 16
# A picture takes a few milliseconds on one thread. A second one shortens the worst of them, when an encode has the
# other core (p99 of GET /decode 53 -> 32 ms on two cores); more would only get in the encoders' way.
THREADS = 2
# Behind the web process, which answers everybody else meanwhile, and before encoder processes, for which nobody waits.
NICENESS = 5
# glibc's malloc.h. Memory of a picture that was made goes back to the system only beyond these.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
KEPT_BYTES, LARGE_BYTES = 16 << 20, 4 << 20


@dataclass(frozen=True)
class Errand:
    """What to do with a file, and what it may take.

    memory_bytes, cpu_s: more than the process has already, and seconds of one core; max_pixels, max_gaussians: of what
    is read or drawn; wish: the picture file to make of a bitstream; rival: the one to make of an image;
    preview_bytes: of the preview to make of an image. Without any of them, an image's header is read.
    """

    memory_bytes: int
    cpu_s: float
    max_pixels: int
    max_gaussians: int | None = None
    wish: Wish | None = None
    rival: Rival | None = None
    preview_bytes: int | None = None

    def to_json(self) -> bytes:
        """One line."""
        return json.dumps(asdict(self)).encode() + b"\n"

    @classmethod
    def from_json(cls, line: bytes) -> Errand:
        """The inverse of to_json."""
        given = json.loads(line)
        if given["wish"] is not None:
            region = given["wish"]["region"]
            given["wish"] = Wish(**{**given["wish"], "region": region and tuple(region)})
        if given["rival"] is not None:
            given["rival"] = Rival(**given["rival"])
        return cls(**{field.name: given[field.name] for field in fields(cls)})


def perform(errand: Errand, file: bytes) -> tuple[dict[str, Any], bytes]:
    """The answer: figures, and the bytes of a picture file. Raises SgError, MemoryError."""
    limits = ImageLimits(errand.max_pixels)
    if errand.preview_bytes is not None:
        return _preview(file, errand.preview_bytes, limits), b""
    if errand.rival is not None:
        return {}, _rival(errand.rival, file, limits)
    if errand.wish is None:
        header = read_header(file, limits)
        if not header.still:
            raise ImageError(f"this {header.format} contains more than one picture; send a single still picture")
        return {"format": header.format, "width": header.width, "height": header.height}, b""
    info = sgmethod.info(file, errand.max_gaussians)  # a few kilobytes can hold millions of equal ones
    drawing = Drawing.of(errand.wish, (info.width, info.height), errand.max_pixels)
    return {}, drawing.draw(file)


def _rival(rival: Rival, image: bytes, limits: ImageLimits) -> bytes:
    from sgmethod.advice import better_file, is_drawn

    pixels = read_image_8_bit(image, limits, keep_alpha=True)
    if rival.kind == "webp" and (lossless := better_file(pixels, rival.size, 0.0, ("webp",))):
        return lossless.data
    opaque = pixels if pixels.shape[2] == 3 else composited(pixels, WHITE)
    return rival.made_of(opaque, drawn=is_drawn(pixels))


def _preview(image: bytes, most_bytes: int, limits: ImageLimits) -> dict[str, Any]:
    from sgmethod.previews.preview import preview  # and the encoder, which other errands do without

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImageWarning)
        return preview(image, most_bytes, limits=limits).to_dict()


def _answer(errand: Errand, descriptor: int) -> tuple[dict[str, Any], bytes]:
    _limit_memory(errand.memory_bytes)
    signal.setitimer(signal.ITIMER_PROF, errand.cpu_s)  # whose signal ends the process
    try:
        with os.fdopen(descriptor, "rb") as file:
            file.seek(0)
            return perform(errand, file.read())
    except SgError as error:
        return {"refused": type(error).__name__, "detail": str(error)}, b""
    except MemoryError:
        return {"refused": "MemoryError", "detail": "it exceeds the memory limit"}, b""
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _limit_memory(more_bytes: int) -> None:
    has_pages = int(Path("/proc/self/statm").read_text().split()[5])
    limit = has_pages * resource.getpagesize() + more_bytes
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _keep_freed_memory() -> None:
    """Keep what an errand has freed for the next one.

    Each takes a few megabytes. To get them from the system each time took 2.4 of the 6.0 ms of the PNG of 768x512.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # another C library than glibc may have none
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)


def main() -> None:
    """Perform errands until the other side closes the socket."""
    os.nice(NICENESS)
    sgmethod.set_threads(min(THREADS, len(os.sched_getaffinity(0))))
    _keep_freed_memory()
    connection = socket.socket(fileno=int(sys.argv[1]))
    connection.sendall(READY)
    while True:
        line, descriptors, _, _ = socket.recv_fds(connection, ERRAND_BYTES, 1)
        if not line:
            return
        figures, picture = _answer(Errand.from_json(line), descriptors[0])
        text = json.dumps(figures).encode()
        with contextlib.suppress(ConnectionError):  # nobody is there any more, which the next errand will say
            connection.sendall(ANSWER_HEADER.pack(len(text), len(picture)) + text)
            connection.sendall(picture)


if __name__ == "__main__":
    main()
