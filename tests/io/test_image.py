"""Every rule of sgmethod/io/image.py, on files made here."""

from __future__ import annotations

import io
import struct
import time
from itertools import chain
from unittest.mock import Mock

import numpy as np
import pillow_heif
import pytest
from hypothesis import example, given, strategies as st
from PIL import Image

from sgmethod.errors import ImageError
from sgmethod.io.formats import FORMATS
from sgmethod.io.image import ImageHeader, ImageLimits, read_header, read_image_8_bit, read_input
from tests.io.odd_files import chunk, png, tiff
from tests.support import pictures
from tests.support.pictures import photo

pillow_heif.register_heif_opener()
PIXELS = np.ascontiguousarray(photo("kodim05-crop")[30:62, 20:68])
PHOTO = Image.fromarray(PIXELS)
SEE_THROUGH = pytest.mark.filterwarnings("ignore:transparency is composited over white:sgmethod.ImageWarning")
ROUNDED = 0.501  # levels, worst seen 0.4999; in single precision what lies beside a half may go to the other side


def saved(kind: str, picture: Image.Image = PHOTO, **options: object) -> bytes:
    return pictures.saved(picture, kind, **options)


def png_of(samples: np.ndarray, colour: int, *before: bytes, after: tuple[bytes, ...] = ()) -> bytes:
    """A PNG file of uint8 or uint16 samples [H, W, C], with whole chunks before and after the pixels."""
    height, width, _ = samples.shape
    rows = b"".join(b"\0" + row.astype(samples.dtype.newbyteorder(">")).tobytes() for row in samples)
    return png(rows, (width, height), before, after, depth=8 * samples.dtype.itemsize, colour=colour)


def grey_tiff(width: int, height: int, **tags: int) -> bytes:
    """A TIFF file of zeros; tags are named t<number> and override the usual ones."""
    return tiff([(np.zeros((height, width, 1), np.uint8), {int(name[1:]): value for name, value in tags.items()})])


def bmp(width: int, height: int, body: bytes = b"") -> bytes:
    info = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, 0, 0, 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54 + len(body), 0, 0, 54) + info + body


def grey_to_rgb(grey: np.ndarray) -> np.ndarray:
    return np.repeat(grey[..., None], 3, axis=2)


def off(data: bytes, expected: object) -> float:
    """The largest error in levels of a file's picture, of which the values in [0, 1] are known."""
    return float(np.abs(read_image_8_bit(data) - 255 * np.asarray(expected)).max())


def exif_with(orientation: int) -> bytes:
    exif = Image.Exif()
    exif[274] = orientation
    return exif.tobytes()


RGB16 = PIXELS.astype(np.uint16) << 8 | 255 - PIXELS  # which level is nearest depends on both bytes
KINDS = {
    "png": saved("PNG"),
    "png16": png_of(RGB16, 2),
    "jpeg": saved("JPEG", quality=90),
    "jpeg-progressive": saved("JPEG", quality=90, progressive=True),
    "webp": saved("WEBP", quality=90),
    "webp-lossless": saved("WEBP", lossless=True),
    "webp-exif": saved("WEBP", exif=exif_with(1)),
    "tiff": saved("TIFF"),
    "tiff16": tiff([(RGB16, {})]),
    "tiff-lzw": saved("TIFF", compression="tiff_lzw"),
    "tiff-deflate": saved("TIFF", compression="tiff_adobe_deflate"),
    "tiff-jpeg": saved("TIFF", compression="jpeg"),
    "bmp": saved("BMP"),
    "gif": saved("GIF", PHOTO.quantize(64)),
    "avif": saved("AVIF", quality=90),
    "heic": saved("HEIF", quality=90),
    "ppm": saved("PPM"),
    "qoi": saved("QOI"),
    "bmp-palette": saved("BMP", PHOTO.quantize(64)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_reads_every_format(kind: str) -> None:
    header, pixels = read_header(KINDS[kind]), read_image_8_bit(KINDS[kind])
    assert header.format.lower() == kind.partition("-")[0].removesuffix("16")
    assert kind != "png" or header == ImageHeader("PNG", 48, 32)
    assert (header.width, header.height) == (48, 32)
    assert (pixels.shape, pixels.dtype, pixels.flags.c_contiguous) == ((32, 48, 3), np.uint8, True)
    tolerance = 12 if "jpeg" in kind or kind in ("webp", "webp-exif", "bmp-palette", "gif", "avif", "heic") else 0.5
    wanted = RGB16 / 257 if "16" in kind else PIXELS.astype(int)
    assert np.abs(pixels - wanted).mean() < tolerance


def test_every_format_is_tried() -> None:
    """JPEG XL elsewhere: Pillow does not write it."""
    assert {*FORMATS} == {read_header(data).format for data in KINDS.values()} | {"JPEG XL"}


@SEE_THROUGH
def test_pixels_are_contiguous() -> None:
    rgba = np.dstack([PIXELS, PIXELS[..., :1]])
    others = [png_of(rgba, 6), *(png_of(grey, 0) for grey in (PIXELS[..., :1], RGB16[..., :1]))]
    for data in (*others, saved("JPEG", exif=exif_with(6)), saved("PNG", PHOTO.quantize(64))):
        found = read_image_8_bit(data)
        assert (found.shape[2], found.dtype, found.flags.c_contiguous) == (3, np.uint8, True)
    for array in (PIXELS, PIXELS / 255, PIXELS[:, ::-1]):
        found = read_input(array)
        assert np.array_equal(found, PIXELS[:, ::-1] if array.strides[1] < 0 else PIXELS)
        assert found.flags.c_contiguous


@pytest.mark.parametrize("kind", KINDS)
def test_the_header_is_read_without_pixels(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for known in FORMATS.values():
        monkeypatch.setattr(f"{'.'.join(known.reader)}.load", Mock(side_effect=AssertionError("decodes pixels")))
    assert read_header(KINDS[kind]).width == 48
    with pytest.raises(ImageError, match="decodes pixels"):
        read_image_8_bit(KINDS[kind])


TURNS = {
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: np.rot90(a, 2),
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: np.rot90(a, -1),
    7: lambda a: np.rot90(a, 2).swapaxes(0, 1),
    8: np.rot90,
}


@pytest.mark.parametrize("orientation", TURNS)
@pytest.mark.parametrize("kind", ["jpeg", "webp", "png", "png-behind-pixels", "tiff", "tiff16"])
def test_orientation_is_applied(kind: str, orientation: int) -> None:
    exif = exif_with(orientation)
    data = {
        "jpeg": lambda: saved("JPEG", quality=90, exif=exif),
        "webp": lambda: saved("WEBP", quality=90, exif=exif),
        "png": lambda: saved("PNG", exif=exif),
        "png-behind-pixels": lambda: png_of(PIXELS, 2, after=(chunk(b"eXIf", exif.removeprefix(b"Exif\0\0")),)),
        "tiff": lambda: saved("TIFF", compression="tiff_lzw", tiffinfo={274: orientation}),
        "tiff16": lambda: tiff([(RGB16, {274: orientation})]),
    }[kind]()
    plain = KINDS["png" if kind == "png-behind-pixels" else "tiff" if kind == "tiff" else kind]
    expected = TURNS[orientation](read_image_8_bit(plain))
    assert np.array_equal(read_image_8_bit(data), expected)
    header = read_header(data)
    assert (header.height, header.width) == expected.shape[:2]


@pytest.mark.parametrize("exif", [b"", b"x", b"Exif\0\0II*\0\xff\xff\xff\xff", exif_with(0), exif_with(99)])
def test_unusable_exif_counts_as_absent(exif: bytes) -> None:
    behind = png_of(PIXELS, 2, after=(chunk(b"eXIf", exif),))
    assert np.array_equal(read_image_8_bit(behind), read_image_8_bit(KINDS["png"]))
    jpeg = saved("JPEG", quality=90, exif=b"Exif\0\0" + exif)
    assert np.array_equal(read_image_8_bit(jpeg), read_image_8_bit(KINDS["jpeg"]))


def test_grey_palette_and_bilevel() -> None:
    grey = PHOTO.convert("L")
    for kind in ("PNG", "TIFF", "BMP"):
        assert np.array_equal(read_image_8_bit(saved(kind, grey)), grey_to_rgb(np.asarray(grey)))
        palette = PHOTO.quantize(16)
        assert np.array_equal(read_image_8_bit(saved(kind, palette)), np.asarray(palette.convert("RGB")))
        bilevel = PHOTO.convert("1")
        assert np.array_equal(read_image_8_bit(saved(kind, bilevel)), grey_to_rgb(255 * np.asarray(bilevel)))
    assert np.ptp(read_image_8_bit(saved("JPEG", grey)), axis=2).max() == 0


def test_16_bit_samples_are_rounded() -> None:
    rounded = np.round(RGB16 / 257)
    grey = grey_to_rgb(rounded[..., 0])
    assert np.any(rounded != RGB16 >> 8)
    for order in "<>":
        assert np.array_equal(read_image_8_bit(tiff([(RGB16, {})], order)), rounded)
        assert np.array_equal(read_image_8_bit(tiff([(RGB16[..., :1], {})], order)), grey)
    assert np.array_equal(read_image_8_bit(tiff([(65535 - RGB16[..., :1], {262: 0})])), grey)
    assert np.array_equal(read_image_8_bit(png_of(RGB16, 2)), rounded)
    assert np.array_equal(read_image_8_bit(png_of(RGB16[..., :1], 0)), grey)


def test_12_bit_grey_reaches_white() -> None:
    body = np.frombuffer(b"\x00\x0f\xff\xc9\x40\x00", np.uint8)  # 0x000, 0xfff, 0xc94, 0x000
    data = tiff([(body.reshape(1, 6, 1), {256: 4, 258: 12})])
    assert read_image_8_bit(data)[0, :, 0].tolist() == [0, 255, 201, 0]  # 200 if white were 0x1000


@SEE_THROUGH
def test_transparency_is_composited_over_white() -> None:
    alpha = np.linspace(0, 65535, 48 * 32).reshape(32, 48, 1).round().astype(np.uint16)
    part = alpha / 65535
    deep = png_of(np.dstack([RGB16, alpha]), 6)
    assert off(deep, RGB16 / 65535 * part + 1 - part) < ROUNDED
    alpha8 = (alpha >> 8).astype(np.uint8)
    expected = PIXELS / 255 * (alpha8 / 255) + 1 - alpha8 / 255
    rgba = Image.fromarray(np.dstack([PIXELS, alpha8]))
    for data in (saved("PNG", rgba), saved("TIFF", rgba), saved("WEBP", rgba, lossless=True, exact=True)):
        assert off(data, expected) < ROUNDED
    grey = PIXELS[..., :1] / 255 * (alpha8 / 255) + 1 - alpha8 / 255
    assert off(png_of(np.dstack([PIXELS[..., :1], alpha8]), 4), grey) < ROUNDED


@SEE_THROUGH
@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_transparent_grey_of_any_depth(depth: int) -> None:
    """One row of three samples 1, 0, 1. Bits of the transparent colour above the depth are ignored."""
    bits = "".join(format(value, f"0{depth}b") for value in (1, 0, 1)).ljust(48, "0")
    row = b"\0" + bytes(int(bits[i : i + 8], 2) for i in range(0, -(-3 * depth // 8) * 8, 8))
    excess = (0xFFFF << depth) & 0xFFFF
    for key in (1, excess | 1, excess):
        transparent = [value == key & 1 for value in (1, 0, 1)]
        file = png(row, (3, 1), [chunk(b"tRNS", struct.pack(">H", key))], depth=depth, colour=0)
        assert (read_image_8_bit(file, keep_alpha=True)[0, :, 3] == 0).tolist() == transparent


@SEE_THROUGH
def test_transparent_colour_with_excess_bits_in_a_pillow_image() -> None:
    file = png_of(PIXELS, 2, chunk(b"tRNS", struct.pack(">3H", *(256 + PIXELS[3, 5].astype(int)))))
    expected = np.all(PIXELS[3, 5] == PIXELS, axis=2)
    for image in (file, Image.open(io.BytesIO(file))):
        assert np.array_equal(read_input(image, keep_alpha=True)[..., 3] == 0, expected)


@SEE_THROUGH
def test_transparent_colour_and_palette() -> None:
    key = chunk(b"tRNS", struct.pack(">3H", *RGB16[3, 5]))
    expected = RGB16 / 65535
    expected[np.all(RGB16[3, 5] == RGB16, axis=2)] = 1
    assert off(png_of(RGB16, 2, key), expected) < ROUNDED
    palette = chunk(b"PLTE", bytes([255, 0, 0, 0, 0, 255]))
    for alpha, red in (([51, 255], (1, 0.8, 0.8)), ([0], (1, 1, 1))):
        row = png(b"\0\0\1", (2, 1), [palette, chunk(b"tRNS", bytes(alpha))], colour=3)
        assert off(row, [[red, (0, 0, 1)]]) < ROUNDED


SIZE_IN_JPEG = struct.pack(">HH", 32, 48)
REFUSED = {
    "32-bit samples": saved("TIFF", PHOTO.convert("I")),
    "strips for a part of the rows": grey_tiff(4, 9, t278=3),
    "16-bit channels apart": tiff([(RGB16, {284: 2})]),
    "png without pixels": png(b"", (4, 4)).replace(b"IDAT", b"idAT"),
    "zero width": png(b"", (0, 4)),
    "zero height bmp": bmp(4, 0),
    "zero size tiff": grey_tiff(0, 0),
    "zero size jpeg": KINDS["jpeg"].replace(SIZE_IN_JPEG, bytes(4)),
    "huge png": png(b"", (4_000_000_000, 4_000_000_000)),
    "huge tiff": grey_tiff(0, 0, t256=4_000_000_000, t257=4_000_000_000),
    "huge tiff, compressed": grey_tiff(9, 11, t256=60_000, t257=60_000, t259=5, t278=60_000),
    "huge jpeg": KINDS["jpeg"].replace(SIZE_IN_JPEG, b"\xff\xff\xff\xff"),
    "huge webp": saved("WEBP", exif=exif_with(6)).replace(bytes([47, 0, 0, 31, 0, 0]), b"\xff\xff\0\xff\xff\0"),
    "huge bmp": bmp(2_000_000_000, 2_000_000_000),
    "negative width": bmp(-48, 32, bytes(4608)),
    "most negative": bmp(-(2**31), -(2**31)),
    "long side": png(bytes(65_537), (65_536, 1), colour=0),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence_before_pixels(name: str) -> None:
    for read in (read_header, read_image_8_bit):
        began = time.process_time()
        with pytest.raises(ImageError) as caught:
            read(REFUSED[name])
        assert time.process_time() - began < 1
        assert 10 < len(str(caught.value)) < 200
        assert "\n" not in str(caught.value)
    if ("huge" in name and "webp" not in name) or name == "long side":  # old Pillows fail to allocate a WebP
        assert "large" in str(caught.value)


def test_top_down_bmp_is_no_negative_size() -> None:
    assert np.array_equal(read_image_8_bit(bmp(48, -32, PIXELS[..., ::-1].tobytes())), read_image_8_bit(KINDS["png"]))


def test_limits_are_the_callers() -> None:
    data = KINDS["jpeg"]
    assert read_header(data, ImageLimits(max_pixels=48 * 32)).width == 48
    for read in (read_header, read_image_8_bit):
        with pytest.raises(ImageError, match="too large"):
            read(data, ImageLimits(max_pixels=48 * 32 - 1))


@pytest.mark.parametrize("kind", KINDS)
def test_truncation_is_refused_or_harmless(kind: str) -> None:
    """A file cut short is refused, or the cut took only what stands behind the pixels."""
    data = KINDS[kind]
    wholes = {read: read(data) for read in (read_header, read_image_8_bit)}
    for length in chain(range(0, len(data), len(data) // 60 + 1), range(len(data) - 30, len(data))):
        for read, whole in wholes.items():
            try:
                result = read(data[:length])
            except ImageError:
                continue
            assert np.array_equal(result, whole)


@pytest.mark.filterwarnings("ignore::sgmethod.ImageWarning")
@given(st.sampled_from(sorted(KINDS)), st.lists(st.tuples(st.floats(0, 1), st.integers(0, 7)), min_size=1))
@example("heic", [(0.2061100410630266, 2)])  # a crop by one row
def test_flipped_bits_raise_only_image_errors(kind: str, flips: list[tuple[float, int]]) -> None:
    data = bytearray(KINDS[kind])
    for place, bit in flips:
        data[min(int(place * len(data)), len(data) - 1)] ^= 1 << bit
    limits = ImageLimits(max_pixels=1_000_000)
    try:
        header = read_header(bytes(data), limits)
        pixels = read_image_8_bit(bytes(data), limits)
    except ImageError:
        return
    assert pixels.shape == (header.height, header.width, 3)
    if kind.startswith("png") and bytes(data) != KINDS[kind]:
        assert np.array_equal(pixels, read_image_8_bit(KINDS[kind]))
