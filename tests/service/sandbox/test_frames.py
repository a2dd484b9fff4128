"""What a task may say: everything else is the end of it, and costs its client nothing."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from service.jobs.job import EncodeRequest
from service.sandbox import frames
from service.sandbox.frames import (
    Begun,
    Draw,
    Encode,
    FrameError,
    FrameReader,
    MakePreview,
    MakeRival,
    ReadHeader,
    packed,
    packed_json,
)
from service.sandbox.pictures import PictureOptions, Rival

LIMITS: dict[str, Any] = {"memory_bytes": 1, "cpu_s": 1.0, "max_pixels": 64}
ENCODE = Encode(**LIMITS, job_id="0" * 32, request=EncodeRequest("psnr", 30.5, "paper", 2.5), threads=2)
DRAW = Draw(**LIMITS, options=PictureOptions(region="0,0,8,8", quality=5), file_kind="jpg")
POINT = frames.TracePoint(seconds=0.5, step=1, steps=2, psnr=None, bytes=3, gaussians=4, phase="joint")
FIGURES: dict[str, Any] = {
    **{"bytes": 3, "bpp": 0.3, "psnr": None, "ms_ssim": 0.9, "ssimulacra2": None, "gaussians": 1, "steps": 2},
    **{"seconds": 0.1, "width": 8, "height": 8, "profile": "rd", "tune": "psnr", "effort": 5, "source_bytes": 10},
    **{"psnr_missed_db": None, "quality_missed": None, "warnings": [], "advice": None, "better": None},
}


PREVIEW = MakePreview(**LIMITS, most_bytes=12)


def preview(**more: Any) -> bytes:
    said = {"text": "A" * 16, "width": 8, "height": 8, "color": "#000000", "dark": True, **more}
    return packed(b"S", json.dumps(said).encode())


def figures(**more: Any) -> bytes:
    return packed(b"S", json.dumps({**FIGURES, **more}).encode())


def test_a_task_has_no_field_that_nobody_knows() -> None:
    for field in ("more", "gives_file"):
        with pytest.raises(ValidationError):
            TypeAdapter(frames.AnyTask).validate_python({**DRAW.model_dump(), field: 1})


def test_messages_arrive_whole_and_in_order() -> None:
    reader, file = FrameReader(ENCODE), b"\xd3\xc2" + bytes(range(256)) * 100
    said = packed_json(Begun()) + packed_json(POINT) + figures(notes=["alpha"], bytes=len(file)) + packed(b"F", file)
    messages = [message for at in range(0, len(said), 7) for message in reader.take(said[at : at + 7])]
    assert messages[:2] == [Begun(), POINT]
    (result,) = messages[2:]
    assert isinstance(result, frames.Result)
    assert result.file == file
    assert result.figures.model_dump(exclude_unset=True) == {**FIGURES, "notes": ["alpha"], "bytes": len(file)}


@pytest.mark.parametrize(
    ("task", "said", "words"),
    [
        (ENCODE, packed(b"Z", b""), "unknown kind b'Z'"),
        (ENCODE, frames.FRAME_HEADER.pack(b"S", 300 << 20), "where 65536 are allowed"),
        (ENCODE, frames.FRAME_HEADER.pack(b"T", 4097), "where 4096 are allowed"),
        (ENCODE, frames.FRAME_HEADER.pack(b"F", frames.FILE_BYTES + 8 * 64 + 1), "are allowed"),
        (ENCODE, frames.FRAME_HEADER.pack(b"P", 300 << 20), "are allowed"),
        (ENCODE, packed(b"S", b"[]"), "is wrong"),
        (ENCODE, packed(b"S", b"{"), "json_invalid"),
        (ENCODE, packed(b"S", b"[" * 60_000), "json_invalid"),
        (ENCODE, packed(b"S", b"\xff"), "json_invalid"),
        (ENCODE, figures(notes="text"), "notes"),
        (ENCODE, figures(notes=[{}]), "notes"),
        (ENCODE, figures(warnings=["x" * 1001]), "warnings"),
        (ENCODE, figures(psnr=float("nan")), "psnr"),
        (ENCODE, figures(more=1), "extra_forbidden"),
        (ENCODE, figures(better="exe"), "better"),
        (ENCODE, figures(width=None), "width"),
        (ENCODE, figures(bytes=2**63), "less_than_equal"),
        (ENCODE, figures(steps=-1), "greater_than_equal"),
        (ENCODE, figures() + packed(b"F", b"four"), "of another size"),
        (ENCODE, packed(b"F", b"x"), "without its figures"),
        (ENCODE, packed(b"T", b'{"step": 1}'), "missing"),
        (ENCODE, packed(b"T", b"null"), "is wrong"),
        (ENCODE, packed_json(POINT) * (ENCODE.most_frames + 1), "too many frames"),
        (ENCODE, figures(bytes=4) + packed(b"F", b"<svg"), "not an .sg file"),
        (ENCODE, figures(width=9, bytes=2) + packed(b"F", b"\xd3\xc2"), "more pixels"),
        (ENCODE, packed(b"R", b'{"error": "SystemExit", "detail": ""}'), "error"),
        (ENCODE, packed(b"C", b'{"detail": 7}'), "detail"),
        (ENCODE, packed(b"E", b'{"status": "0"} x'), "json_invalid"),
        (ENCODE, packed(b"E", b'{"status": -99999}'), "status"),
        (ENCODE, packed(b"T", POINT.model_copy(update={"step": 10**400}).model_dump_json().encode()), "step"),
        (DRAW, packed_json(POINT), "unknown kind b'T'"),
        (DRAW, packed_json(Begun()) * 5, "too many frames"),
        (DRAW, frames.FRAME_HEADER.pack(b"F", frames.FILE_BYTES + 4 * 64 + 1), "are allowed"),
        (DRAW, packed(b"F", b"<script>"), "JPEG was asked for, and this is something else"),
        (DRAW, packed(b"F", b"\x89PNG\r\n\x1a\n"), "JPEG was asked for, and this is PNG"),
        (MakeRival(**LIMITS, rival=Rival("avif", 9)), packed(b"F", b"\xff\xd8\xff"), "AVIF was asked for"),
        (DRAW, packed(b"P", b""), "unknown kind"),
        (DRAW, packed(b"S", b"{}"), "unknown kind"),
        (PREVIEW, preview(text="A" * 18), "more bytes"),
        (PREVIEW, preview(text="<br>"), "text"),
        (PREVIEW, preview(width=9), "more pixels"),
        (ReadHeader(**LIMITS), packed(b"F", b"x"), "where 0 are allowed"),
        (ReadHeader(**LIMITS), packed(b"S", b'{"format": "PNG", "width": 0, "height": 4}'), "width"),
        (ReadHeader(**LIMITS), packed(b"S", b'{"format": "PNG", "width": 9, "height": 8}'), "more pixels"),
    ],
)
def test_nonsense(task: Any, said: bytes, words: str) -> None:
    with pytest.raises(FrameError, match=words):
        FrameReader(task).take(said)


def test_figures_that_json_cannot_say_become_none() -> None:
    figures = {"psnr": float("inf"), "ssim": float("nan"), "bytes": 3}
    assert frames.finite(figures) == {"psnr": None, "ssim": None, "bytes": 3}
