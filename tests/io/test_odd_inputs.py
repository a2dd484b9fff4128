"""Odd inputs, one in each row: what they are, and the colour that comes out, or the words that refuse them."""

from __future__ import annotations

import contextlib
import io
import struct
import sys
import warnings
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pillow_heif
import pytest
from PIL import Image, ImageCms

from sgmethod.errors import ImageError, ImageWarning
from sgmethod.io import items
from sgmethod.io.image import read_header, read_image_8_bit
from tests.io import profiles
from tests.io.odd_files import chunk, png, tiff
from tests.io.test_image import exif_with
from tests.support import pictures
from tests.support.data import golden_path
from tests.support.pictures import photo

SIZE = (32, 24)
RED = (200, 80, 60)
PLAIN = Image.new("RGB", SIZE, RED)
OTHER = Image.new("RGB", SIZE, (10, 20, 200))
IN_P3 = (216, 69, 50)  # what RED in Display P3 is in sRGB, by Little CMS in double precision

P3 = profiles.rgb(profiles.DISPLAY_P3)
FIRST, ALPHA, PROFILE = ("first of several pictures", "transparency is composited", "colour profile is ignored")


class Odd(NamedTuple):
    """A file, and the outcome: a colour to within some levels, or words of the refusal; and words of warnings."""

    data: bytes
    out: tuple[int, int, int] | str
    warned: str = ""
    off: int = 1
    size: tuple[int, int] = SIZE


def saved(kind: str, picture: Image.Image = PLAIN, **options: object) -> bytes:
    return pictures.saved(picture, kind, **options)


def heic(picture: Image.Image = PLAIN, **options: object) -> bytes:
    file = io.BytesIO()
    pillow_heif.from_pillow(picture).save(file, format="HEIF", quality=100, **options)
    return file.getvalue()


def chunked(*chunks: bytes, depth: int = 8, colour: int = 2, sample: tuple[int, ...] = RED) -> bytes:
    """A PNG file of one colour with further chunks."""
    row = b"\0" + struct.pack(f">{len(sample)}{'BH'[depth == 16]}", *sample) * SIZE[0]
    return png(row * SIZE[1], SIZE, chunks, depth=depth, colour=colour)


def iccp(profile: bytes) -> bytes:
    return chunk(b"iCCP", b"icc\0\0" + zlib.compress(profile))


def cicp(*points: int) -> bytes:
    return chunk(b"cICP", bytes([*points, 0, 1]))


def gama(value: int) -> bytes:
    return chunk(b"gAMA", struct.pack(">I", value))


def chrm(*points: float) -> bytes:
    """The chromaticities of white, red, green and blue."""
    return chunk(b"cHRM", struct.pack(">8I", *(round(value * 100000) for value in points)))


CHRM_P3 = chrm(0.3127, 0.3290, 0.680, 0.320, 0.265, 0.690, 0.150, 0.060)


def pointed(data: bytes, primaries: int, transfer: int) -> bytes:
    """An AVIF or HEIC file with other code points."""
    at = data.index(b"colrnclx") + 8
    return data[:at] + struct.pack(">HH", primaries, transfer) + data[at + 4 :]


def qoi(pixel: bytes, linear: int = 0, cut: int = 0, width: int = SIZE[0], height: int = SIZE[1]) -> bytes:
    body = (b"\xfe" if len(pixel) == 3 else b"\xff") + pixel
    whole = b"qoif" + struct.pack(">IIBB", width, height, len(pixel), linear) + body * (SIZE[0] * SIZE[1])
    return whole[: len(whole) - cut]


def ppm(kind: int, peak: int | None, body: bytes, width: int = SIZE[0], height: int = SIZE[1]) -> bytes:
    head = f"P{kind}\n# odd\n{width} {height}\n".encode()
    return head + (b"" if peak is None else b"%d\n" % peak) + body


PIXELS = SIZE[0] * SIZE[1]
RED16 = (200 * 257, 80 * 257, 60 * 257)
PALETTE = PLAIN.quantize(4)
HOLE = Image.new("RGBA", SIZE, (*RED, 0))
HALF = Image.new("RGBA", SIZE, (0, 0, 0, 128))
SOLID = Image.new("RGBA", SIZE, (*RED, 255))
GREY = Image.new("L", SIZE, 128)
INK = Image.new("CMYK", SIZE, (255, 0, 0, 0))
CYAN, PRESS_CYAN = (0, 255, 255), (0, 156, 223)
PHOTO = Image.fromarray(photo("kodim05-crop")).resize((96, 64))
SMALL_FRAME = saved("GIF", OTHER).replace(struct.pack("<HH", *SIZE), struct.pack("<HH", 99, 77), 1)
TALL = (SIZE[1], SIZE[0])

# Made by cjxl 0.7.
JXL = {
    "plain": bytes.fromhex(
        "ff0ac5404271210012880200f8005de5120000152aa38c1bbc9cebf9f24387c5b48deb0c6db56d6149a2c838364927704812"
        "6b20ec1c5205120007ce7c1d00cf02608304c87096a101504902"
    ),
    "Display P3": bytes.fromhex("ff0ac540402637020802010068004b188b1500d413638c71e2cc05220000a469010020807cd3fb6b"),
    "PQ": bytes.fromhex(
        "ff0ac5041090478f381c00000000020802010068004b188b1500d413638c71e2cc05220000a469010020807cd3fb6b"
    ),
    "moves": bytes.fromhex(
        "ff0ac5040308282e09080208000068004b188b1500d413638c71e2cc05220000a469010020807cd3fb6b0802040068004b18"
        "8b1500d419638c19639c0b44001028b50010284004468006"
    ),
    "on its side": bytes.fromhex(
        "0000000c4a584c200d0a870a00000014667479706a786c20000000006a786c20000000306a786c63ff0ac52c10505c120802"
        "010068004b188b1500d413638c71e2cc05220000a469010020908cd3fb73"
    ),
    "grey with alpha in 16 bits": bytes.fromhex(
        "0000000c4a584c200d0a870a00000014667479706a786c20000000006a786c20000000096a786c6c0a0000002d6a786c63ff"
        "0ac5f0a3282e04080810005c004b188b158065d4ff050e00040084083d0186789091a590"
    ),
    "in boxes": bytes.fromhex(
        "0000000c4a584c200d0a870a00000014667479706a786c20000000006a786c200000002f6a786c63ff0ac540407121080201"
        "0068004b188b1500d413638c71e2cc05220000a469010020807cd3fb6b"
    ),
}

ODD = {
    # Profiles
    "jpeg in Display P3": Odd(saved("JPEG", quality=100, icc_profile=P3), IN_P3, off=2),
    "png in Display P3": Odd(saved("PNG", icc_profile=P3), IN_P3),
    "webp in Display P3": Odd(saved("WEBP", lossless=True, icc_profile=P3), IN_P3),
    "tiff in Display P3": Odd(saved("TIFF", icc_profile=P3), IN_P3),
    "avif in Display P3": Odd(saved("AVIF", quality=100, icc_profile=P3), IN_P3, off=3),
    "heic in Display P3": Odd(heic(icc_profile=P3), IN_P3, off=3),
    "palette in Display P3": Odd(saved("PNG", PALETTE, icc_profile=P3), IN_P3),
    "16 bits in Display P3": Odd(chunked(iccp(P3), depth=16, sample=RED16), IN_P3),
    "transparent in Display P3": Odd(saved("PNG", HOLE, icc_profile=P3), (255, 255, 255), ALPHA),
    "opaque alpha in Display P3": Odd(saved("PNG", SOLID, icc_profile=P3), IN_P3),
    "jpeg in sRGB": Odd(saved("PNG", icc_profile=profiles.rgb(profiles.SRGB)), RED, off=0),
    "grey with a profile of RGB": Odd(saved("PNG", GREY, icc_profile=P3), (128, 128, 128)),
    "grey of gamma 1.8": Odd(saved("PNG", GREY, icc_profile=profiles.grey(profiles.gamma(1.8))), (147, 147, 147)),
    "tables": Odd(saved("PNG", icc_profile=profiles.rgb_by_table()), (105, 105, 105)),
    "tables and 16 bits": Odd(chunked(iccp(profiles.rgb_by_table()), depth=16, sample=RED16), (105, 105, 105)),
    "CMYK tiff with its profile": Odd(saved("TIFF", INK, icc_profile=profiles.cmyk()), PRESS_CYAN),
    "CMYK jpeg with its profile": Odd(saved("JPEG", INK, quality=100, icc_profile=profiles.cmyk()), PRESS_CYAN),
    "CMYK without a profile": Odd(saved("TIFF", INK), CYAN),
    "CMYK with a profile of RGB": Odd(saved("TIFF", INK, icc_profile=P3), CYAN, PROFILE),
    "RGB with a profile of CMYK": Odd(saved("PNG", icc_profile=profiles.cmyk()), RED, PROFILE),
    "a profile that is none": Odd(saved("PNG", icc_profile=b"not a profile"), RED, PROFILE),
    "a profile cut short": Odd(saved("PNG", icc_profile=P3[:200]), RED, PROFILE),
    "a profile of damaged zlib": Odd(chunked(chunk(b"iCCP", b"icc\0\0" + b"damaged")), RED, PROFILE),
    "a table cut short": Odd(saved("PNG", icc_profile=profiles.cmyk()[:900]), RED, PROFILE),
    "a profile of one colour": Odd(saved("PNG", icc_profile=profiles.rgb(((0, 0, 0),) * 3)), RED, PROFILE),
    "a profile of gamma 0": Odd(saved("PNG", icc_profile=profiles.rgb(profiles.SRGB, profiles.gamma(0))), RED, PROFILE),
    "a curve of an unknown kind": Odd(
        saved("PNG", icc_profile=profiles.rgb(profiles.SRGB, b"what" + bytes(20))), RED, PROFILE
    ),
    "a profile for PQ": Odd(
        saved("PNG", icc_profile=profiles.rgb(profiles.SRGB, cicp=b"cicp\0\0\0\0" + bytes([9, 16, 0, 1]))), "range (PQ)"
    ),
    # What PNG states, in its order of precedence
    "cICP of Display P3": Odd(chunked(cicp(12, 13)), IN_P3),
    "cICP before a profile": Odd(chunked(cicp(1, 13), iccp(P3)), RED, off=0),
    "cICP for PQ": Odd(chunked(cicp(9, 16)), "range (PQ)"),
    "cICP for HLG": Odd(chunked(cicp(9, 18)), "range (HLG)"),
    "cICP of unknown points": Odd(chunked(cicp(77, 13)), RED, PROFILE, 0),
    "a profile before sRGB": Odd(chunked(iccp(P3), chunk(b"sRGB", b"\0")), IN_P3),
    "sRGB before gAMA": Odd(chunked(chunk(b"sRGB", b"\0"), gama(100000)), RED, off=0),
    "gAMA of light": Odd(chunked(gama(100000), sample=(55, 55, 55)), (128, 128, 128)),
    "gAMA of sRGB": Odd(chunked(gama(45455)), RED, off=0),
    "gAMA of old Macs": Odd(chunked(gama(55556), colour=0, sample=(128,)), (147, 147, 147)),
    "gAMA of nothing": Odd(chunked(gama(0)), RED, PROFILE, 0),
    "cHRM of Display P3": Odd(chunked(gama(45455), CHRM_P3), IN_P3),
    "cHRM of nothing": Odd(chunked(gama(45455), chrm(*[0] * 8)), RED, PROFILE, 0),
    # Code points of AVIF and HEIC
    "avif, Display P3 by code points": Odd(pointed(saved("AVIF", quality=100), 12, 13), IN_P3, off=3),
    "avif in PQ": Odd(pointed(saved("AVIF"), 9, 16), "range (PQ)"),
    "heic in HLG": Odd(pointed(heic(), 9, 18), "range (HLG)"),
    # Depths and modes
    "jpeg xl": Odd(JXL["plain"], RED, off=3),
    "jpeg xl in boxes": Odd(JXL["in boxes"], RED, off=0),
    "jpeg xl in Display P3": Odd(JXL["Display P3"], IN_P3),
    "jpeg xl in PQ": Odd(JXL["PQ"], "range (PQ)"),
    "jpeg xl of grey with alpha in 16 bits": Odd(JXL["grey with alpha in 16 bits"], "with more than 8 bits"),
    "grey with alpha in 16 bits": Odd(chunked(depth=16, colour=4, sample=(0, 0x8000)), (127, 127, 127), ALPHA),
    "half transparent": Odd(saved("PNG", HALF), (127, 127, 127), ALPHA),
    "webp with a hole": Odd(saved("WEBP", HOLE, lossless=True, exact=True), (255, 255, 255), ALPHA),
    "avif with a hole": Odd(saved("AVIF", HOLE, quality=100), (255, 255, 255), ALPHA),
    "heic with a hole": Odd(heic(HOLE), (255, 255, 255), ALPHA),
    "LAB": Odd(saved("TIFF", Image.new("LAB", SIZE, (255, 128, 128))), (255, 255, 255), off=2),
    "YCbCr": Odd(saved("TIFF", PLAIN.convert("YCbCr")), RED, off=2),
    "floats": Odd(saved("TIFF", Image.new("F", SIZE)), "floats"),
    "pbm": Odd(ppm(4, None, bytes(SIZE[0] // 8) * SIZE[1]), (255, 255, 255), off=0),
    "pgm of text": Odd(ppm(2, 100, b"50 " * PIXELS), (128, 128, 128)),
    "pgm in 16 bits": Odd(ppm(5, 65535, b"\x80\x80" * PIXELS), (128, 128, 128), off=0),
    "ppm in 16 bits": Odd(ppm(6, 65535, struct.pack(">3H", *RED16) * PIXELS), RED, off=0),
    "qoi that says light": Odd(qoi(bytes(RED), linear=1), RED, off=0),
    "qoi with alpha": Odd(qoi(bytes([0, 0, 0, 128])), (127, 127, 127), ALPHA),
    "gif with a hole": Odd(saved("GIF", HOLE), (255, 255, 255), ALPHA),
    # Orientations
    "avif on its side": Odd(saved("AVIF", quality=100, exif=exif_with(6)), RED, off=3, size=TALL),
    "heic on its side": Odd(heic(PLAIN, exif=exif_with(8)), RED, off=3, size=TALL),
    "jpeg xl on its side": Odd(JXL["on its side"], RED, off=3, size=TALL),
    # More than one picture
    "gif that moves": Odd(saved("GIF", save_all=True, append_images=[OTHER]), RED, FIRST, 0),
    "gif that is cut in its second frame": Odd(saved("GIF", save_all=True, append_images=[OTHER])[:-30], RED, FIRST, 0),
    "gif of a small first frame": Odd(SMALL_FRAME, (255, 255, 255), ALPHA, 255, (99, 77)),
    "webp that moves": Odd(saved("WEBP", save_all=True, append_images=[OTHER], lossless=True), RED, FIRST, 0),
    "apng": Odd(saved("PNG", save_all=True, append_images=[OTHER]), RED, FIRST, 0),
    "avif that moves": Odd(saved("AVIF", save_all=True, append_images=[OTHER], quality=100), RED, FIRST, 3),
    "jpeg xl that moves": Odd(JXL["moves"], "animated JPEG XL"),
    "tiff of two pages": Odd(saved("TIFF", save_all=True, append_images=[OTHER]), RED, FIRST, 0),
    "jpeg with a second picture": Odd(saved("MPO", save_all=True, append_images=[OTHER], quality=100), RED, off=2),
    # Broken ones
    "nothing": Odd(b"", "empty"),
    "words": Odd(b"hello", "not a PNG, JPEG"),
    "an .sg file": Odd(golden_path("v2-color.sg").read_bytes(), "an .sg file already"),
    "an .sg file of a later version": Odd(b"\xd3\xc3" + bytes(50), "an .sg file already"),
    "a jpeg xl of zeros": Odd(b"\xff\x0a" + bytes(50), "the JPEG XL is damaged"),
    "half a jpeg xl": Odd(JXL["plain"][:38], "the JPEG XL is damaged, truncated"),
    "a jpeg xl without its last box": Odd(JXL["in boxes"][:40], "the JPEG XL is damaged, truncated"),
    "a huge jpeg xl": Odd(b"\xff\x0a" + (0b11 << 1 | 0xFFFFF << 3).to_bytes(5, "little") + bytes(9), "too large"),
    "a header of jpeg xl": Odd(b"\xff\x0a" + bytes(3), "the JPEG XL is damaged, truncated"),
    "half a png": Odd(saved("PNG", PHOTO)[:2000], "the PNG is damaged, truncated"),
    "half a pgm of text": Odd(ppm(2, 100, b"50 " * (PIXELS // 2)), "damaged, truncated"),
    "a header alone": Odd(b"GIF89a", "damaged, truncated"),
    "a huge gif": Odd(saved("GIF").replace(struct.pack("<HH", *SIZE), b"\xff\xff\xff\xff", 1), "too large"),
    "a huge ppm": Odd(ppm(6, 255, b"", 10**9, 10**9), "too large"),
    "a huge qoi": Odd(qoi(bytes(RED), width=2**31, height=2**31), "too large"),
    "a huge avif": Odd(saved("AVIF").replace(struct.pack(">II", *SIZE), b"\xff\xff\xff\xff" * 2), "damaged, truncated"),
    "an empty ppm": Odd(ppm(6, 255, b"", 0, 5), "damaged, truncated"),
    "a thumbnail in a raw file": Odd(tiff([(np.zeros((1, 4, 1), np.uint8), {254: 1})]), "thumbnail"),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_inputs(name: str) -> None:
    odd = ODD[name]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if isinstance(odd.out, str):
            with pytest.raises(ImageError) as refused:
                read_image_8_bit(odd.data)
            assert odd.out in str(refused.value)
            assert "\n" not in str(refused.value)
            return
        pixels = read_image_8_bit(odd.data)
    assert [warning.category for warning in caught] == [ImageWarning] * bool(odd.warned)
    assert odd.warned in "".join(str(warning.message) for warning in caught)
    assert pixels.shape == (odd.size[1], odd.size[0], 3)
    assert (read_header(odd.data).width, read_header(odd.data).height) == odd.size
    assert np.abs(pixels.astype(int) - odd.out).max() <= odd.off


def test_conversions_are_little_cms_own() -> None:
    pixels = np.random.default_rng(5).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    picture = Image.fromarray(pixels)
    linear_table = profiles.table(*np.linspace(0, 1, 1024) ** 2.2)
    for profile in (
        P3,
        profiles.rgb(profiles.ADOBE_RGB, profiles.gamma(563 / 256)),
        profiles.rgb(profiles.PROPHOTO, profiles.gamma(1.8)),
        profiles.rgb(profiles.DISPLAY_P3, linear_table),
        *(profiles.rgb(profiles.SRGB, profiles.parametric(kind, *curve)) for kind, curve in CURVES.items()),
    ):
        transform = ImageCms.buildTransform(
            ImageCms.ImageCmsProfile(io.BytesIO(profile)),
            ImageCms.createProfile("sRGB"),
            "RGB",
            "RGB",
            ImageCms.Intent.RELATIVE_COLORIMETRIC,
            ImageCms.Flags.NOOPTIMIZE,
        )
        expected = np.asarray(transform.apply(picture)).astype(int)
        found = read_image_8_bit(saved("PNG", picture, icc_profile=profile))
        assert np.abs(found - expected).max() <= 1
        assert not np.array_equal(found, pixels)


CURVES = {
    0: (2.6,),
    1: (1.9, 0.9, 0.1),
    2: (1.9, 0.9, 0.1, 0.02),
    3: (2.0, 0.95, 0.05, 0.2, 0.1),
    4: (2.0, 0.9, 0.05, 0.3, 0.1, 0.01, 0.0),
}


def test_code_points_of_a_file_cut_anywhere() -> None:
    data = pointed(saved("AVIF"), 12, 13)
    assert items.code_points(data) == (12, 13)
    for end in range(len(data)):
        with contextlib.suppress(ValueError):
            assert items.code_points(data[:end]) in (None, (12, 13))


def test_16_bits_are_rounded_after_the_conversion() -> None:
    """The darkest of linear light, of 8 bits 0 and 1, are 14 levels of sRGB."""
    row = b"\0" + struct.pack(">257H", *range(257))
    profile = iccp(profiles.grey(profiles.gamma(1)))
    pixels = read_image_8_bit(png(row, (257, 1), [profile], depth=16, colour=0))
    assert np.unique(pixels).tolist() == list(range(14))


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(ImageError, match=r"reading HEIC files needs a package \(.*\): pip install 'sgmethod\[heif\]'"):
        read_image_8_bit(heic())


def test_a_package_that_cannot_be_loaded_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one of another system. It was called missing."""
    data = heic()
    (tmp_path / "pillow_heif.py").write_text("raise ImportError('libheif.so.1: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pillow_heif", raising=False)
    with pytest.raises(ImageError, match=r"needs a package \(libheif\.so\.1: cannot open shared object file\): pip "):
        read_image_8_bit(data)
