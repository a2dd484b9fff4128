"""Other codecs, each with one quality to choose.

docs/notebook/comparisons.md says how their other settings were chosen. On a picture of Kodak, a second thread makes
only the decoder of JPEG XL faster, by a sixth.
"""

from __future__ import annotations

import copy
import importlib
import importlib.util
import io
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image, features

from benchmarks.pictures import Pixels
from benchmarks.rd.codecs import File
from sgmethod.io.within import last_within
from sgmethod.native import native

MIN_BPP = 0.25  # to which a picture is reduced
QUICK = 6  # the speed of AVIF at which its search begins


class Baseline:
    """Another codec. Its qualities are in the order in which files grow."""

    name: str
    qualities: Sequence[float]
    _source: Pixels | None = None  # the picture whose files around() keeps
    _kept: dict[int, File]

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        """Encode a picture [H, W, 3] at a quality."""
        raise NotImplementedError

    def decode(self, data: bytes) -> Pixels:
        """Decode a file to pixels [H, W, 3]."""
        raise NotImplementedError

    def best(self, pixels: Pixels, aim: float, near: float | None = None) -> File:
        """The best file within a rate in bits per pixel, or the smallest there is.

        The quality is searched by halving; with `near` only between what lies on both sides of it, found at distances
        that double. If it is close that saves encodes, and changes nothing.
        """
        max_bytes: float = aim * pixels.shape[0] * pixels.shape[1] / 8
        files: dict[int, File] = {}

        def size(k: int) -> int:
            files[k] = self._file(pixels, self.qualities[k])
            return len(files[k].data)

        low, high = 0, len(self.qualities)  # what `low` gives is taken, what `high` gives is too large
        if near is not None:
            low, high = _around(self.qualities.index(near), high, lambda k: size(k) <= max_bytes)
        low = last_within(size, max_bytes, low, high)
        return files.get(low) or self._file(pixels, self.qualities[low])

    def around(self, pixels: Pixels, aim: float) -> list[File]:
        """The largest file within a rate and the next one, which is not; one alone where there is no other.

        Files of a picture are kept until another one comes: rates share the first steps of their searches.
        """
        if self._source is not pixels:
            self._source, self._kept = pixels, {}
        max_bytes, count = aim * pixels.shape[0] * pixels.shape[1] / 8, len(self.qualities)

        def file(k: int) -> File:
            if k not in self._kept:
                self._kept[k] = self._file(pixels, self.qualities[k])
            return self._kept[k]

        low = last_within(lambda k: len(file(k).data), max_bytes, 0, count)
        is_last = low + 1 == count or len(file(low).data) > max_bytes
        return [file(low)] if is_last else [file(low), file(low + 1)]

    def _file(self, pixels: Pixels, quality: float) -> File:
        began = time.perf_counter()
        data = self.encode(pixels, quality)
        return File(data, time.perf_counter() - began, quality)


def _around(start: int, count: int, fits: Callable[[int], bool]) -> tuple[int, int]:
    """The last of 0 to count - 1 that is known to fit, or 0, and the first that is known not to, or count."""
    offset = 1
    if fits(start):
        while start + offset < count and fits(start + offset):
            offset *= 2
        return start + offset // 2, min(start + offset, count)
    while start - offset > 0 and not fits(start - offset):
        offset *= 2
    return max(start - offset, 0), start - offset // 2


class Jpeg(Baseline):
    """libjpeg-turbo, 4:2:0, optimised Huffman tables."""

    name, qualities = "jpeg", range(1, 101)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().jpeg8_encode(pixels, level=int(quality), subsampling="420", optimize=True))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().jpeg8_decode(data))


class MozJpeg(Jpeg):
    """mozjpeg 4.0.3: progressive, 4:2:0, trellis quantisation, and flat tables, which are best for PSNR."""

    name = "mozjpeg"

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        package("jpeglib").version.set("mozjpeg403")
        picture = package("jpeglib").from_spatial(pixels)
        picture.samp_factor = "4:2:0"
        with tempfile.TemporaryDirectory() as folder:  # it writes to files alone
            path = Path(folder) / "picture.jpg"
            picture.write_spatial(str(path), qt=int(quality), base_quant_tbl_idx=1)
            return path.read_bytes()


class Jpegli(Baseline):
    """jpegli, 4:2:0, as pyjpegli writes it."""

    name, qualities = "jpegli", range(1, 101)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        height, width = pixels.shape[:2]
        return bytes(package("pyjpegli").encode(pixels.tobytes(), width, height, int(quality)))

    def decode(self, data: bytes) -> Pixels:
        decoded, width, height = package("pyjpegli").decode(data)
        return np.frombuffer(decoded, np.uint8).reshape(height, width, 3)


class WebP(Baseline):
    """libwebp, by default with its slowest method."""

    name, qualities = "webp", [q / 10 for q in range(1001)]

    def __init__(self, method: int = 6) -> None:
        self.method = method

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().webp_encode(pixels, level=quality, method=self.method, lossless=False))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().webp_decode(data, hasalpha=False))


class Avif(Baseline):
    """libavif of Pillow, which lets callers choose the tuning; on every core, by default at speed 4."""

    qualities = range(100)
    subsampling = "4:4:4"
    advanced: dict[str, str]

    def __init__(self, speed: int = 4) -> None:
        self.settings: dict[str, Any] = {"speed": speed, "max_threads": native.thread_count()}

    def best(self, pixels: Pixels, aim: float, near: float | None = None) -> File:
        """The search begins where that of a quick speed ends."""
        if near is None and self.settings["speed"] < QUICK:
            quick = copy.copy(self)
            quick.settings = {**self.settings, "speed": QUICK}
            near = quick.best(pixels, aim).quality
        return super().best(pixels, aim, near)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        file = io.BytesIO()
        more = {"subsampling": self.subsampling, "advanced": self.advanced}
        Image.fromarray(pixels).save(file, "AVIF", quality=int(quality), **more, **self.settings)
        return file.getvalue()

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().avif_decode(data, numthreads=native.thread_count()))


class AvifForPsnr(Avif):
    """AVIF for the highest PSNR."""

    name, advanced = "avif tune=psnr", {"tune": "psnr"}


class LibvipsAvif(Avif):
    """AVIF of libvips, which can write 10 bits; 4:4:4, on every core, by default at speed 4."""

    qualities = range(1, 100)
    bits, tune = 10, "psnr"

    def __init__(self, speed: int = 4) -> None:
        self.settings = {"speed": speed}

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        wide = np.rint(pixels * (1023 / 255)).astype(np.uint16) << 6  # of 16 bits, the highest 10 are written
        values, kind = (pixels, "srgb") if self.bits == 8 else (wide, "rgb16")
        how = {"bitdepth": self.bits, "tune": self.tune, "effort": 9 - self.settings["speed"]}
        how |= {"compression": "av1", "subsample_mode": "off", "keep": "none"}  # no metadata
        picture = package("pyvips").Image.new_from_array(values, interpretation=kind)
        return bytes(picture.heifsave_buffer(Q=int(quality), **how))

    def decode(self, data: bytes) -> Pixels:
        decoded = super().decode(data)
        return decoded if self.bits == 8 else np.asarray(cv2.convertScaleAbs(decoded, alpha=255 / 1023), np.uint8)


class AvifOf10BitsForPsnr(LibvipsAvif):
    """AVIF in 10 bits for the highest PSNR."""

    name = "avif tune=psnr 10 bits"


class AvifOf10BitsForEyes(LibvipsAvif):
    """AVIF in 10 bits with the tuning that is the default of libavif and libheif: best for SSIMULACRA 2."""

    name, tune = "avif tune=iq 10 bits", "iq"


class AvifOf8BitsForEyes(LibvipsAvif):
    """The same in 8 bits: best for LPIPS and DISTS."""

    name, bits, tune = "avif tune=iq 4:4:4", 8, "iq"


class ReducedAvif(AvifForPsnr):
    """AVIF of a picture that is reduced first, as people do for few bytes: its sides by two, or by more until
    MIN_BPP bits are left for each pixel. Times include the reducing; decoding enlarges."""

    name = "avif reduced"

    def best(self, pixels: Pixels, aim: float, near: float | None = None) -> File:
        self._factor = max(2, math.ceil(math.sqrt(MIN_BPP / aim)))
        self._size = pixels.shape[1], pixels.shape[0]
        return super().best(pixels, aim, near)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        size = [max(1, side // self._factor) for side in self._size]
        return super().encode(np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8), quality)

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(cv2.resize(super().decode(data), self._size, interpolation=cv2.INTER_CUBIC), np.uint8)


class AvifForSsimulacra2(Avif):
    """AVIF tuned for SSIMULACRA 2, in 8 bits: no library that takes this tuning here writes 10."""

    name, advanced = "avif tune=ssimulacra2", {"tune": "ssimulacra2"}


class AvifWithGrain(Avif):
    """AVIF with grain that is taken out of the picture and drawn again by the decoder."""

    name, subsampling, advanced = "avif grain", "4:2:0", {"tune": "iq", "denoise-noise-level": "25"}


class Heic(Baseline):
    """libheif with x265, 4:2:0, tune=psnr, preset slow."""

    name, qualities = "heic", range(101)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        file = io.BytesIO()
        picture = package("pillow_heif").from_pillow(Image.fromarray(pixels))
        picture.save(file, quality=int(quality), chroma=420, enc_params={"tune": "psnr"})
        return file.getvalue()

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(package("pillow_heif").open_heif(data))


class JpegXl(Baseline):
    """libjxl, on every core, by default at effort 7; quality is minus the distance."""

    name, qualities = "jpegxl", [-q / 20 for q in range(25 * 20, 1, -1)]

    def __init__(self, effort: int = 7) -> None:
        self.settings = {"effort": effort, "lossless": False, "numthreads": native.thread_count()}

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().jpegxl_encode(pixels, distance=-quality, **self.settings))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().jpegxl_decode(data, numthreads=native.thread_count()))


AVIFS = (AvifForPsnr, AvifOf10BitsForPsnr, AvifOf8BitsForEyes, AvifOf10BitsForEyes)
USUAL = (Jpeg, MozJpeg, WebP, JpegXl, Heic, *AVIFS)
SELDOM = (AvifForSsimulacra2, AvifWithGrain, Jpegli)
BASELINES: dict[str, Callable[[], Baseline]] = {baseline.name: baseline for baseline in (*USUAL, *SELDOM)}
PACKAGES = ("imagecodecs", "jpeglib", "pillow_heif", "pyjpegli", "pyvips")


def package(name: str) -> Any:
    """A package that only other codecs need. Raises SystemExit where it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise SystemExit(f"other codecs need the package {name}: pip install -e '.[benchmark]'") from error


def imagecodecs() -> Any:
    """The package of most codecs."""
    return package("imagecodecs")


def versions() -> list[str]:
    """Names and versions of the libraries; none where a package is missing."""
    if not all(importlib.util.find_spec(name) for name in PACKAGES):
        return []
    wanted = ("libjpeg_turbo-", "libwebp-", "libavif-", "libjxl-")
    heif = package("pillow_heif").libheif_info()
    return [
        *(name for name in imagecodecs().version().split(", ") if name.startswith(wanted)),
        "mozjpeg-4.0.3",
        f"pyjpegli-{version('pyjpegli')}",
        f"libavif-{features.version('avif')} of Pillow",
        f"libvips-{'.'.join(str(package('pyvips').version(k)) for k in range(3))}",
        f"libheif-{heif['libheif']} ({heif['HEIF']})",
    ]
