"""Decoding beside the event loop and never too many at once; which view is drawn; what is kept of it."""

from __future__ import annotations

import asyncio
import io
import threading

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import sgmethod
from service.web.guards.problems import ProblemError
from service.web.routes.decoding import Drawing, PictureCache, PictureDecoder, ViewQuery, draw, draw_unknown
from service.web.routes.picture_files import MEDIA_TYPES, encode_picture
from sgmethod.errors import BitstreamError
from sgmethod.view import View
from tests.harness.data import golden_path

PICTURE = golden_path("v3-color.sg").read_bytes()
INFO = sgmethod.info(PICTURE)
SIZE = (INFO.width, INFO.height)
NO_LIMIT = 10**9


def pixels_of(file: bytes) -> NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(file)))


def test_decodes_are_bounded_and_leave_the_loop_free() -> None:
    go_on = threading.Event()
    running: list[bytes] = []

    def slow(bitstream: bytes) -> bytes:
        running.append(bitstream)
        assert go_on.wait(30)
        return b"png of " + bitstream

    async def scenario() -> list[bytes]:
        decoder = PictureDecoder(max_running=2, max_waiting=1)
        tasks = [asyncio.create_task(decoder.run(slow, b"%d" % number)) for number in range(3)]
        while len(running) < 2:
            await asyncio.sleep(0.01)  # the loop runs while decodes block their threads
        with pytest.raises(ProblemError) as refusal:
            await decoder.run(slow, b"one too many")
        assert refusal.value.status == 503
        assert refusal.value.headers["Retry-After"]
        assert len(running) == 2
        go_on.set()
        return await asyncio.gather(*tasks)

    assert asyncio.run(scenario()) == [b"png of 0", b"png of 1", b"png of 2"]


def test_what_is_no_bitstream() -> None:
    with pytest.raises(BitstreamError):
        draw_unknown(b"not a bitstream", ViewQuery(), NO_LIMIT, NO_LIMIT)


@pytest.mark.parametrize("name", ["v1-paper.sg", "v3-color.sg"])
def test_gaussians_of_a_bitstream_are_limited(name: str) -> None:
    data = golden_path(name).read_bytes()
    count = sgmethod.info(data).gaussians
    assert draw_unknown(data, ViewQuery(), NO_LIMIT, count) == encode_picture(sgmethod.decode(data), "png")
    with pytest.raises(BitstreamError, match=f"limit of {count - 1}$"):
        draw_unknown(data, ViewQuery(), NO_LIMIT, count - 1)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 7), (7, 1), (64, 48), (333, 3)])
def test_png_is_lossless_and_whole(width: int, height: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    for some in (pixels, np.zeros_like(pixels)):
        file = encode_picture(some, "png")
        Image.open(io.BytesIO(file)).verify()
        np.testing.assert_array_equal(pixels_of(file), some)


def test_png_of_many_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sgmethod.io.png.MAX_CHUNK_BYTES", 100)
    pixels = np.random.default_rng(0).integers(0, 256, (20, 20, 3), np.uint8)
    file = encode_picture(pixels, "png")
    assert file.count(b"IDAT") > 10
    np.testing.assert_array_equal(pixels_of(file), pixels)


@pytest.mark.parametrize("kind", ["jpg", "webp"])
def test_lossy_files_are_close(kind: str) -> None:
    pixels = sgmethod.decode(PICTURE)
    drawing = Drawing.of(ViewQuery(), kind, SIZE, NO_LIMIT)  # type: ignore[arg-type]
    file = draw(PICTURE, drawing)
    image = Image.open(io.BytesIO(file))
    assert image.get_format_mimetype() == MEDIA_TYPES[drawing.kind]
    error = np.mean((np.asarray(image.convert("RGB"), np.float64) - pixels) ** 2)
    assert 10 * np.log10(255**2 / error) > 30


@pytest.mark.parametrize(
    ("query", "view"),
    [
        ({}, View()),
        ({"scale": 2}, View(2.0)),
        ({"width": 17}, View(17 / SIZE[0])),
        ({"region": "2,3,10,8"}, View(1.0, (2, 3, 10, 8))),
        ({"region": "2,3,10,8", "scale": 0.5}, View(0.5, (2, 3, 10, 8))),
        ({"region": "2,3,10,8", "width": 31}, View(3.1, (2, 3, 10, 8))),
        ({"region": f"0,0,{SIZE[0]},{SIZE[1]}"}, View()),
    ],
)
def test_views(query: dict[str, object], view: View) -> None:
    drawing = Drawing.of(ViewQuery.model_validate(query), "png", SIZE, NO_LIMIT)
    pixels = pixels_of(draw(PICTURE, drawing))
    np.testing.assert_array_equal(pixels, sgmethod.decode(PICTURE, view=view))
    assert (drawing.width, drawing.height) == (pixels.shape[1], pixels.shape[0])
    if "width" in query:
        assert drawing.width == query["width"]


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"scale": 1, "width": 10}, "not both"),
        ({"region": "0,0,0,5"}, "within"),
        ({"region": "0,0,0,5", "width": 5}, "within"),
        ({"region": "0,0,99999,5"}, "within"),
        ({"width": 65535}, "scale"),
        ({"scale": 64}, "more than the limit"),
    ],
)
def test_views_that_are_refused(query: dict[str, object], words: str) -> None:
    with pytest.raises(ProblemError, match=words) as refusal:
        Drawing.of(ViewQuery.model_validate(query), "png", SIZE, 10_000)
    assert refusal.value.status == 422


def test_what_a_kind_of_file_cannot_hold() -> None:
    long = (16_384, 1)
    assert Drawing.of(ViewQuery(), "png", long, NO_LIMIT).width == 16_384
    with pytest.raises(ProblemError, match="16,383 a side"):
        Drawing.of(ViewQuery(), "webp", long, NO_LIMIT)


def test_entity_tags_tell_pictures_apart() -> None:
    queries = [{}, {"scale": 2}, {"region": "0,0,10,8"}, {"region": "0,1,10,8"}, {"region": "0,0,10,8", "scale": 2}]
    drawings = [Drawing.of(ViewQuery.model_validate(q), "png", SIZE, NO_LIMIT) for q in queries]
    drawings.append(Drawing.of(ViewQuery(), "jpg", SIZE, NO_LIMIT))
    tags = {drawing.etag(sha) for drawing in drawings for sha in ("a" * 64, "b" * 64)}
    assert len(tags) == 2 * len(drawings)
    same = [Drawing.of(ViewQuery(**q), "png", SIZE, NO_LIMIT) for q in ({"width": 2 * SIZE[0]}, {"scale": 2.0})]
    assert same[0].etag("a" * 64) == same[1].etag("a" * 64)
    assert all("," not in tag for tag in tags)  # lists of tags are split at commas


def test_the_cache_keeps_what_was_asked_for_last() -> None:
    cache = PictureCache(10)
    cache.put("a", b"aaaa")
    cache.put("b", b"bbbb")
    assert cache.get("a") == b"aaaa"
    cache.put("c", b"cccc")
    assert (cache.get("a"), cache.get("b"), cache.get("c")) == (b"aaaa", None, b"cccc")
    cache.put("a", b"aaaa")
    cache.put("huge", bytes(11))
    assert cache.get("huge") is None
    assert cache.bytes == 8
    nothing = PictureCache(0)
    nothing.put("a", b"a")
    assert nothing.get("a") is None
