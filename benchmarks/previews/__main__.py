"""Previews of 32 to 4,096 bytes over a folder of pictures, beside placeholders and other codecs, each at its best.

    python -m benchmarks.previews --images FOLDER [--most N] [--bytes 64,256] [--codecs sgmethod,WebP]
                                  [--weights FOLDER] [--seen-bytes 256,1024]

Each file is the best within so many bytes. There is no row where a codec makes none so small, or the same as within
fewer. Times are of processors, all threads added up. --weights: as benchmarks.rd takes it, for SSIMULACRA 2,
LPIPS and DISTS at --seen-bytes. Needs the extra "benchmark".
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.arguments import integers, some_of
from benchmarks.machine import RUNS, Record
from benchmarks.perceptual.networks import Networks
from benchmarks.pictures import Pixels, add_options, named_in
from benchmarks.previews.codecs import ALL_CODECS, CODECS, Made
from benchmarks.rd.baselines import package
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.metrics.visual import ssimulacra2

BYTES = [32, 64, 128, 256, 512, 1024, 2048, 4096]
SEEN = [512]
DECODES = 5  # the median of their times counts


def measured(made: Made, pixels: Pixels, networks: Networks | None) -> dict[str, Any]:
    """The figures of a file."""
    times = []
    for _ in range(DECODES):
        began = time.process_time()
        decoded = made.decode()
        times.append(1e3 * (time.process_time() - began))
    found: dict[str, Any] = {"bytes": made.bytes, "text": made.text, "psnr": round(psnr(decoded, pixels), 4)}
    if networks is not None:
        seen = {"ssimulacra2": ssimulacra2(decoded, pixels), **networks(decoded, pixels)}
        found |= {name: round(value, 4) for name, value in seen.items() if value is not None}
    return found | {"encode_s": round(made.encode_s, 4), "decode_ms": round(statistics.median(times), 3)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser, most=10**6)
    parser.add_argument("--bytes", type=integers, default=BYTES, help="of a file at most")
    parser.add_argument(
        "--codecs", type=some_of(ALL_CODECS, "codec"), default=[*CODECS], help=f"of {', '.join(ALL_CODECS)}"
    )
    parser.add_argument("--weights", type=Path, help="folder of the networks' weights")
    parser.add_argument("--seen-bytes", type=integers, default=SEEN, help="bytes at which the networks look")
    parser.add_argument("--out", type=Path, default=RUNS / "previews.json")
    options = parser.parse_args()
    for name in ("imagecodecs", "blurhash", "fast_thumbhash"):
        package(name)
    networks = Networks(options.weights) if options.weights else None
    record = Record(options.out, "benchmarks.previews", {"seen": options.seen_bytes if networks else []})
    for path in named_in(options):
        pixels = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
        for max_bytes in sorted(options.bytes):
            for codec in options.codecs:
                key = {"codec": codec, "image": path.name}
                if record.has(**key, max_bytes=max_bytes) or (made := ALL_CODECS[codec](pixels, max_bytes)) is None:
                    continue
                if not record.has(**key, bytes=made.bytes):
                    found = measured(made, pixels, networks if max_bytes in options.seen_bytes else None)
                    record.add({"codec": codec, "max_bytes": max_bytes, "image": path.name} | found)


if __name__ == "__main__":
    main()
