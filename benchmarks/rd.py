"""Rate and distortion over a folder of pictures: real files, decoded again and measured.

    python -m benchmarks.rd --images FOLDER [--profiles paper,baseline] [--bpp 0.147,0.43] [--rivals]

One encode at a time. What the JSON already holds for the same commit and machine is not done again, so that an
interrupted run goes on where it stopped. With --rivals (pip install '.[benchmark]') other codecs follow at the same
rates, each at the largest quality whose file is within the rate, or at its smallest file where none is.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from benchmarks.machine import ROOT, in_words, origin, write_json
from benchmarks.pictures import pictures_in
from sgmethod import Budget, decode, encode, info
from sgmethod.io.image import read_image
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.profiles import PROFILE_NAMES

DECODES = 5  # the median of their times is reported

# GaussianImage on Kodak: (bpp, PSNR in dB, MS-SSIM), means over the 24 pictures. Rates follow from its field
# widths, qualities were read off the figure of its authors.
PUBLISHED_BASELINE = [
    (0.1183, 24.66, 0.838),
    (0.1468, 25.04, 0.854),
    (0.4316, 27.39, 0.923),
    (0.7165, 28.72, 0.946),
    (1.0013, 29.64, 0.957),
    (1.2861, 30.49, 0.965),
]

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
        data = encode(pixels.astype(np.float32) / 255, Budget("bpp", max_bpp), self.profile).data
        gaussians = info(data).gaussians
        assert isinstance(gaussians, int)
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
    """libavif, speed 4, 4:2:0."""

    name, qualities = "avif", range(100)

    def encode(self, pixels: Pixels, quality: float) -> bytes:
        return bytes(imagecodecs().avif_encode(pixels, level=int(quality), speed=4, pixelformat="420"))

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


@dataclass(frozen=True)
class Row:
    """One picture through one codec at one rate; the fields of the JSON."""

    codec: str
    max_bpp: float
    image: str
    bytes: int
    bpp: float
    psnr: float | None  # None for identical pixels
    ms_ssim: float | None  # None for pictures too small for it
    gaussians: int | None
    encode_s: float
    decode_ms: float

    @property
    def key(self) -> tuple[str, float, str]:
        """What makes a row one of its own."""
        return self.codec, self.max_bpp, self.image


def measure(codec: Codec, image: str, pixels: Pixels, max_bpp: float) -> Row:
    """Encode to a file, read and decode it, compare."""
    made = codec.run(pixels, max_bpp)
    times = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture"
        path.write_bytes(made.data)
        size = path.stat().st_size
        for _ in range(DECODES):
            began = time.perf_counter()
            decoded = made.decode(path.read_bytes())
            times.append(1e3 * (time.perf_counter() - began))
    db = psnr(decoded, pixels)
    return Row(
        codec=codec.name,
        max_bpp=max_bpp,
        image=image,
        bytes=size,
        bpp=8 * size / (pixels.shape[0] * pixels.shape[1]),
        psnr=db if math.isfinite(db) else None,
        ms_ssim=ms_ssim(decoded, pixels),
        gaussians=made.gaussians,
        encode_s=round(made.encode_s, 3),
        decode_ms=round(statistics.median(times), 3),
    )


Point = tuple[float, float]  # bits per pixel, quality


def bd_rate(anchor: Sequence[Point], test: Sequence[Point]) -> float | None:
    """Bjontegaard's difference in rate, in percent: what test needs more (or, below 0, less) than anchor.

    The mean over the qualities that both reach of the difference in log rate, each curve interpolated by piecewise
    cubic Hermite polynomials. None where they share no quality, or a curve has one point or falls.
    """
    curves = []
    for points in (anchor, test):
        if len(points) < 2:
            return None
        rates, qualities = np.array(sorted(points)).T
        if (np.diff(qualities) <= 0).any():
            return None
        curves.append(PchipInterpolator(qualities, np.log10(rates)))
    low, high = (f(c.x[end] for c in curves) for f, end in ((max, 0), (min, -1)))
    if low >= high:
        return None
    ours, theirs = (c.integrate(low, high) / (high - low) for c in reversed(curves))
    return float(100 * (10 ** (ours - theirs) - 1))


def means(rows: Sequence[Row]) -> dict[tuple[str, float], dict[str, float | None]]:
    """For each codec and rate the mean of every figure over the pictures; None where a picture has none."""
    groups = defaultdict(list)
    for row in rows:
        groups[row.codec, row.max_bpp].append(row)
    figures = ("bytes", "bpp", "psnr", "ms_ssim", "gaussians", "encode_s", "decode_ms")
    result = {}
    for key, group in groups.items():
        columns = {f: [getattr(row, f) for row in group] for f in figures}
        result[key] = {f: None if None in values else statistics.fmean(values) for f, values in columns.items()}
        result[key]["images"] = len(group)
    return result


Curve = Sequence[tuple[float | None, ...]]  # bits per pixel, PSNR, MS-SSIM


def curve(average: dict[tuple[str, float], dict[str, float | None]], codec: str) -> Curve:
    """The mean points of a codec."""
    return [(m["bpp"], m["psnr"], m["ms_ssim"]) for (name, _), m in average.items() if name == codec]


def scaled(points: Curve, column: int) -> list[Point]:
    """(bits per pixel, quality) of a column; MS-SSIM in decibels, as its last digits are what differs."""
    known = [(p[0], p[column]) for p in points if p[column] is not None]
    return known if column == 1 else [(rate, -10 * math.log10(1 - value)) for rate, value in known if value < 1]


def anchors(rows: Sequence[Row], average: dict[tuple[str, float], dict[str, float | None]]) -> dict[str, Curve]:
    """What rates are compared with: profile baseline of this run, and on the Kodak pictures what was published."""
    found: dict[str, Curve] = {}
    if any(row.codec == "baseline" for row in rows):
        found["baseline, measured"] = curve(average, "baseline")
    if {Path(row.image).stem for row in rows} == {f"kodim{i:02}" for i in range(1, 25)}:
        found["GaussianImage, published"] = PUBLISHED_BASELINE
    return found


def report(rows: Sequence[Row]) -> str:
    """Markdown: means, differences in rate from the published baseline, then every picture."""
    average = means(rows)
    titles = "| bpp at most | images | bytes | bpp | PSNR | MS-SSIM | Gaussians | encode s | decode ms |"
    rule = "|---" * 10 + "|"
    lines = ["| codec " + titles, rule]
    lines += [f"| {codec} | {limit:g} | {m['images']:g} | {_cells(m)}" for (codec, limit), m in average.items()]
    lines += ["", "| codec | rate against | BD-rate, PSNR | BD-rate, MS-SSIM |", "|---" * 4 + "|"]
    for name, anchor in anchors(rows, average).items():
        for codec in dict.fromkeys(codec for codec, _ in average if not name.startswith(f"{codec},")):
            rates = [bd_rate(*(scaled(p, column) for p in (anchor, curve(average, codec)))) for column in (1, 2)]
            cells = ["-" if rate is None else f"{rate:+.1f} %" for rate in rates]
            lines.append(f"| {codec} | {name} | {cells[0]} | {cells[1]} |")
    lines += ["", "| codec " + titles.replace("images", "image"), rule]
    lines += [f"| {r.codec} | {r.max_bpp:g} | {r.image} | {_cells(asdict(r))}" for r in rows]
    return "\n".join(lines)


def _cells(figures: dict[str, float | None]) -> str:
    formats = {"bytes": ".0f", "bpp": ".4f", "psnr": ".2f", "ms_ssim": ".4f", "gaussians": ".0f"}
    formats |= {"encode_s": ".2f", "decode_ms": ".2f"}
    cells = ["-" if figures[name] is None else format(figures[name], form) for name, form in formats.items()]
    return " | ".join(cells) + " |"


def kept_rows(path: Path, where: dict[str, object]) -> list[Row]:
    """Rows of an earlier run of the same commit on the same machine."""
    if not path.exists():
        return []
    content = json.loads(path.read_text())
    same = all(content[name] == where[name] for name in ("commit", "machine"))
    return [Row(**row) for row in content["rows"]] if same else []


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rd", description="Rate and distortion over a folder.")
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--profiles", default="paper,baseline", help=f"of {', '.join(PROFILE_NAMES)}; may be empty")
    parser.add_argument("--bpp", default="0.147,0.25,0.43,0.72", help="rates, each an upper limit for every file")
    parser.add_argument("--rivals", action="store_true", help="JPEG, JPEG 2000, WebP, AVIF and JPEG XL too")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "rd.json")
    options = parser.parse_args()
    codecs: list[Codec] = [Sg(name) for name in options.profiles.split(",") if name]
    codecs += [rival() for rival in RIVALS] if options.rivals else []
    rates = [float(rate) for rate in options.bpp.split(",")]
    paths = pictures_in(options.images)
    if not paths:
        parser.error(f"there is no picture in {options.images}")

    where = origin()
    kept = {row.key: row for row in kept_rows(options.out, where)}
    wanted = [(codec, rate, path) for codec in codecs for rate in rates for path in paths]
    for codec, rate, path in wanted:
        key = codec.name, rate, path.name
        if key not in kept:
            pixels = np.round(read_image(path.read_bytes()) * 255).astype(np.uint8)
            kept[key] = row = measure(codec, path.name, pixels, rate)
            write_json(options.out, {**where, "rows": [asdict(r) for r in kept.values()]})
            print(f"{row.codec} {row.image} {row.bpp:.4f} bpp {row.psnr} dB {row.encode_s} s", file=sys.stderr)
    print(report([kept[codec.name, rate, path.name] for codec, rate, path in wanted]), in_words(where), sep="\n\n")


if __name__ == "__main__":
    main()
