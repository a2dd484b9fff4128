"""Encode and decode times of profile rd against another checkout, which takes turns with this one, picture by picture.

    python -m benchmarks.turns --images FOLDER --other CHECKOUT [--bpp 0.25] [--tune psnr] [--rivals] [--out FILE]

--other: a checkout with its own .venv, which may know no tuning. --rivals: libjpeg-turbo's decode and libavif's encode
(speed 4, 4:2:0, two threads) take turns too, at no more bytes.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.machine import RUNS, Record, in_words
from benchmarks.pictures import pictures_in
from benchmarks.rd.rivals import Avif, Jpeg
from sgmethod.io import read_image_8_bit
from sgmethod.profiles import TUNES
from tests.harness.data import ROOT

DECODES = 30
# Runs in either checkout: only what both of them export.
WORKER = """
import inspect, json, sys, time, statistics
from sgmethod import Budget, decode, encode
from sgmethod.io.image import read_image
tuned = {"tune": "TUNE"} if "tune" in inspect.signature(encode).parameters else {}
for line in sys.stdin:
    path, bpp = json.loads(line)
    pixels = read_image(open(path, "rb").read())
    began = time.perf_counter()
    encoded = encode(pixels, Budget("bpp", bpp), "rd", **tuned)
    seconds = time.perf_counter() - began
    times = []
    for _ in range(DECODES + 3):
        began = time.perf_counter()
        decode(encoded.data)
        times.append(time.perf_counter() - began)
    stats = encoded.stats
    row = dict(psnr=stats.psnr, bytes=stats.bytes, encode_s=seconds, decode_ms=1e3 * statistics.median(times[3:]))
    print(json.dumps(row), flush=True)
"""


class Checkout:
    """A process of a checkout, which waits for pictures."""

    def __init__(self, root: Path, python: str, tune: str) -> None:
        command = [python, "-c", WORKER.replace("DECODES", str(DECODES)).replace("TUNE", tune)]
        self.process = subprocess.Popen(command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, path: Path, bpp: float) -> dict[str, float]:
        """PSNR, bytes, and seconds of the encode, milliseconds of the median decode."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(json.dumps([str(path.resolve()), bpp]), file=self.process.stdin, flush=True)
        row: dict[str, float] = json.loads(self.process.stdout.readline())
        return row


def rivals(path: Path, bpp: float) -> dict[str, float]:
    """The same figures of libjpeg-turbo and libavif, as far as they are compared."""
    pixels = read_image_8_bit(path.read_bytes())
    jpeg, times = Jpeg().run(pixels, bpp), []
    for _ in range(DECODES):
        began = time.perf_counter()
        jpeg.decode(jpeg.data)
        times.append(time.perf_counter() - began)
    return {"jpeg_decode_ms": 1e3 * statistics.median(times), "avif_encode_s": Avif().run(pixels, bpp).encode_s}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--other", type=Path, required=True)
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--tune", choices=TUNES, default="psnr")
    parser.add_argument("--rivals", action="store_true")
    parser.add_argument("--out", type=Path, default=RUNS / "version4" / "turns.json")
    options = parser.parse_args()
    other = Checkout(options.other, str(options.other.resolve() / ".venv" / "bin" / "python"), options.tune)
    this = Checkout(ROOT, sys.executable, options.tune)
    record = Record(options.out, "benchmarks.turns", {"bpp": options.bpp, "tune": options.tune})
    rows = record.rows
    for path in pictures_in(options.images):
        if record.has(image=path.stem):
            continue
        row = {"image": path.stem, "other": other.run(path, options.bpp), "this": this.run(path, options.bpp)}
        record.add(row | ({"rivals": rivals(path, options.bpp)} if options.rivals else {}))

    def mean(who: str, what: str) -> float:
        return statistics.fmean(row[who][what] for row in rows)

    for what in ("psnr", "encode_s", "decode_ms"):
        print(f"{what}: {mean('other', what):.3f} -> {mean('this', what):.3f}")
    if options.rivals:
        for who in ("other", "this"):
            decode = mean(who, "decode_ms") / mean("rivals", "jpeg_decode_ms")
            encode = mean(who, "encode_s") / mean("rivals", "avif_encode_s")
            print(f"{who}: decode {decode:.2f} of libjpeg-turbo's, encode {encode:.2f} of libavif's")
    print(in_words(record.content))


if __name__ == "__main__":
    main()
