"""Measure how the time of an encode grows with the pixels and with the bytes, compared with AVIF.

    python -m benchmarks.speed growth --images FOLDER [--most 3] [--megapixels 0.75,1.5,3,6,12] [--at-bytes 10000]
                                      [--bytes 500,2000,10000,50000,200000] [--at-megapixels 12] [--repeats 3]

Each picture of the folder is reduced to each size and encoded into --at-bytes; then, at --at-megapixels, into each
number of bytes. Both tunings; AVIF (tune=psnr) at speeds 10, 6 and 4, from the whole picture and from one that is
reduced first. Seconds of ours are medians, AVIF's those of one encode without the search for its quality. The folder
needs pictures as large as the largest size: a mosaic is not what a camera makes.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.arguments import integers, numbers
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels, add_options, named_in
from benchmarks.rd.baselines import AvifForPsnr, Baseline, ReducedAvif, versions
from benchmarks.tables import MISSING, mean, number, table
from sgmethod import encode
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr

BASELINES: dict[str, Callable[[int], Baseline]] = {"avif": AvifForPsnr, "avif reduced": ReducedAvif}
SPEEDS = (10, 6, 4)  # the quickest first: its quality is where the search of the next one begins
TUNES = {"rd": "psnr", "rd visual": "visual"}
AXES = {"megapixels": "max_bytes", "max_bytes": "megapixels"}  # what grows, and what is fixed meanwhile
Rows = Sequence[dict[str, Any]]


def reduced(pixels: Pixels, megapixels: float) -> Pixels:
    """The same picture with that many pixels; unchanged if it has as many within a percent."""
    height, width = pixels.shape[:2]
    scale = math.sqrt(1e6 * megapixels / (width * height))
    if scale > 1.005:
        raise SystemExit(f"a picture has {width * height / 1e6:.2f} megapixels: {megapixels:g} need a larger one")
    if scale > 0.995:
        return pixels
    size = round(width * scale), round(height * scale)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def ours(pixels: Pixels, max_bytes: int, tune: Any, repeats: int) -> dict[str, Any]:
    """Encode repeatedly; the median of the seconds."""
    found = [encode(pixels, bytes=max_bytes, tune=tune).stats for _ in range(repeats)]
    seconds = statistics.median(stats.seconds for stats in found)
    return {"bytes": found[0].bytes, "psnr": found[0].psnr, "gaussians": found[0].gaussians, "seconds": seconds}


def measure(record: Record, picture: str, source: Pixels, size: tuple[float, int], repeats: int) -> None:
    """Measure one picture at one size in megapixels and bytes, by every method."""
    pixels = reduced(source, size[0])
    key = {"picture": picture, "megapixels": size[0], "max_bytes": size[1]}
    for method, tune in TUNES.items():
        if not record.has(**key, method=method):
            record.add({**key, "method": method, "setting": "", **ours(pixels, size[1], tune, repeats)})
    bpp = 8 * size[1] / (pixels.shape[0] * pixels.shape[1])
    for method, make in BASELINES.items() if versions() else ():
        near = None
        for speed in SPEEDS:
            if record.has(**key, method=method, setting=str(speed)):
                continue
            baseline = make(speed)
            file = baseline.best(pixels, bpp, near)
            near = file.quality
            row = {"bytes": len(file.data), "psnr": psnr(baseline.decode(file.data), pixels), "seconds": file.encode_s}
            record.add({**key, "method": method, "setting": str(speed), **row})


def name_of(row: dict[str, Any]) -> str:
    """The method of a row, and its setting."""
    return f"{row['method']}, speed {row['setting']}" if row["setting"] else str(row["method"])


def exponent(x: Sequence[float], y: Sequence[float]) -> float | None:
    """The slope of the line through the logarithms; None for fewer than two points."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len({*x}) > 1 else None


def growth_table(rows: Rows, settings: dict[str, Any], axis: str) -> str:
    """A table of seconds along an axis, means over the pictures, and of the power with which they grow."""
    fixed = AXES[axis]
    groups: dict[str, dict[float, list[dict[str, Any]]]] = {}
    for row in rows:
        if row[fixed] == settings[fixed]:
            groups.setdefault(name_of(row), {}).setdefault(row[axis], []).append(row)
    every = sorted({at for group in groups.values() for at in group})
    lines = []
    for name, group in groups.items():
        seconds = {at: statistics.fmean(row["seconds"] for row in group[at]) for at in sorted(group)}
        power = exponent([*seconds], [*seconds.values()])
        cells = [f"{seconds[at]:.2f}" if at in seconds else MISSING for at in every]
        last = group.get(every[-1], [])
        size = mean([row["bytes"] for row in last])
        above = f" ({size:,.0f} bytes)" if size is not None and size > last[0]["max_bytes"] else ""
        lines.append([name, *cells, number(power, ".2f"), number(mean([row["psnr"] for row in last]), ".2f") + above])
    unit = "MP" if axis == "megapixels" else "bytes"
    titles = ["seconds", *(f"{at:,g} {unit}" for at in every), "exponent", "PSNR in the last column"]
    return table(" | ".join(titles), lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser, most=3)
    parser.add_argument("--megapixels", type=numbers, default="0.75,1.5,3,6,12")
    parser.add_argument("--at-bytes", type=int, default=10_000, help="of the files at every size")
    parser.add_argument("--bytes", type=integers, default="500,2000,10000,50000,200000")
    parser.add_argument("--at-megapixels", type=float, default=12, help="of the picture for every number of bytes")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RUNS / "growth.json")
    options = parser.parse_args()
    settings: dict[str, Any] = {"max_bytes": options.at_bytes, "megapixels": options.at_megapixels}
    settings |= {"repeats": options.repeats, "codecs": versions()}
    record = Record(options.out, "benchmarks.speed growth", settings)
    by_size = [(megapixels, options.at_bytes) for megapixels in options.megapixels]
    by_bytes = [(options.at_megapixels, count) for count in options.bytes]
    for path in named_in(options):
        source = read_image_8_bit(path.read_bytes())
        encode(source[:64, :64], bytes=100)  # or the first encode would pay for what a process loads
        for size in dict.fromkeys([*by_size, *by_bytes]):
            measure(record, path.stem, source, size, options.repeats)
    for axis in AXES:
        print(f"\n{growth_table(record.rows, settings, axis)}")
