"""Which view is drawn and as which file; what is kept of it."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

import sgmethod
from service.api.context import PictureCache
from service.pictures import MEDIA_TYPES, Drawing, PictureOptions, encode_picture
from sgmethod.errors import ViewError
from tests.support.data import PICTURE
from tests.support.pictures import pixels_of

INFO = sgmethod.info(PICTURE)
SIZE = (INFO.width, INFO.height)
NO_LIMIT = 10**9


@pytest.mark.parametrize("most", [100, 1 << 24])
def test_png_is_lossless_and_whole(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """However many chunks it has."""
    monkeypatch.setattr("sgmethod.io.kinds.png.MAX_CHUNK_BYTES", most)
    for width, height in ((1, 1), (1, 7), (7, 1), (64, 48), (333, 3)):
        pixels = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
        for some in (pixels, np.zeros_like(pixels)):
            file = encode_picture(some, "png")
            Image.open(io.BytesIO(file)).verify()
            np.testing.assert_array_equal(pixels_of(file), some)


@pytest.mark.parametrize("kind", ["jpg", "webp", "avif"])
def test_lossy_files_are_close(kind: str) -> None:
    pixels = sgmethod.decode(PICTURE)
    drawing = Drawing.from_options(PictureOptions(), kind, SIZE, NO_LIMIT)  # type: ignore[arg-type]
    file = drawing.draw(PICTURE)
    image = Image.open(io.BytesIO(file))
    assert image.get_format_mimetype() == MEDIA_TYPES[drawing.kind]
    assert "sRGB".encode("utf-16-be") in image.info["icc_profile"] if kind != "avif" else b"colrnclx\0\1\0\r" in file
    error = np.mean((np.asarray(image.convert("RGB"), np.float64) - pixels) ** 2)
    assert 10 * np.log10(255**2 / error) > 30


@pytest.mark.parametrize("region", [None, "2,3,20,9", "5,5,3,30"])
@pytest.mark.parametrize("box", [(10, 10), (31, 7), (7, 31), (1, 1), (100, 90), SIZE])
def test_boxes(region: str | None, box: tuple[int, int]) -> None:
    sides = {}
    for fit in ("contain", "cover", "crop"):
        drawing = Drawing.from_options(
            PictureOptions(width=box[0], height=box[1], fit=fit, region=region), "png", SIZE, NO_LIMIT
        )  # type: ignore[arg-type]
        height, width, _ = pixels_of(drawing.draw(PICTURE)).shape
        assert (drawing.width, drawing.height) == (width, height)
        sides[fit] = (width, height)
    assert sides["crop"] == box
    assert all(side <= limit for side, limit in zip(sides["contain"], box, strict=True))
    assert all(side >= limit for side, limit in zip(sides["cover"], box, strict=True))
    for fit in ("contain", "cover"):
        assert any(side == limit for side, limit in zip(sides[fit], box, strict=True))


def test_a_crop_is_the_middle() -> None:
    """Of the picture at its own size, so that pixels can be compared."""
    whole = sgmethod.decode(PICTURE)
    width, height = SIZE[0] - 10, SIZE[1]
    file = Drawing.from_options(PictureOptions(width=width, height=height, fit="crop"), "png", SIZE, NO_LIMIT).draw(
        PICTURE
    )
    np.testing.assert_array_equal(pixels_of(file), whole[:, 5:-5])


def test_what_a_kind_of_file_cannot_hold() -> None:
    long = (16_384, 1)
    assert Drawing.from_options(PictureOptions(), "png", long, NO_LIMIT).width == 16_384
    with pytest.raises(ViewError, match="16,383 per side"):
        Drawing.from_options(PictureOptions(), "webp", long, NO_LIMIT)
    with pytest.raises(ViewError, match="65,500 per side"):
        Drawing.from_options(PictureOptions(), "jpg", (1, 65_501), NO_LIMIT)


def test_entity_tags_tell_pictures_apart() -> None:
    queries = [{}, {"scale": 2}, {"region": "0,0,10,8"}, {"region": "0,1,10,8"}, {"region": "0,0,10,8", "scale": 2}]
    drawings = [Drawing.from_options(PictureOptions.model_validate(q), "png", SIZE, NO_LIMIT) for q in queries]
    crop = {"width": 5, "height": 9, "fit": "crop"}
    pngs = ({"prefix": 0.5}, crop, {"texture": "0"}, {"texture": "0", "scale": 2})
    more = [("jpg", {}), ("jpg", {"quality": 50}), ("avif", {}), *(("png", options) for options in pngs)]
    drawings += [Drawing.from_options(PictureOptions.model_validate(o), kind, SIZE, NO_LIMIT) for kind, o in more]
    tags = {drawing.etag(sha) for drawing in drawings for sha in ("a" * 64, "b" * 64)}
    assert len(tags) == 2 * len(drawings)
    doubled = (PictureOptions(width=2 * SIZE[0]), PictureOptions(scale=2.0))
    same = [Drawing.from_options(options, "png", SIZE, NO_LIMIT) for options in doubled]
    assert same[0].etag("a" * 64) == same[1].etag("a" * 64)
    assert all("," not in tag for tag in tags)  # lists of tags are split at commas


def test_the_cache_keeps_what_was_asked_for_last() -> None:
    cache = PictureCache(10)
    for name in ("aaaa", "bbbb", "aaaa", "cccc", "larger than all"):
        if cache.get(name) is None:
            cache.put(name, name.encode())
    assert (cache.get("aaaa"), cache.get("bbbb"), cache.get("larger than all")) == (b"aaaa", None, None)
    assert cache.bytes == 8
