"""The codecs that are compared: profiles of this project, and others with one quality to choose."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sgmethod import Budget, decode, encode, info

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
    """One profile of this project."""

    def __init__(self, profile: str) -> None:
        self.name = self.profile = profile

    def run(self, pixels: Pixels, max_bpp: float) -> Run:
        """As Codec.run."""
        began = time.perf_counter()
        data = encode(pixels.astype(np.float32) / np.float32(255), Budget("bpp", max_bpp), self.profile).data
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
    """libwebp, slowest method."""

    name, qualities = "webp", range(101)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().webp_encode(pixels, level=int(quality), method=6, lossless=False))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().webp_decode(data, hasalpha=False))


class Avif(Rival):
    """libavif, speed 4, 4:2:0, two threads."""

    name, qualities = "avif", range(100)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().avif_encode(pixels, level=int(quality), speed=4, pixelformat="420", numthreads=2))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().avif_decode(data))


class JpegXl(Rival):
    """libjxl, effort 7; quality = minus the distance."""

    name, qualities = "jpegxl", [-q / 20 for q in range(25 * 20, 1, -1)]

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().jpegxl_encode(pixels, distance=-quality, effort=7, lossless=False))

    def decode(self, data: bytes) -> Pixels:
        return np.asarray(imagecodecs().jpegxl_decode(data))


RIVALS = (Jpeg, Jpeg2000, WebP, Avif, JpegXl)


def imagecodecs() -> Any:
    """The package, which only --rivals needs."""
    try:
        import imagecodecs as package
    except ImportError as error:
        raise SystemExit("--rivals needs the package imagecodecs: pip install '.[benchmark]'") from error
    return package
