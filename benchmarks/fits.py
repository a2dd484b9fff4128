"""Fits of a folder's pictures as files and as tensors, for those who want Gaussians without fitting them.

    python -m benchmarks.fits --images KODAK [--bpp 0.1,0.25,0.5] [--tune psnr] [--jobs 2] [--out build/fits]

For each rate, OUT/BPP has NAME.sg, NAME.npz (means [N, 2], factors [N, 3], colors [N, 3], as sgmethod.read_npz() takes
them, over the background of the file) and manifest.jsonl with the figures of each.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.arguments import numbers
from benchmarks.machine import ROOT
from benchmarks.pictures import pictures_in
from sgmethod import encode_many, open as open_sg, write_npz
from sgmethod.many.processes import usual_jobs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--bpp", type=numbers, default="0.1,0.25,0.5")
    parser.add_argument("--tune", default="psnr")
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "fits")
    options = parser.parse_args()
    pictures = pictures_in(options.images)
    if not pictures:
        raise SystemExit(f"there is no picture in {options.images}")
    for bpp in options.bpp:
        folder = options.out / f"{bpp:g}"
        jobs = options.jobs or usual_jobs(len(pictures))
        tally = encode_many(pictures, folder, jobs=jobs, resume=True, bpp=bpp, tune=options.tune)
        files = sorted(folder.glob("*.sg"))
        for file in files:
            write_npz(file.with_suffix(".npz"), open_sg(file).gaussians())
        print(f"{folder}: {len(files)} files, {tally.failed} failed", flush=True)


if __name__ == "__main__":
    main()
