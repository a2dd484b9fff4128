"""Time against pixels: one large photograph, cut into ever larger parts and whole, at one rate.

    python -m benchmarks.scaling --image FILE [--bpp 0.25] [--cuts 8,4,2,1] [--most 16]

--cuts: parts along each side. --most: parts encoded of each size, evenly spread. Each part is encoded once; the table's
seconds are those of whole encodes.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from benchmarks.machine import in_words, origin
from sgmethod import Budget, encode
from sgmethod.io.image import read_image
from sgmethod.scene import FloatArray


def parts(pixels: FloatArray, cuts: int, most: int) -> list[FloatArray]:
    """Of equal size [H // cuts, W // cuts, 3]."""
    height, width = pixels.shape[0] // cuts, pixels.shape[1] // cuts
    chosen = np.unique(np.linspace(0, cuts * cuts - 1, min(most, cuts * cuts)).astype(int))
    corners = [(k // cuts * height, k % cuts * width) for k in chosen]
    return [np.ascontiguousarray(pixels[y : y + height, x : x + width]) for y, x in corners]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--image", type=Path, required=True)
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--cuts", default="8,4,2,1")
    parser.add_argument("--most", type=int, default=16)
    arguments = parser.parse_args()
    pixels = read_image(arguments.image.read_bytes())
    print("| size | parts | s a megapixel | PSNR of all |\n|---|---|---|---|", flush=True)
    for cuts in map(int, arguments.cuts.split(",")):
        cut = parts(pixels, cuts, arguments.most)
        stats = [encode(part, Budget("bpp", arguments.bpp)).stats for part in cut]
        megapixels = sum(s.width * s.height for s in stats) / 1e6
        mse = sum(10 ** (-s.psnr / 10) for s in stats) / len(stats)
        seconds = sum(s.seconds for s in stats) / megapixels
        size = f"{stats[0].width} x {stats[0].height}"
        print(f"| {size} | {len(stats)} | {seconds:.2f} | {-10 * math.log10(mse):.2f} |", flush=True)
    print(f"\n{in_words(origin())}")


if __name__ == "__main__":
    main()
