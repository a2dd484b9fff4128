"""Rate and distortion over a folder of pictures: real files, decoded again and measured.

    python -m benchmarks.rd --images FOLDER [--profiles paper,baseline] [--bpp 0.147,0.43] [--rivals]

One encode at a time. What the JSON already holds for the same commit and machine is not done again, so that an
interrupted run goes on where it stopped. With --rivals (pip install '.[benchmark]') other codecs follow at the same
rates, each at the largest quality whose file is within the rate, or at its smallest file where none is.
"""

from __future__ import annotations

import argparse
import math
import statistics
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.machine import RESULTS, Record, in_words
from benchmarks.pictures import pictures_in
from benchmarks.rd.codecs import RIVALS, Codec, Pixels, Sg
from benchmarks.rd.report import Row, report
from sgmethod.io.image import read_image
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.profiles import PROFILE_NAMES

DECODES = 5  # the median of their times is reported


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


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rd", description="Rate and distortion over a folder.")
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--profiles", default="paper,baseline", help=f"of {', '.join(PROFILE_NAMES)}; may be empty")
    parser.add_argument("--bpp", default="0.147,0.25,0.43,0.72", help="rates, each an upper limit for every file")
    parser.add_argument("--rivals", action="store_true", help="JPEG, JPEG 2000, WebP, AVIF and JPEG XL too")
    parser.add_argument("--out", type=Path, default=RESULTS / "rd.json")
    options = parser.parse_args()
    codecs: list[Codec] = [Sg(name) for name in options.profiles.split(",") if name]
    codecs += [rival() for rival in RIVALS] if options.rivals else []
    rates = [float(rate) for rate in options.bpp.split(",")]
    paths = pictures_in(options.images)
    if not paths:
        parser.error(f"there is no picture in {options.images}")

    record = Record(options.out, "benchmarks.rd", {})
    kept = {row.key: row for row in (Row(**kept) for kept in record.rows)}
    wanted = [(codec, rate, path) for codec in codecs for rate in rates for path in paths]
    for codec, rate, path in wanted:
        key = codec.name, rate, path.name
        if key not in kept:
            pixels = np.round(read_image(path.read_bytes()) * 255).astype(np.uint8)
            kept[key] = measure(codec, path.name, pixels, rate)
            record.add(asdict(kept[key]))
    shown = report([kept[codec.name, rate, path.name] for codec, rate, path in wanted])
    print(shown, in_words(record.content), sep="\n\n")


if __name__ == "__main__":
    main()
