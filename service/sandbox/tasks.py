"""The tasks, each done in a confined process: a file comes in, messages go out."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import pkgutil
import sys
import time
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import cv2
from PIL import Image

import sgmethod
from service.pictures import MEDIA_TYPES, Drawing, PictureOptions, comparison_file, encode_picture
from service.sandbox import frames
from sgmethod import machine
from sgmethod.bitstream.container import reader_of
from sgmethod.budget import Budget
from sgmethod.errors import ImageError, SgError, noted
from sgmethod.io.compositing import WHITE, composited
from sgmethod.io.formats import FORMATS
from sgmethod.io.image import ImageHeader, ImageLimits, read_header, read_image_8_bit, read_input
from sgmethod.profiles import PROFILE_NAMES, READERS, Profile, Tune, checked_profile, method_of

CUT_SHORT = 0.9  # of the time limit: an encode that takes longer was cut short by it
FAIR_CPU_SHARE = 0.5
ERROR_LENGTH = 300  # characters of an error message sent to a client
TINY_PICTURE = b"P6 8 8 255 " + bytes(range(192))
TINY_SIZE = (8, 8)
# glibc's malloc.h: thresholds above which freed memory returns to the system.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
TRIM_BYTES, LARGE_BYTES = 16 << 20, 4 << 20
# Modules that tasks do not need, or that need PyTorch.
NOT_IMPORTED = {
    f"sgmethod.{name}"
    for name in (
        *("__main__", "cli", "client", "exchange", "many", "pillow", "torch"),
        *(name for name in PROFILE_NAMES if method_of(name).packages),
    )
}

CORES = machine.cores()  # asked here: a confined task opens no file

# Modules that libraries import only for some images.
IMPORTED_LATE = (
    *(f"PIL.{name}" for name in ("ImageCms", "ImageColor", "ImageFilter", "ImagePalette", "MpoImagePlugin")),
    *(f"encodings.{name}" for name in ("ascii", "cp1252", "latin_1", "utf_16", "utf_16_be", "utf_16_le", "utf_32")),
    *(f"numpy.{name}" for name in ("fft", "linalg", "ma", "random")),  # NumPy's median imports ma
)


class Answer:
    """A task's end of its socket."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send(self, message: frames.Message) -> None:
        left = memoryview(frames.packed(message))
        while left:
            left = left[os.write(self._descriptor, left) :]

    def send_result(self, figures: frames.Model | None, file: bytes = b"") -> None:
        self.send(frames.Result(figures=figures, file=file))


def set_threads(count: int) -> None:
    """Set the number of threads that a task computes on, one a core at most. None is started before it is needed."""
    count = min(count, CORES)
    sgmethod.set_threads(count)
    cv2.setNumThreads(count)


def warm_up() -> None:
    """Import and set up all that tasks need, since they can open no file. No thread may remain: forks would lack it."""
    set_threads(1)
    _import_all(sgmethod.__path__, "sgmethod.")
    for version in READERS:
        reader_of(version)
    Image.preinit()
    for module in (*(known.reader[0] for known in FORMATS.values()), *IMPORTED_LATE):
        with contextlib.suppress(ImportError):  # in an extra that is not installed
            importlib.import_module(module)
    for module, name, one in filter(None, (known.threads for known in FORMATS.values())):
        if module in sys.modules:  # its decoder would start a thread for each core
            setattr(sys.modules[module], name, one)
    for tune in ("psnr", "visual"):
        tiny_encode("rd", tune)
    for kind in MEDIA_TYPES:
        encode_picture(read_image_8_bit(TINY_PICTURE), kind)


def warm_fork() -> None:
    """Touch the memory that every picture takes, before a client waits for one.

    Freed memory is reused within a task: getting it from the system each time took 2.4 of the 6.0 ms of the PNG of
    768x512.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:  # C libraries other than glibc lack it
        mallopt(M_TRIM_THRESHOLD, TRIM_BYTES)
        mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
    Drawing.from_options(PictureOptions(), "png", TINY_SIZE, 64).draw(tiny_encode("rd", "psnr"))


def prepare(task: frames.Task) -> None:
    """Import what is too large to keep in memory for all tasks."""
    if isinstance(task, frames.Encode) and task.request.profile != "rd":
        tiny_encode(checked_profile(task.request.profile))


def _import_all(path: Any, prefix: str) -> None:
    for module in pkgutil.iter_modules(path, prefix):
        if module.name not in NOT_IMPORTED:
            found = importlib.import_module(module.name)
            if module.ispkg:
                _import_all(found.__path__, f"{module.name}.")


@cache
def tiny_encode(profile: Profile, tune: Tune | None = None) -> bytes:
    """Encode the tiny picture."""
    from sgmethod.codec import encode

    # Other profiles have no effort, and larger files; with one Gaussian, they take less than a second.
    effort, budget = (1, Budget("bytes", 64)) if profile == "rd" else (None, Budget("gaussians", 1))
    return encode(TINY_PICTURE, budget, profile, tune=tune, effort=effort).data


def perform(task: frames.Task, file: bytes, answer: Answer) -> None:
    """Do the task and send its result or its refusal."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            PERFORM[type(task)](task, file, answer)
    except SgError as error:
        answer.send(frames.Refused(error=_name_of(error), detail=str(error)[: frames.MAX_SENTENCE_LENGTH]))
    except MemoryError:  # another attempt would have the same limit
        answer.send(frames.Refused(error="MemoryError", detail="it exceeds the memory limit"))


def _name_of(error: SgError) -> Any:
    names = [kind.__name__ for kind in type(error).__mro__]
    return next(name for name in names if name in frames.REFUSALS)


def _read_header(task: frames.ReadHeader, file: bytes, answer: Answer) -> None:
    header = _header_of_still(file, task)
    answer.send_result(frames.HeaderFigures(format=header.format, width=header.width, height=header.height))


def _header_of_still(file: bytes, task: frames.Task) -> ImageHeader:
    header = read_header(file, ImageLimits(task.max_pixels))
    if not header.still:
        raise ImageError(f"this {header.format} contains more than one picture; send a single still picture")
    return header


def _draw(task: frames.Draw, file: bytes, answer: Answer) -> None:
    info = sgmethod.info(file, task.max_gaussians)  # equal Gaussians take an eighth of a byte each
    drawing = Drawing.from_options(task.options, task.file_kind, (info.width, info.height), task.max_pixels)
    answer.send_result(None, drawing.draw(file))


def _compare(task: frames.Compare, file: bytes, answer: Answer) -> None:
    from sgmethod.metrics.advice import better_file, is_drawn

    pixels = read_image_8_bit(file, ImageLimits(task.max_pixels), keep_alpha=True)
    if task.file_kind == "webp" and (lossless := better_file(pixels, task.size, 0.0, ("webp",))):
        answer.send_result(None, lossless.data)
        return
    opaque = pixels if pixels.shape[2] == 3 else composited(pixels, WHITE)
    answer.send_result(None, comparison_file(opaque, task.file_kind, task.size, drawn=is_drawn(pixels)))


def _make_preview(task: frames.MakePreview, file: bytes, answer: Answer) -> None:
    from sgmethod.previews.preview import preview

    _header_of_still(file, task)
    made = preview(file, task.max_bytes, limits=ImageLimits(task.max_pixels))
    answer.send_result(frames.PreviewFigures.model_validate(made.to_dict()))


def _encode(task: frames.Encode, file: bytes, answer: Answer) -> None:
    from sgmethod.codec import encode
    from sgmethod.metrics.advice import advice, better_file

    request = task.request
    began_s, began_cpu_s = time.monotonic(), time.thread_time()
    with noted() as notes:
        pixels = read_input(file, keep_alpha=method_of(request.profile).keeps_alpha)
        encoded = encode(
            pixels,
            Budget(**request.budget.model_dump()),
            **request.model_dump(exclude={"budget"}),
            on_progress=lambda point: answer.send(frames.TracePoint(**frames.finite(point.to_dict()))),
            measure=True,
        )
        size, db = len(encoded.data), encoded.stats.psnr
        seconds, cpu_s = time.monotonic() - began_s, time.thread_time() - began_cpu_s
        figures = {**encoded.stats.to_dict(), **advice(better_file(pixels, size, db), size, db)}
    figures |= {"source_bytes": len(file), "notes": notes}
    if seconds > CUT_SHORT * request.time_limit_s and cpu_s < FAIR_CPU_SHARE * seconds:
        slow = f"the service was busy: the encode had a core for {cpu_s / seconds:.0%} of its time, and its time limit"
        figures["warnings"] = [*encoded.stats.warnings, f"{slow} cut it short"]
    answer.send_result(frames.EncodeFigures(**frames.finite(figures)), encoded.data)


PERFORM: dict[type[frames.Task], Callable[[Any, bytes, Answer], None]] = {
    frames.ReadHeader: _read_header,
    frames.Draw: _draw,
    frames.Compare: _compare,
    frames.MakePreview: _make_preview,
    frames.Encode: _encode,
}
