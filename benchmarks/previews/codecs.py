"""Codecs at a few hundred bytes: each makes its best file of a picture that is reduced first.

Other codecs try every factor of FACTORS and take the one with the highest PSNR, enlarged bicubically. BlurHash has as
many components as its text has room for. Bytes are those of whole files, headers included; of BlurHash, whose text is
no base64, 3 for 4 characters.
"""

from __future__ import annotations

import base64
import json
import math
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

import sgmethod
from benchmarks.pictures import Pixels
from benchmarks.rd.baselines import AvifOf10BitsForPsnr, Baseline, Jpeg, JpegXl, WebP, package
from sgmethod.bitstream.text import from_text, to_text
from sgmethod.metrics import psnr

FACTORS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
BPP = 0.1, 4.0  # of a reduced picture: beyond these, another factor is better
MAX_COMPONENTS = 9  # of BlurHash, along each side
ENCODER = Path(sgmethod.__file__).parent / "javascript" / "src" / "encoder" / "encoder.js"
ENCODE = """
const [encoder, width, height, bytes] = process.argv.slice(1);
const { encodePreview } = await import(encoder);
const rgba = (await import("node:fs")).readFileSync(0);
const began = process.cpuUsage();
const { text } = encodePreview(rgba, +width, +height, { bytes: +bytes });
const { user, system } = process.cpuUsage(began);
console.log(JSON.stringify({ text, seconds: (user + system) / 1e6 }));
"""
HASHED_SIDE, BLURRED_SIDE = 100, 64  # pixels to which pictures are reduced: the most that ThumbHash takes; plenty


@dataclass(frozen=True)
class Made:
    """A file, or its bytes; text: characters in a page, in base64; encode_s: seconds of processor time; decode: to
    pixels of the picture's size."""

    bytes: int
    text: int
    encode_s: float
    decode: Callable[[], Pixels]


def resized(pixels: Pixels, width: int, height: int) -> Pixels:
    """Resize by averages where a picture becomes smaller, else bicubically."""
    method = cv2.INTER_AREA if width < pixels.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=method), np.uint8)


def reduced(pixels: Pixels, side: int) -> Pixels:
    """Reduce a picture to at most `side` pixels along either side."""
    height, width = pixels.shape[:2]
    scale = min(side / max(width, height), 1)
    return resized(pixels, max(round(scale * width), 1), max(round(scale * height), 1))


def sg(pixels: Pixels, max_bytes: int) -> Made:
    """This project's preview."""
    began = time.process_time()
    made = sgmethod.preview(pixels, max_bytes)
    return _of_file(made.data, time.process_time() - began, pixels)


def sg_in_javascript(pixels: Pixels, max_bytes: int) -> Made:
    """The npm package's preview, by Node in a process of its own."""
    height, width = pixels.shape[:2]
    rgba = np.dstack([pixels, np.full((height, width), 255, np.uint8)]).tobytes()
    command = ["node", "--input-type=module", "--eval", ENCODE, str(ENCODER), str(width), str(height), str(max_bytes)]
    found = json.loads(subprocess.run(command, input=rgba, capture_output=True, check=True).stdout)
    return _of_file(from_text(found["text"]), found["seconds"], pixels)


def _of_file(data: bytes, took_s: float, pixels: Pixels) -> Made:
    height, width = pixels.shape[:2]

    def decode() -> Pixels:
        file = sgmethod.open(data)
        drawn = file.pixels(scale=width / file.size[0])
        return drawn if drawn.shape == pixels.shape else resized(drawn, width, height)

    return Made(len(data), len(to_text(data)), took_s, decode)


def blurhash(pixels: Pixels, max_bytes: int) -> Made | None:
    """BlurHash, of a colour to begin with and two characters for each component."""
    height, width = pixels.shape[:2]
    sides = range(1, MAX_COMPONENTS + 1)
    grids = [(x, y) for x in sides for y in sides if 4 + 2 * x * y <= max_bytes * 4 // 3]
    if not grids:
        return None
    aspect = math.log(width / height)
    x, y = max(grids, key=lambda grid: (grid[0] * grid[1], -abs(math.log(grid[0] / grid[1]) - aspect)))
    began = time.process_time()
    text = package("blurhash").encode(Image.fromarray(reduced(pixels, BLURRED_SIDE)), x, y)
    took_s = time.process_time() - began

    def decode() -> Pixels:
        small = reduced(pixels, BLURRED_SIDE).shape
        drawn = package("blurhash").decode(text, small[1], small[0])
        return resized(np.asarray(drawn, np.uint8)[..., :3], width, height)

    return Made(math.ceil(len(text) * 3 / 4), len(text), took_s, decode)


def thumbhash(pixels: Pixels, max_bytes: int) -> Made | None:
    """ThumbHash, whose size depends on the picture alone."""
    height, width = pixels.shape[:2]
    began = time.process_time()
    small = reduced(pixels, HASHED_SIDE)
    opaque = np.dstack([small, np.full(small.shape[:2], 255, np.uint8)])
    data = bytes(package("fast_thumbhash").rgba_to_thumb_hash(small.shape[1], small.shape[0], opaque.tobytes()))
    took_s = time.process_time() - began
    if len(data) > max_bytes:
        return None

    def decode() -> Pixels:
        w, h, rgba = package("fast_thumbhash").thumb_hash_to_rgba(data)
        return resized(np.frombuffer(bytes(rgba), np.uint8).reshape(h, w, 4)[..., :3], width, height)

    return Made(len(data), len(base64.b64encode(data)), took_s, decode)


def of_baseline(baseline: Baseline) -> Callable[[Pixels, int], Made | None]:
    """A maker of the baseline's best file over all factors; None where none is so small."""

    def make(pixels: Pixels, max_bytes: int) -> Made | None:
        height, width = pixels.shape[:2]
        best, best_db = None, 0.0
        for factor in FACTORS:
            began = time.process_time()
            small = pixels if factor == 1 else resized(pixels, max(width // factor, 1), max(height // factor, 1))
            took_s = time.process_time() - began
            bpp = 8 * max_bytes / (small.shape[0] * small.shape[1])
            if not BPP[0] <= bpp <= BPP[1]:
                continue
            file = baseline.best(small, bpp)
            if len(file.data) > max_bytes:
                continue

            def decode(data: bytes = file.data) -> Pixels:
                decoded = baseline.decode(data)
                return decoded if decoded.shape == pixels.shape else resized(decoded, width, height)

            db = psnr(decode(), pixels)
            if db > best_db:
                began = time.process_time()
                baseline.encode(small, file.quality)
                took_s += time.process_time() - began
                best, best_db = Made(len(file.data), len(base64.b64encode(file.data)), took_s, decode), db
        return best

    return make


CODECS: dict[str, Callable[[Pixels, int], Made | None]] = {
    "sgmethod": sg,
    "BlurHash": blurhash,
    "ThumbHash": thumbhash,
    "WebP": of_baseline(WebP()),
    "AVIF": of_baseline(AvifOf10BitsForPsnr(speed=2)),
    "JPEG XL": of_baseline(JpegXl()),
    "JPEG": of_baseline(Jpeg()),
}
# Measured if it is asked for: needs Node.
ALL_CODECS = CODECS | {"JavaScript": sg_in_javascript}
