"""sgmethod.preview(): what its text, its figures and its HTML say of a picture."""

from __future__ import annotations

import asyncio
import base64
import io
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

import sgmethod
from sgmethod.bitstream.text import from_text
from sgmethod.errors import BitstreamError, BudgetError, ImageError
from sgmethod.io.image import ImageLimits
from sgmethod.metrics import psnr
from sgmethod.previews import reducing
from sgmethod.previews.preview import Preview, average_of, quoted
from sgmethod.previews.reducing import reduced, reduced_size
from sgmethod.previews.still import webp_uri
from tests.support.data import code_in
from tests.support.pictures import photo, saved
from tests.support.profiles import shorten

PHOTO = Image.fromarray(photo())  # 128 x 96
LARGE = PHOTO.resize((1200, 900), Image.Resampling.BICUBIC)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch, 60)


@pytest.fixture(scope="module")
def made() -> Preview:
    return sgmethod.preview(LARGE, 120)


def test_the_text_is_a_small_picture_of_the_same_shape(made: Preview) -> None:
    assert len(made.data) <= 120
    assert len(made.text) <= 160
    assert (made.width, made.height) == LARGE.size
    decoded = sgmethod.decode(made.data)
    height, width, _ = decoded.shape
    assert width * 900 == height * 1200
    assert width * height <= 256 * 120
    assert psnr(decoded, np.asarray(LARGE.resize((width, height), Image.Resampling.BOX))) > 18  # seen: 19.5


def test_color_and_dark(made: Preview) -> None:
    mean = np.asarray(LARGE).mean((0, 1))
    assert np.abs([int(made.color[at : at + 2], 16) for at in (1, 3, 5)] - mean).max() < 2
    grey = {level: sgmethod.preview(np.full((8, 8), level, np.uint8), 60) for level in (0, 116, 119, 255)}
    assert {level: one.dark for level, one in grey.items()} == {0: True, 116: True, 119: False, 255: False}
    assert [one.color for one in grey.values()] == ["#000000", "#747474", "#777777", "#ffffff"]


def test_every_decoder_of_files_reads_the_text(made: Preview, tmp_path: Path) -> None:
    pixels = sgmethod.decode(made.data)
    (tmp_path / "text").write_text(made.text + "\n")
    assert sgmethod.from_text(made.text) == made.data
    assert sgmethod.to_text(made.data) == made.text
    np.testing.assert_array_equal(sgmethod.decode(made.text.encode()), pixels)
    np.testing.assert_array_equal(sgmethod.open(tmp_path / "text").pixels(), pixels)
    assert sgmethod.info(made.text.encode()) == sgmethod.info(made.data)
    with pytest.raises(BitstreamError):
        sgmethod.decode(made.text[:-1].encode())


def test_transparency_is_kept() -> None:
    pixels = np.zeros((90, 120, 4), np.uint8)
    pixels[:, :60] = (200, 40, 40, 255)
    pixels[:, 60:] = (0, 255, 0, 0)  # a colour that cannot be seen
    made = sgmethod.preview(pixels, 120)
    decoded = sgmethod.decode(made.data)
    third = decoded.shape[1] // 3
    assert decoded[:, :third, 3].mean() > 200
    assert decoded[:, -third:, 3].mean() < 55
    assert made.color == "#c82828"
    assert "background" not in made.html("a.png")
    assert average_of(np.full((2, 2, 4), (10, 20, 30, 0), np.uint8)) == (10, 20, 30)  # what cannot be seen at all


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP"])
def test_files_of_several_kinds(kind: str) -> None:
    exif = Image.Exif()
    exif[274] = 6  # to be turned by a quarter
    file = saved(LARGE, kind, exif=exif)
    made = sgmethod.preview(file, 60)
    assert (made.width, made.height) == (900, 1200)
    width, height = sgmethod.open(made.data).size
    assert width * 4 == height * 3


def test_a_large_jpeg_is_read_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, ...]] = []
    read = reducing.read_image_8_bit
    monkeypatch.setattr(reducing, "read_image_8_bit", lambda *a, **k: seen.append((p := read(*a, **k)).shape) or p)
    file = saved(LARGE, "JPEG", quality=95)
    small, own = reduced(file, 5000)
    assert (seen, own) == ([(225, 300, 3)], (1200, 900))
    assert small.shape == (60, 80, 3)
    whole = np.asarray(LARGE.resize((80, 60), Image.Resampling.BOX))
    assert psnr(small, whole) > 35  # seen: 42


@pytest.mark.parametrize("size", [(4032, 3024), (3872, 2592), (1280, 853), (1999, 1333), (853, 1280), (1000, 1001)])
@pytest.mark.parametrize("bytes_", [200, 1024])
def test_aspect_ratios_reserve_the_right_space(size: tuple[int, int], bytes_: int) -> None:
    """To a pixel in 1,000, even where that pixel is all by which the sides differ; thin pictures keep one at least."""
    width, height = reduced_size(size, 64 * bytes_)
    assert 32 * bytes_ < width * height <= 64 * bytes_ * 1.02
    assert abs(width / height * size[1] / size[0] - 1) <= 1 / 999
    for odd in ((1, 1), (5, 3), (2, 60_000), (60_000, 1), (300, 20_000)):
        assert all(1 <= small <= large for small, large in zip(reduced_size(odd, 64 * bytes_), odd, strict=True))


def test_a_strip_is_reduced_along() -> None:
    for bytes_, length in ((12, 192), (200, 3200)):
        assert sgmethod.open(sgmethod.preview(np.zeros((1, 8000), np.uint8), bytes_).data).size == (length, 1)
    assert reduced_size((8, 8000), 51_200) == (3, 3000)
    assert reduced_size((3200, 1), 51_200) == (3200, 1)


class Tags(HTMLParser):
    """The attributes of each tag."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


def test_html(made: Preview) -> None:
    ((tag, attributes),) = Tags(made.html('a"b.jpg', "<a> & b")).tags
    assert tag == "img"
    assert (attributes["src"], attributes["alt"]) == ('a"b.jpg', "<a> & b")
    assert (attributes["width"], attributes["height"], attributes["loading"]) == ("1200", "900", "lazy")
    style = attributes["style"] or ""
    assert style.startswith("width:100%;height:auto;background:url(data:image/webp;base64,")
    assert style.endswith(") center / contain no-repeat")
    picture = Image.open(io.BytesIO(base64.b64decode(style.split("base64,")[1].split(")")[0])))
    shown = picture.convert("RGB").resize(LARGE.size, Image.Resampling.BICUBIC)
    assert psnr(np.asarray(shown), np.asarray(LARGE)) > 17  # seen: 18.4


def test_html_is_as_long_as_allowed(made: Preview) -> None:
    """The picture of more characters is better; of too few, there is only the colour."""
    tags = [made.html("a.jpg", characters=most) for most in (200, 400, 500, 800)]
    assert len(tags[0]) <= 200
    assert "url(" not in tags[0]
    assert made.color in tags[0]
    assert 380 < len(tags[1]) <= 400 < len(tags[2]) <= 500
    drawn = [Image.open(io.BytesIO(base64.b64decode(tag.split("base64,")[1].split(")")[0]))) for tag in tags[1:]]
    shown = [one.convert("RGB").resize(LARGE.size, Image.Resampling.BICUBIC) for one in drawn]
    assert sorted(quality := [psnr(np.asarray(one), np.asarray(LARGE)) for one in shown]) == quality


def test_html_of_a_long_strip() -> None:
    made = sgmethod.preview(np.zeros((1, 6000), np.uint8), 60)
    assert "url(" in made.html("a.png")


def test_a_webp_has_the_aspect_ratio_of_its_picture() -> None:
    """Or the page would show beside it, where it is contained in the photograph's box."""
    for characters in (200, 300, 500):
        uri = webp_uri(np.asarray(LARGE.resize((200, 140))), characters)
        picture = Image.open(io.BytesIO(base64.b64decode(uri.split(",")[1])))
        assert picture.width / picture.height == pytest.approx(200 / 140, rel=0.01)


def test_element(made: Preview) -> None:
    """It is what sgmethod/javascript/src/sg-img.js takes: with an <img> within, which shows a WebP to readers without
    scripts, and with the rules of docs/previews.md as styles."""
    rules = re.findall(r"^(sg-img.*?) {(.*?)}$", code_in("docs/previews.md", heading="Plain HTML")[1], re.M | re.S)
    styles = {name: re.sub(r"([:;])\s+", r"\1", rule.strip()).removesuffix(";") for name, rule in rules}
    (outer, attributes), (inner, image) = Tags(made.element("a.jpg", "b")).tags
    assert (outer, attributes) == ("sg-img", {"preview": made.text, "style": styles["sg-img"]})
    style, pictures = re.subn(r"url\(data:image/webp;base64,\S+\) ", "", image.pop("style") or "")
    assert (style, pictures) == (styles["sg-img img"], 1)
    same = {"src": "a.jpg", "alt": "b", "width": "1200", "height": "900", "loading": "lazy", "decoding": "async"}
    assert (inner, image) == ("img", same)


def test_dictionary_and_names(made: Preview) -> None:
    facts = json.loads(json.dumps(made.to_dict()))
    assert list(facts) == ["text", "width", "height", "color", "dark"]
    assert quoted("a b/ü#1?.jpg") == "a%20b/%C3%BC%231%3F.jpg"
    assert quoted(os.fsdecode(b"\xe9-12:30\\.png")) == "%E9-12%3A30%5C.png"  # no text, and no scheme


@pytest.mark.parametrize("asked", [5, 20_000, 1.5, True, "20k"])
def test_bytes_that_no_preview_has(asked: object) -> None:
    with pytest.raises(BudgetError):
        sgmethod.preview(PHOTO, asked)  # type: ignore[arg-type]
    with pytest.raises(ImageError, match="too large"):
        sgmethod.preview(saved(LARGE, "PNG"), limits=ImageLimits(max_pixels=1000))


def test_the_recipe_for_fastapi() -> None:
    (block,) = code_in("docs/previews.md", heading="FastAPI")
    names: dict[str, Any] = {"__name__": "recipe"}
    exec(compile(block, "recipe", "exec"), names)

    async def upload(data: bytes) -> httpx2.Response:
        transport = httpx2.ASGITransport(app=names["app"])
        async with httpx2.AsyncClient(transport=transport, base_url="http://recipe") as client:
            return await client.post("/photos", content=data)

    answer = asyncio.run(upload(saved(PHOTO)))
    assert answer.status_code == 200
    photo = answer.json()
    assert (photo["width"], photo["height"]) == (128, 96)
    assert len(from_text(photo["preview"])) <= 200
    answer = asyncio.run(upload(b"text"))
    assert (answer.status_code, answer.json()["detail"][:15]) == (422, "the file is not")
