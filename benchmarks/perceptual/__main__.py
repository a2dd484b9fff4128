"""Measure metrics that are designed to agree with people.

    python -m benchmarks.perceptual --images FOLDER --weights FOLDER [--bpp 0.1,0.25]

For each picture and rate: a file tuned for the eye, and AVIF (libvips, speed 4, 4:4:4, tune=iq) at the best quality
that takes no more bytes, if there is one. Prints means of each as CSV. Needs the extra "benchmark", and weights
(python -m benchmarks.perceptual.weights FOLDER).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.arguments import numbers
from benchmarks.flat import flat
from benchmarks.machine import RUNS, Record
from benchmarks.perceptual.local import local_statistics
from benchmarks.perceptual.networks import Networks
from benchmarks.perceptual.wasserstein import Wasserstein
from benchmarks.pictures import Pixels, pictures_in
from benchmarks.rd.baselines import AvifOf8BitsForEyes
from sgmethod import decode, encode, info
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import MS_SSIM_SIDE, ms_ssim, psnr, ssimulacra2


def decoded(pixels: Pixels, bpp: float) -> Iterator[tuple[str, int, float, Pixels]]:
    """Kind, bytes, the part of them that is texture, and pixels."""
    visual = encode(pixels, bpp=bpp, tune="visual").data
    yield "visual", len(visual), info(visual).bits["texture"] / (8 * len(visual)), decode(visual)
    avif = AvifOf8BitsForEyes()
    data = avif.best(pixels, 8 * len(visual) / (pixels.shape[0] * pixels.shape[1])).data
    if len(data) <= len(visual):
        yield "avif", len(data), 0.0, avif.decode(data)


def figures(picture: Pixels, source: Pixels, networks: Networks, wasserstein: Wasserstein) -> dict[str, float | None]:
    """The figures of a picture, by the names of means.FIGURES."""
    similarity = ms_ssim(picture, source)
    found = {"psnr": psnr(picture, source), "ms_ssim": similarity, "ssimulacra2": ssimulacra2(picture, source)}
    found |= {**networks(picture, source), "wasserstein": wasserstein(picture, source)}
    found |= local_statistics(picture, source)
    return {name: None if value is None else round(value, 4) for name, value in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--weights", type=Path, required=True, help="folder of the networks' weights")
    parser.add_argument("--bpp", type=numbers, default="0.1,0.25", help="rates, each an upper limit for every file")
    parser.add_argument("--out", type=Path, default=RUNS / "perceptual.json")
    options = parser.parse_args()
    paths = pictures_in(options.images)
    if not paths:
        parser.error(f"there is no picture in {options.images}")
    networks, wasserstein = Networks(options.weights), Wasserstein(options.weights)
    record = Record(options.out, "benchmarks.perceptual", {})
    for path in paths:
        pixels = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
        if min(pixels.shape[:2]) < MS_SSIM_SIDE:
            parser.error(f"{path} has a side below {MS_SSIM_SIDE} pixels, for which MS-SSIM is not defined")
        for bpp in options.bpp:
            key = {"image": path.name, "max_bpp": bpp}
            if record.has(**key):
                continue
            rows = [
                {"kind": kind, "bytes": size, "texture": round(texture, 5)}
                | figures(picture, pixels, networks, wasserstein)
                for kind, size, texture, picture in decoded(pixels, bpp)
            ]
            for row in rows:  # both or none: a run that goes on would not measure the second alone
                record.add(key | row)
    print(flat(record.rows))


if __name__ == "__main__":
    main()
