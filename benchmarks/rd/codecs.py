"""The codecs that are compared: profiles of this project, and others with one quality to choose."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sgmethod import Budget, decode, encode, info
from sgmethod.native import native

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class Run:
    """What a codec made of a picture [H, W, 3] within a rate."""

    data: bytes
    encode_s: float
    decode: Callable[[bytes], Pixels]
    gaussians: int | None = None


class Codec(Protocol):
    """Anything that can be compared here."""

    name: str

    def run(self, pixels: Pixels, max_bpp: float) -> Run:
        """The best file of at most max_bpp bits per pixel."""


class Sg:
    """One profile of this project, tuned for PSNR."""

    def __init__(self, profile: str) -> None:
        self.name = self.profile = profile

    def run(self, pixels: Pixels, max_bpp: float) -> Run:
        """As Codec.run."""
        began = time.perf_counter()
        data = encode(pixels, Budget("bpp", max_bpp), self.profile, tune="psnr").data
        gaussians = info(data).gaussians
        return Run(data, time.perf_counter() - began, decode, gaussians)


class Rival:
    """A codec of imagecodecs; its qualities, from the smallest file to the largest, are searched by halving."""

    name: str
    qualities: Sequence[float]

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        """A file."""
        raise NotImplementedError

    def decode(self, data: bytes) -> Pixels:
        """Its pixels."""
        raise NotImplementedError

    def run(self, pixels: Pixels, max_bpp: float) -> Run:
        """As Codec.run; the time is that of the last encode, not of the search."""
        max_bytes = max_bpp * pixels.shape[0] * pixels.shape[1] / 8
        low, high = 0, len(self.qualities)  # what `low` gives is taken, what `high` gives is too large
        while high - low > 1:
            middle = (low + high) // 2
            fits = len(self.encode(pixels, self.qualities[middle])) <= max_bytes
            low, high = (middle, high) if fits else (low, middle)
        began = time.perf_counter()
        data = self.encode(pixels, self.qualities[low])
        return Run(data, time.perf_counter() - began, self.decode)


class Jpeg(Rival):
    """libjpeg-turbo, 4:2:0, optimised Huffman tables."""

    name, qualities = "jpeg", range(1, 101)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().jpeg8_encode(pixels, level=int(quality), subsampling="420", optimize=True))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().jpeg8_decode(data))


class Jpeg2000(Rival):
    """OpenJPEG, irreversible wavelet, quality = PSNR aimed at."""

    name, qualities = "jpeg2000", [q / 20 for q in range(15 * 20, 60 * 20)]

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().jpeg2k_encode(pixels, level=quality, codecformat="j2k", reversible=False))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().jpeg2k_decode(data))


class WebP(Rival):
    """libwebp; the slowest method if not told."""

    name, qualities = "webp", range(101)

    def __init__(self, method: int = 6) -> None:
        self.method = method

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().webp_encode(pixels, level=int(quality), method=self.method, lossless=False))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().webp_decode(data, hasalpha=False))


class Avif(Rival):
    """libavif, 4:2:0, on every core; speed 4 if not told."""

    name, qualities = "avif", range(100)

    def __init__(self, speed: int = 4) -> None:
        self.settings = {"speed": speed, "pixelformat": "420", "numthreads": native.thread_count()}

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().avif_encode(pixels, level=int(quality), **self.settings))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().avif_decode(data))


class JpegXl(Rival):
    """libjxl, on every core; effort 7 if not told; quality = minus the distance."""

    name, qualities = "jpegxl", [-q / 20 for q in range(25 * 20, 1, -1)]

    def __init__(self, effort: int = 7) -> None:
        self.settings = {"effort": effort, "lossless": False, "numthreads": native.thread_count()}

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().jpegxl_encode(pixels, distance=-quality, **self.settings))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().jpegxl_decode(data))


RIVALS: tuple[Callable[[], Rival], ...] = (Jpeg, Jpeg2000, WebP, Avif, JpegXl)


def imagecodecs() -> Any:
    """The package, which only --rivals needs."""
    try:
        import imagecodecs as package
    except ImportError as error:
        raise SystemExit("--rivals needs the package imagecodecs: pip install '.[benchmark]'") from error
    return package


def versions() -> list[str]:
    """Of the libraries in the package, none where it is missing."""
    try:
        import imagecodecs as package
    except ImportError:
        return []
    wanted = ("libjpeg_turbo-", "openjpeg-", "libwebp-", "libavif-", "libjxl-")
    return [name for name in package.version().split(", ") if name.startswith(wanted)]
