"""Sound files that few programs write, by the specifications of their formats.

The values are those of Chromium's canvas on these files, and of libvips 8.14 where Chromium does not read a format.
"""

from __future__ import annotations

import base64
import io
import struct
import tracemalloc
import warnings
import zlib

import numpy as np
import pillow_heif
import pytest
from PIL import Image

from sgmethod.errors import ImageError, ImageWarning
from sgmethod.io.colour import MAX_PROFILE_BYTES, ProfileError, from_profile
from sgmethod.io.image import read_header, read_image_8_bit, read_input
from tests.io import profiles
from tests.io.odd_files import bmp, chunk, clap, gif, heif, mirrored, nclx, png, tiff, turned

W, H = 32, 24
Y, X = np.mgrid[0:H, 0:W]
RGB = np.stack([X * 8, Y * 10, (X + Y) * 4], -1).astype(np.uint8)
GREY, ALPHA = RGB[..., :1], (255 - Y * 10).astype(np.uint8)[..., None]
DEEP = RGB.astype(np.uint16) * 257
P3 = profiles.rgb(profiles.DISPLAY_P3)
RED, IN_P3 = (200, 80, 60), (216, 69, 50)
PLAIN = np.full((H, W, 3), RED, np.uint8)
LONG = b"x" * (3 << 20)


def read(data: bytes) -> np.ndarray:
    """The pixels as they are kept, of the size that the header says."""
    pixels = read_image_8_bit(data, keep_alpha=True)
    header = read_header(data)
    assert pixels.shape[:2] == (header.height, header.width)
    return pixels


def padded(profile: bytes, length: int) -> bytes:
    return struct.pack(">I", len(profile) + length) + profile[4:] + bytes(length)


def red_png(*before: bytes, after: tuple[bytes, ...] = ()) -> bytes:
    return png((b"\0" + bytes(RED) * W) * H, (W, H), before, after)


@pytest.mark.parametrize(
    "text",
    [
        chunk(b"tEXt", b"workflow\0" + LONG),
        chunk(b"zTXt", b"Comment\0\0" + zlib.compress(LONG)),
        chunk(b"iTXt", b"XML:com.adobe.xmp\0\1\0\0\0" + zlib.compress(LONG)),
        chunk(b"zTXt", b"Comment\0\0no zlib"),
    ],
)
def test_text_of_a_png_is_of_any_length(text: bytes) -> None:
    assert np.array_equal(read(red_png(text)), PLAIN)
    assert np.array_equal(read(red_png(after=(text,))), PLAIN)
    with pytest.raises(ImageError, match="PNG is damaged"):
        read(red_png(text[:-1] + bytes([text[-1] ^ 1])))


def test_a_profile_of_a_png_is_of_many_bytes() -> None:
    for length in (0, 2 << 20):
        iccp = chunk(b"iCCP", b"icc\0\0" + zlib.compress(padded(P3, length)))
        assert np.abs(read(red_png(iccp)).astype(int) - IN_P3).max() <= 1
    bomb = chunk(b"iCCP", b"icc\0\0" + zlib.compress(padded(P3, MAX_PROFILE_BYTES)))
    with pytest.warns(ImageWarning, match="profile is ignored: it is truncated, or larger than 16 MiB"):
        assert np.array_equal(read_image_8_bit(red_png(bomb)), PLAIN)


def test_tags_of_a_profile_may_share_their_bytes() -> None:
    """Each as long as the profile: a copy of each would take 200 MB."""
    tags, length = 4000, 132 + 12 * 4000
    table = b"".join(struct.pack(">4sII", struct.pack(">I", number), 0, length) for number in range(tags))
    profile = P3[:128] + struct.pack(">I", tags) + table
    tracemalloc.start()
    try:
        with pytest.raises(ProfileError):
            from_profile(profile, "RGB").convert(RGB, 255)
        assert tracemalloc.get_traced_memory()[1] < 20 << 20
    finally:
        tracemalloc.stop()


def test_16_bits_are_read_beside_long_text() -> None:
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in DEEP)
    text = chunk(b"zTXt", b"Comment\0\0" + zlib.compress(LONG))
    assert np.array_equal(read(png(rows, (W, H), [text], depth=16)), RGB)


def embedded(profile: bytes) -> bytes:
    where = struct.pack("<IIII", 4, 124 + PLAIN.size, len(profile), 0)
    return bmp(PLAIN, space=b"MBED", more=bytes(48) + where, behind=profile)


def test_the_profile_in_a_bmp_is_used() -> None:
    assert np.abs(read(embedded(P3)).astype(int) - IN_P3).max() <= 1
    assert np.array_equal(read(bmp(PLAIN)), PLAIN)
    assert np.array_equal(read(bmp(PLAIN, header=108, space=bytes(4))), PLAIN)  # gammas, which browsers pass over
    with pytest.warns(ImageWarning, match="profile is ignored"):
        assert np.array_equal(read_image_8_bit(embedded(b"none")), PLAIN)


@pytest.mark.parametrize(
    ("screen", "frame", "hole", "size"),
    [
        ((W, H), (8, 6, 16, 12), None, (W, H)),
        ((W, H), (8, 6, 16, 12), 3, (W, H)),
        ((10, 8), (8, 6, 16, 12), None, (24, 18)),
        ((0, 0), (0, 0, 16, 12), None, (16, 12)),
        ((W, H), (0, 0, W, H), None, (W, H)),
    ],
)
def test_nothing_is_seen_where_the_first_frame_of_a_gif_is_not(
    screen: tuple[int, int], frame: tuple[int, int, int, int], hole: int | None, size: tuple[int, int]
) -> None:
    data = gif(screen, [(*frame, 1)], hole)
    x, y, width, height = frame
    expected = np.zeros((size[1], size[0], 4), np.uint8)
    expected[y : y + height, x : x + width] = (0, 255, 0, 255)
    loaded = Image.open(io.BytesIO(data))
    loaded.load()
    for pixels in (
        read(data),
        read_input(Image.open(io.BytesIO(data)), keep_alpha=True),
        read_input(loaded, keep_alpha=True),
    ):
        if (x, y, width, height) == (0, 0, *size):
            assert np.array_equal(pixels, expected[..., :3])
        else:
            assert np.array_equal(pixels[..., 3], expected[..., 3])
            assert np.array_equal(pixels[expected[..., 3] > 0], expected[expected[..., 3] > 0])


@pytest.mark.parametrize(("order", "big"), [("<", False), (">", False), ("<", True)])
@pytest.mark.parametrize("samples", [RGB, DEEP, GREY, DEEP[..., :1]])
def test_tiffs_of_either_byte_order(samples: np.ndarray, order: str, big: bool) -> None:
    expected = np.broadcast_to(samples if samples.dtype == np.uint8 else samples >> 8, (H, W, 3))
    assert np.array_equal(read(tiff([(samples, {})], order, big=big)), expected)
    with pytest.raises(ImageError, match="a big-endian BigTIFF"):
        read(tiff([(samples, {})], ">", big=True))


@pytest.mark.parametrize("tags", [{}, {262: 0}])
def test_deep_tiffs_are_the_same_opened_by_pillow(tags: dict[int, int]) -> None:
    data = tiff([(DEEP[..., :1], tags)])
    expected = np.broadcast_to(255 - GREY if tags else GREY, (H, W, 3))
    assert np.array_equal(read(data), expected)
    with Image.open(io.BytesIO(data)) as picture:
        assert np.array_equal(read_input(picture), expected)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("kind", [0, 1, 2])
def test_alpha_of_tiffs(kind: int, grey: bool, order: str) -> None:
    """ExtraSamples: 0 need not be alpha, 1 is multiplied into the colours already, 2 is as we have it."""
    colours = GREY if grey else RGB
    data = tiff([(np.concatenate([colours, ALPHA], 2), {338: kind})], order)
    part = ALPHA.astype(int)
    unmultiplied = np.minimum(colours.astype(int) * 255 // part, 255)
    expected = {0: colours, 1: unmultiplied, 2: colours}[kind]
    pixels = read(data)
    assert np.abs(pixels[..., :3].astype(int) - np.broadcast_to(expected, RGB.shape)).max() <= (kind == 1)
    assert pixels.shape[2] == (3 if kind == 0 else 4)
    if kind > 0:
        assert np.array_equal(pixels[..., 3:], ALPHA)


@pytest.mark.parametrize("order", ["<", ">"])
def test_signed_samples_are_refused(order: str) -> None:
    eight = np.where(X < 16, -100, 100).astype(np.int8)[..., None]
    for samples in (eight, eight.astype(np.int16)):
        for read_it in (read_header, read_image_8_bit):
            with pytest.raises(ImageError, match="signed samples"):
                read_it(tiff([(samples, {339: 2})], order))
    assert np.array_equal(read(tiff([(RGB, {339: (1, 1, 1)})], order)), RGB)


@pytest.mark.parametrize(("order", "big"), [("<", False), (">", False), ("<", True)])
@pytest.mark.parametrize(
    ("others", "still"),
    [
        ([{254: 1}], True),  # a thumbnail
        ([{254: 4, 262: 4}], True),  # a mask, whose colours Pillow does not know
        ([{254: 5, 262: 4}, {254: 1}, {255: 2}], True),  # a mask of a thumbnail, a thumbnail, and one by the older tag
        ([{254: 2}], False),  # a page
        ([{}], False),
        ([{254: 1}, {254: 0}], False),
        ([{254: 1}] * 120, False),  # more than are looked at
    ],
)
def test_thumbnails_and_masks_are_no_further_pictures(
    others: list[dict[int, int]], still: bool, order: str, big: bool
) -> None:
    data = tiff([(RGB, {}), *((GREY[::4, ::4], tags) for tags in others)], order, big=big)
    assert read_header(data).still == still
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert np.array_equal(read(data), RGB)
    assert [str(one.message) for one in caught] == ["only the first of several pictures is used"] * (not still)


def test_a_chain_of_pages_that_does_not_end() -> None:
    data = bytearray(tiff([(RGB, {}), (GREY, {254: 1})]))
    (first,) = struct.unpack_from("<I", data, 4)
    data[-4:] = struct.pack("<I", first)
    assert read_header(bytes(data)).still
    data[-4:] = struct.pack("<I", 1 << 30)
    assert read_header(bytes(data)).still
    data = bytearray(tiff([(RGB, {}), (GREY, {254: 1})], big=True))
    data[-8:] = b"\xff" * 8
    assert read_header(bytes(data)).still


APERTURES = {
    "at the corner": ((16, 12, 0, 0), np.s_[0:12, 0:16]),
    "within": ((16, 12, 5, 7), np.s_[7:19, 5:21]),
    "odd": ((15, 11, 5, 7), np.s_[7:18, 5:20]),
    "all": ((W, H, 0, 0), np.s_[:, :]),
}


@pytest.mark.parametrize("kind", ["AVIF", "HEIC"])
@pytest.mark.parametrize("name", APERTURES)
def test_clean_apertures_are_applied_before_turns(name: str, kind: str) -> None:
    """libheif and libvips crop so. Chromium does where the crop is at the corner, and shows all otherwise."""
    numbers, part = APERTURES[name]
    aperture, whole = clap(*numbers, (W, H)), read(heif(RGB, kind))
    for properties, turn in {
        (aperture,): lambda a: a,
        (aperture, turned(1)): np.rot90,
        (aperture, turned(1), mirrored(1)): lambda a: np.rot90(a)[:, ::-1],
        (aperture, mirrored(0)): lambda a: a[::-1],
    }.items():
        assert np.array_equal(read(heif(RGB, kind, properties)), turn(whole[part]))


def test_alpha_is_cropped_with_its_colours() -> None:
    both = np.dstack([RGB, ALPHA])
    data = heif(both, "AVIF", [clap(16, 12, 5, 7, (W, H))])
    assert np.array_equal(read(data), read(heif(both, "AVIF"))[7:19, 5:21])


@pytest.mark.parametrize("numbers", [(40, 12, 0, 0), (16, 12, -1, 0), (16, 12, 20, 0), (0, 12, 0, 0)])
def test_apertures_that_make_no_sense_are_passed_over(numbers: tuple[int, int, int, int]) -> None:
    no_fraction = struct.pack(">I4s8I", 40, b"clap", 16, 0, 12, 1, 0, 1, 0, 1)
    for box in (clap(*numbers, (W, H)), no_fraction):
        assert read(heif(RGB, "AVIF", [box])).shape == RGB.shape


@pytest.mark.parametrize("other", [nclx(12, 13), nclx(9, 16), clap(16, 12, 5, 7, (W, H))])
@pytest.mark.parametrize("kind", ["AVIF", "HEIC"])
def test_properties_of_another_item_are_not_the_picture_s(kind: str, other: bytes) -> None:
    """A gain map has colours of its own, and they may come first."""
    assert np.array_equal(read(heif(RGB, kind, others=[other])), read(heif(RGB, kind)))


# 48 x 32 of RED by avifenc --cicp 12/13/6 and 9/16/9, the name of the box colr changed to free.
NO_COLOURS = (
    "AAAAIGZ0eXBhdmlmAAAAAGF2aWZtaWYxbWlhZk1BMUEAAADybWV0YQAAAAAAAAAoaGRscgAAAAAAAAAAcGljdAAAAAAAAAAAAAAAAGxpYmF2aWYA"
    "AAAADnBpdG0AAAAAAAEAAAAeaWxvYwAAAABEAAABAAEAAAABAAABGgAAACEAAAAoaWluZgAAAAAAAQAAABppbmZlAgAAAAABAABhdjAxQ29sb3IA"
    "AAAAamlwcnAAAABLaXBjbwAAABRpc3BlAAAAAAAAADAAAAAgAAAAEHBpeGkAAAAAAwgICAAAAAxhdjFDgSAAAAAAABNmcmVlbmNseAA"
)
STREAMS = {
    "P3": "MAA0ABoAAAAAXaXBtYQAAAAAAAAABAAEEAQKDBAAAACltZGF0EgAKCTgVL/sIYGg0gDISEUAAAECygEd5HTIYbFcgDmmg",
    "PQ": "JABAACYAAAAAXaXBtYQAAAAAAAAABAAEEAQKDBAAAACltZGF0EgAKCTgVL/sISIBMgDISEUAAAECygEhcP/IWPDcgC8ag",
}


def test_an_avif_without_a_box_of_colours_has_those_of_its_stream() -> None:
    """AV1's sequence header states them too: PQ was encoded as if it were sRGB."""
    p3, pq = (base64.b64decode(NO_COLOURS + stream) for stream in STREAMS.values())
    assert np.abs(read(p3).astype(int) - IN_P3).max() <= 3
    with pytest.raises(ImageError, match="PQ"):
        read(pq)


@pytest.mark.parametrize(("points", "out"), [((12, 13), IN_P3), ((9, 16), "PQ"), ((1, 13), RED)])
def test_a_heic_opened_by_pillow_has_its_code_points(points: tuple[int, int], out: tuple[int, ...] | str) -> None:
    pillow_heif.register_heif_opener()
    data = heif(PLAIN, "HEIC", color_primaries=points[0], transfer_characteristics=points[1], matrix_coefficients=6)
    for form in (data, Image.open(io.BytesIO(data))):
        if isinstance(out, str):
            with pytest.raises(ImageError, match=out):
                read_input(form)
        else:
            assert np.abs(read_input(form).astype(int) - out).max() <= 3
