"""What a task may say. An undeclared message ends the task; the client is not charged."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from service.pictures import PictureOptions
from service.sandbox import frames
from service.sandbox.frames import (
    Begun,
    Compare,
    Draw,
    Encode,
    FrameError,
    FrameReader,
    MakePreview,
    ReadHeader,
    Result,
    packed,
)
from tests.support.job_table import request_of
from tests.support.profiles import OTHER

LIMITS: dict[str, Any] = {"memory_bytes": 1, "cpu_s": 1.0, "max_pixels": 64}
REQUEST = request_of("psnr", 30.5, profile=OTHER, time_limit_s=2.5)
ENCODE = Encode(**LIMITS, job_id="0" * 32, request=REQUEST, threads=2)
DRAW = Draw(**LIMITS, options=PictureOptions(region="0,0,8,8", quality=5), file_kind="jpg")
POINT = frames.TracePoint(seconds=0.5, step=1, steps=2, psnr=None, bytes=3, gaussians=4, phase="joint", share=0.1)
FIGURES: dict[str, Any] = {
    **{"bytes": 3, "bpp": 0.3, "psnr": None, "ssimulacra2": None, "gaussians": 1, "steps": 2},
    **{"seconds": 0.1, "width": 8, "height": 8, "profile": "rd", "tune": "psnr", "effort": 5, "source_bytes": 10},
    **{"psnr_missed_db": None, "quality_missed": None, "warnings": [], "advice": None, "better": None},
    "notes": [],
}

PREVIEW = MakePreview(**LIMITS, max_bytes=12)


def frame(text: str | bytes, file: bytes = b"") -> bytes:
    data = text.encode() if isinstance(text, str) else text
    return frames.FRAME_HEADER.pack(len(data), len(file)) + data + file


def claiming(frame: bytes, file_bytes: int) -> bytes:
    """The beginning of the frame with a file of that size."""
    text = frame[frames.FRAME_HEADER.size :]
    return frames.FRAME_HEADER.pack(len(text), file_bytes) + text


def result(figures: Any, file: bytes = b"") -> bytes:
    return frame(json.dumps({"kind": "result", "figures": figures}), file)


def preview(**more: Any) -> bytes:
    return result({"text": "A" * 16, "width": 8, "height": 8, "color": "#000000", "dark": True, **more})


def encoded(file: bytes = b"", **more: Any) -> bytes:
    return result({**FIGURES, **more}, file)


def header(width: int) -> bytes:
    return result({"format": "PNG", "width": width, "height": 8})


def test_a_task_has_no_unknown_field() -> None:
    for field in ("more", "bytes_per_pixel"):
        with pytest.raises(ValidationError):
            TypeAdapter(frames.AnyTask).validate_python({**DRAW.model_dump(), field: 1})


def test_messages_arrive_whole_and_in_order() -> None:
    reader, file = FrameReader(ENCODE), b"\xd3\xc2" + bytes(range(256)) * 100
    figures = frames.EncodeFigures(**{**FIGURES, "notes": ["alpha"], "bytes": len(file)})
    assert '"gaussians":1,' in figures.model_dump_json()  # a whole number stays one
    sent = [Begun(), POINT, Result[frames.EncodeFigures](figures=figures, file=file)]
    output = b"".join(map(packed, sent))
    assert [message for at in range(0, len(output), 7) for message in reader.take(output[at : at + 7])] == sent


@pytest.mark.parametrize(
    ("task", "output", "words"),
    [
        (ENCODE, frame('{"kind": "other"}'), "union_tag_invalid"),
        (ENCODE, frames.FRAME_HEADER.pack(65537, 0), "too long"),
        (ENCODE, claiming(encoded(), frames.FILE_BYTES + 8 * 64 + 1), "too long"),
        (ENCODE, claiming(packed(POINT), 1), "after the message trace"),
        (ENCODE, frame("[]"), "is wrong"),
        (ENCODE, frame("null"), "is wrong"),
        (ENCODE, frame("{"), "json_invalid"),
        (ENCODE, frame("[" * 60_000), "json_invalid"),
        (ENCODE, frame(b"\xff"), "json_invalid"),
        (ENCODE, encoded(notes="text"), "notes"),
        (ENCODE, encoded(notes=[{}]), "notes"),
        (ENCODE, encoded(warnings=["x" * 1001]), "warnings"),
        (ENCODE, encoded(psnr=float("nan")), "psnr"),
        (ENCODE, encoded(width=None), "width"),
        (ENCODE, encoded(bytes=2**63), "less_than_equal"),
        (ENCODE, encoded(bytes=-1), "greater_than_equal"),
        (ENCODE, encoded(b"four"), "of another size"),
        (ENCODE, result(None, b"x"), "figures"),
        (ENCODE, frame('{"kind": "trace", "step": 1}'), "missing"),
        (ENCODE, packed(POINT) * (ENCODE.max_frames + 1), "too many frames"),
        (ENCODE, encoded(b"<svg", bytes=4), "not an .sg file"),
        (ENCODE, encoded(b"\xd3\xc2", width=9, bytes=2), "more pixels"),
        (ENCODE, frame('{"kind": "refused", "error": "SystemExit", "detail": ""}'), "error"),
        (ENCODE, frame('{"kind": "crashed", "detail": 7}'), "detail"),
        (ENCODE, frame('{"kind": "ended", "status": 0} x'), "json_invalid"),
        (ENCODE, frame('{"kind": "ended", "status": -99999}'), "status"),
        (ENCODE, packed(POINT.model_copy(update={"step": 10**400})), "step"),
        (ENCODE, frame('{"kind": "begun"}', b"x"), "after the message begun"),
        (DRAW, packed(POINT), "union_tag_invalid"),
        (DRAW, packed(Begun()) * 4, "too many frames"),
        (DRAW, claiming(result(None), frames.FILE_BYTES + 4 * 64 + 1), "too long"),
        (DRAW, result(None, b"<script>"), "JPEG was asked for, and this is something else"),
        (DRAW, result(None, b"\x89PNG\r\n\x1a\n"), "JPEG was asked for, and this is PNG"),
        (DRAW, result({}), "figures"),
        (Compare(**LIMITS, file_kind="avif", size=9), result(None, b"\xff\xd8\xff"), "AVIF was asked for"),
        (PREVIEW, preview(text="A" * 18), "more bytes"),
        (PREVIEW, preview(text="<br>"), "text"),
        (PREVIEW, preview(width=9), "more pixels"),
        (ReadHeader(**LIMITS), claiming(header(1), 1), "too long"),
        (ReadHeader(**LIMITS), header(0), "width"),
        (ReadHeader(**LIMITS), header(9), "more pixels"),
    ],
)
def test_frames_that_are_refused(task: Any, output: bytes, words: str) -> None:
    with pytest.raises(FrameError, match=words):
        FrameReader(task).take(output)


def test_figures_that_json_cannot_say_become_none() -> None:
    figures = {"psnr": float("inf"), "ssim": float("nan"), "bytes": 3}
    assert frames.finite(figures) == {"psnr": None, "ssim": None, "bytes": 3}
