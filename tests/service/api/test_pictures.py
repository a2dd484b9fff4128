"""Pictures and views of finished jobs and of posted bitstreams, over HTTP."""

from __future__ import annotations

import io
from email.utils import parsedate_to_datetime

import httpx2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import sgmethod
from service.api.sending import MAX_CACHED_S
from service.pictures import WRITERS, as_large, comparison_file
from service.storage.files import bitstream_key
from sgmethod.view import View
from tests.io.odd_files import heif
from tests.support import pictures
from tests.support.data import PHOTOGRAPHS, PICTURE, STATIC, golden_path
from tests.support.job_table import change, claimed
from tests.support.pictures import SMALL, page_of_text, saved
from tests.support.service import Service, StartService, assert_problem, max_age

TEXTURED = golden_path("v2-texture.sg").read_bytes()
PHOTOGRAPH = (PHOTOGRAPHS / "kodim23-crop.png").read_bytes()
ANIMATION = saved(Image.new("RGB", (8, 8)), "GIF", save_all=True, append_images=[Image.new("RGB", (8, 8), "red")])


@pytest.fixture(scope="module")
def tight(start_for_module: StartService) -> Service:
    """A web process that draws and takes no more than it must."""
    return start_for_module("web", max_pixels=10_000, max_upload_bytes=len(PICTURE))


def pixels_of(answer: httpx2.Response) -> NDArray[np.uint8]:
    assert answer.status_code == 200, answer.text
    assert int(answer.headers["content-length"]) == len(answer.content)
    return pictures.pixels_of(answer.content)


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize(
    ("query", "view"),
    [
        ("", View()),
        ("scale=2", View(2.0)),
        ("scale=0.5&region=2,3,20,16", View(0.5, (2, 3, 20, 16))),
        ("width=30&region=0,0,10,10", View(3.0, (0, 0, 10, 10))),
        ("width=31&region=2,3,10,8", View(3.1, (2, 3, 10, 8))),
        ("width=17", View(17 / 48)),
        ("region=0,0,48,40", View()),
        ("width=20&height=20&fit=crop", None),
        ("prefix=0.3", None),
    ],
)
def test_views_of_a_job_and_of_a_body(web: Service, done: str, kind: str, query: str, view: View | None) -> None:
    drawn, kept = (web.client.get(f"/decode/{done}.{kind}?{query}") for _ in range(2))  # the second from memory
    posted = web.client.post(f"/decode.{kind}?{query}", content=PICTURE)
    assert pixels_of(drawn).size > 0
    assert drawn.content == kept.content == posted.content
    assert posted.headers["cache-control"] == "no-store"
    if kind == "png" and view is not None:
        np.testing.assert_array_equal(pixels_of(drawn), sgmethod.decode(PICTURE, view=view))


def test_alpha_is_kept_where_a_format_has_it(web: Service) -> None:
    data = golden_path("v2-alpha.sg").read_bytes()
    job, pixels = web.published(data), sgmethod.decode(data)
    np.testing.assert_array_equal(pixels_of(web.client.get(f"/decode/{job}.png")), pixels)
    shapes = {kind: pixels_of(web.client.get(f"/decode/{job}.{kind}")).shape for kind in ("webp", "avif", "jpg")}
    assert shapes == {"webp": pixels.shape, "avif": pixels.shape, "jpg": (*pixels.shape[:2], 3)}


def test_texture_can_be_left_out(web: Service) -> None:
    job = web.published(TEXTURED)
    smooth = sgmethod.decode(TEXTURED, view=sgmethod.View(texture=False))
    assert not np.array_equal(smooth, sgmethod.decode(TEXTURED))
    whole, without = (web.client.get(f"/decode/{job}.png{query}") for query in ("", "?texture=0"))
    np.testing.assert_array_equal(pixels_of(without), smooth)
    np.testing.assert_array_equal(pixels_of(whole), sgmethod.decode(TEXTURED))
    assert whole.headers["etag"] != without.headers["etag"]
    np.testing.assert_array_equal(pixels_of(web.client.post("/decode?texture=0", content=TEXTURED)), smooth)
    assert_problem(web.client.get(f"/decode/{job}.png?texture=some"), 422)


@pytest.mark.thorough
def test_other_codecs_make_files_as_large(keeping: Service) -> None:
    coffee, image = ((STATIC / "samples" / f"coffee.{kind}").read_bytes() for kind in ("sg", "webp"))
    job, waiting = keeping.accepted(image), keeping.accepted(image)
    keeping.publish(job, coffee)
    original = pictures.pixels_of(image).astype(float)
    for kind, name in (("jpg", "JPEG"), ("webp", "WEBP"), ("avif", "AVIF")):
        path = f"/jobs/{job}/comparison.{kind}"
        answer = keeping.client.get(path)
        assert Image.open(io.BytesIO(answer.content)).format == name
        assert pixels_of(answer).shape == original.shape
        assert 0.97 < len(answer.content) / len(coffee) < 1.1
        assert 20 < np.square(pixels_of(answer) - original).mean() < 300  # 23 to 35 dB
        goes = parsedate_to_datetime(answer.headers["expires"]).isoformat()
        assert goes[:19] == keeping.job(job)["image_expires_at"][:19]
        assert max_age(answer) <= 1000  # keeping's images
        again = keeping.client.get(f"/jobs/{job}/comparison.{kind}", headers={"If-None-Match": answer.headers["etag"]})
        assert again.status_code == 304
        assert keeping.client.head(f"/jobs/{job}/comparison.{kind}").headers["content-length"] == str(
            len(answer.content)
        )
    assert max_age(keeping.client.get(f"/decode/{job}.png")) == MAX_CACHED_S
    with keeping.table() as table:
        change(table, "UPDATE jobs SET finished_at = finished_at - 1000 WHERE id = ?", job)
    assert_problem(keeping.client.get(f"/jobs/{job}/comparison.avif"), 410, "has been deleted")  # from memory too
    assert_problem(keeping.client.get(f"/jobs/{waiting}/comparison.avif"), 409, "queued")
    assert keeping.client.get(f"/jobs/{job}/comparison.png").status_code == 404


@pytest.mark.thorough
def test_other_codecs_on_a_page_of_text_keep_it_sharp(keeping: Service) -> None:
    """Lossless WebP where it is no larger, with its transparency; AVIF whose colours are as sharp as the rest."""
    clear = np.dstack([pixels := pictures.pixels_of(page_of_text()), 255 - pixels[..., 0] // 2])
    job = keeping.accepted(saved(Image.fromarray(clear)))
    keeping.publish(job, PICTURE, bytes=20_000)
    np.testing.assert_array_equal(pixels_of(keeping.client.get(f"/jobs/{job}/comparison.webp")), clear)
    assert pixels_of(keeping.client.get(f"/jobs/{job}/comparison.avif")).shape == pixels.shape


def test_another_codec_has_the_bytes_or_the_next_larger_size() -> None:
    def size(wanted: int) -> int:
        return len(as_large(lambda quality: bytes(100 * quality), wanted))

    assert [size(wanted) for wanted in (10, 100, 5099, 9999, 10**9)] == [100, 100, 5000, 9900, 10_000]
    assert [size(wanted) for wanted in (199, 1099)] == [200, 1100]  # the one below is not near
    pixels = pictures.pixels_of(PHOTOGRAPH)
    for wanted in range(2000, 6000, 250):
        assert len(comparison_file(pixels, "jpg", wanted)) >= 0.97 * wanted


def test_a_large_picture_is_compared_with_no_other_codec(keeping: Service) -> None:
    """A search took more than a request's 10 s of a core. Lossless WebP needs none."""
    job = keeping.accepted(saved(Image.new("1", (2001, 1500))))
    keeping.publish(job, PICTURE, better="webp", bytes=20_000)
    assert keeping.client.get(f"/jobs/{job}/comparison.webp").status_code == 200
    for kind in ("jpg", "avif"):
        assert_problem(keeping.client.get(f"/jobs/{job}/comparison.{kind}"), 422, "more than 3,000,000 pixels")
    photograph = keeping.accepted(saved(Image.new("1", (2001, 1500))))
    keeping.publish(photograph, PICTURE)
    assert_problem(keeping.client.get(f"/jobs/{photograph}/comparison.webp"), 422, "more than 3,000,000 pixels")


@pytest.mark.parametrize(
    ("query", "words"),
    [
        *((f"scale={value}", "") for value in ("0", "65", "nan", "x")),
        *((f"width={value}", "") for value in ("0", "-1", "1e3")),
        *((f"region={value}", "") for value in ("1,2,3", "-1,0,5,5", "0,0,0,0", "a,b,c,d")),
        *((f"region={value}", "not inside") for value in ("0,0,99999,1", "0,0,0,5", "0,0,0,5&width=5")),
        ("scale=1&width=5", "not both"),
        ("scale=1&height=5", "not both"),
        ("width=10&fit=crop", "needs both width and height"),
        ("quality=50", "quality does not apply"),
        ("width=65535", "width can be 1 to 3072, and height 1 to 2560"),
        ("scale=64", "exceed the limit"),
    ],
)
def test_views_that_are_refused(tight: Service, query: str, words: str) -> None:
    done = tight.published(PICTURE)
    assert_problem(tight.client.get(f"/decode/{done}.png?{query}"), 422, words)
    assert_problem(tight.client.post(f"/decode?{query}", content=PICTURE), 422, words)


def test_bodies_that_are_no_bitstream(tight: Service) -> None:
    before = tight.files()
    flipped = bytes([*PICTURE[:-1], PICTURE[-1] ^ 1])
    for body in (b"", b"SG", SMALL[: len(PICTURE)], PICTURE[:-1], flipped):
        assert_problem(tight.client.post("/decode", content=body), 422)
    assert tight.client.post("/decode", content=PICTURE).status_code == 200
    too_large = PICTURE + b"x"
    assert assert_problem(tight.client.post("/decode", content=too_large), 413)["max_bytes"] == len(PICTURE)
    assert_problem(tight.client.post("/decode", content=iter([PICTURE, b"x"])), 413)
    assert tight.files() == before


def test_a_preview_is_answered_at_once_and_decoded_from_its_text(web: Service) -> None:
    answer = web.client.post("/preview?bytes=80", content=PHOTOGRAPH)
    made = sgmethod.preview(PHOTOGRAPH, 80)
    assert (answer.status_code, answer.json()) == (200, made.to_dict())
    assert answer.headers["cache-control"] == "no-store"
    drawn = web.client.post("/decode", content=made.text.encode())
    np.testing.assert_array_equal(pixels_of(drawn), sgmethod.decode(made.data))
    assert_problem(web.client.post("/decode", content=made.text[:40].encode()), 422, "checksum")
    telephones = heif(np.zeros((8, 9, 3), np.uint8), "HEIC")
    assert web.client.post("/preview", content=telephones).json()["width"] == 9


@pytest.mark.parametrize(
    ("query", "body", "status", "words"),
    [
        ("", b"hello", 415, "not a PNG"),
        ("", b"", 422, "empty"),
        ("", PHOTOGRAPH[:-500], 422, "truncated"),
        ("", ANIMATION, 422, "more than one picture"),
        ("?bytes=11", PHOTOGRAPH, 422, "bytes"),
        ("?bytes=4097", PHOTOGRAPH, 422, "bytes"),
        ("?size=100", PHOTOGRAPH, 422, "query.size: unknown query parameter"),
        ("", bytes(200_001), 413, "larger than 200000"),
    ],
)
def test_what_gets_no_preview(web: Service, query: str, body: bytes, status: int, words: str) -> None:
    assert_problem(web.client.post(f"/preview{query}", content=body), status, words)


@pytest.mark.thorough
def test_limits_of_previews(web: Service, start_service: StartService) -> None:
    assert_problem(web.client.post("/preview", files={"image": PHOTOGRAPH}), 415, "not a form")
    large = saved(Image.new("1", (1200, 900)))
    assert_problem(web.client.post("/preview", content=large), 422, "limit is 1,000,000 pixels")
    short = start_service("web", decode_time_s=0.01)
    assert_problem(short.client.post("/preview", content=PHOTOGRAPH), 422, "time limit")


def test_a_damaged_bitstream_is_not_served(web: Service) -> None:
    """Clients would keep it for a year. Some of it could be drawn, and another whole file could be drawn, too."""
    damaged = web.published(PICTURE)
    paths = (f"/bitstreams/{damaged}.sg", f"/decode/{damaged}.png?prefix=0.5")
    other = PICTURE[:-1] + bytes([PICTURE[-1] ^ 1]), golden_path("v2-grey.sg").read_bytes()
    for file in (PICTURE[:-1], b"", *other):
        (web.data_dir / "bitstreams" / f"{damaged}.1.sg").write_bytes(file)
        for path in paths:
            before = web.log.read_text().count("its bitstream is damaged")
            assert_problem(web.client.get(path), 500, "damaged")
            assert web.log.read_text().count("its bitstream is damaged") == before + 1


def test_delete_leaves_nothing_of_a_worker_that_was_killed(empty: Service) -> None:
    job_id = empty.accepted()
    with empty.table() as table:
        for _ in range(2):
            claim = claimed(table)
            (empty.data_dir / bitstream_key(job_id, claim.attempt)).write_bytes(b"left over")
            assert table.release(claim)
    assert len(empty.files()) == 3
    assert empty.client.delete(f"/jobs/{job_id}").status_code == 204
    assert empty.files() == []
