"""A sum of Gaussians or a normalised mixture? Same crops, bytes, optimiser and coder: python -m benchmarks.mixture

--train FOLDER    first: how often each symbol comes, from pictures that are not measured
--images FOLDER   crops of 192 x 192 pixels from the middle of each picture, at the bytes that profile rd takes
--weights FOLDER  LPIPS and DISTS as well (python -m benchmarks.perceptual.weights)

Rows are appended to the JSON, and those that it has are not measured again. Needs g++.
"""

from __future__ import annotations

import argparse
import json
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import sgmethod
from benchmarks.machine import RUNS, command, found, origin, write_json
from benchmarks.mixture.fit import Array, Variant, at_budget, code, fit_bits, prior_of, search, symbol_shares
from benchmarks.perceptual.networks import Networks
from benchmarks.pictures import Pixels, middle_of, pictures_in
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr

SIDE = 192
Row = dict[str, Any]
PARTS = ("cells", "raw", "colour", "shape", "amplitude")
VARIANTS = {
    "sum": Variant(mixture=False, reach=3.0, rounds=1),
    "mixture": Variant(reach=5.0, amplitudes="none", rate_weight=0.3, color_step=0.5, rounds=1),
}


def crop(path: Path) -> Pixels:
    pixels = read_image_8_bit(path.read_bytes())
    return middle_of(pixels, *(min(side, SIDE) for side in pixels.shape[:2]))


def planes(pixels: Pixels) -> Array:
    return np.ascontiguousarray(pixels.transpose(2, 0, 1), np.float32) / np.float32(255)


def trained(folder: Path, v: Variant) -> list[str]:
    """How often each symbol comes, of 2,000."""
    counts = np.zeros_like(prior_of())
    for path in pictures_in(folder):
        target = planes(crop(path))
        fitted, quantum = fit_bits(target, v, 0.25 * SIDE * SIDE, prior_of())
        counts += code(fitted, target, v, quantum, v.sweeps, prior_of()).counts - prior_of()
    return symbol_shares(counts)


def compared(source: Pixels, image: Pixels, networks: Networks | None) -> Row:
    found: Row = {"psnr": round(psnr(image, source), 4)}
    if networks is not None:
        found |= {name: round(value, 5) for name, value in networks(image, source).items()}
    return found


def of_profile_rd(file: bytes, source: Pixels, networks: Networks | None) -> tuple[Pixels, Row]:
    image = sgmethod.decode(file)
    row: Row = {"bytes": len(file), "gaussians": sgmethod.info(file).gaussians}
    row |= compared(source, image, networks)
    return image, row | {"psnr_at_bytes": row["psnr"]}


def of_trial(v: Variant, prior: Array, source: Pixels, size: int, networks: Networks | None) -> tuple[Pixels, Row]:
    """Fit and code for a size in bytes."""
    start, target = time.process_time(), planes(source)
    fitted, quantum = fit_bits(target, v, 8 * size, prior)
    best, chosen = at_budget(search(fitted, quantum, target, v, 8 * size, prior), target, 8 * size)
    seconds = round(time.process_time() - start, 2)
    image, n = np.ascontiguousarray(chosen.image().transpose(1, 2, 0)), max(chosen.head.count, 1)
    bits = {name: round(float(b) / n, 2) for name, b in zip(PARTS, chosen.parts, strict=True)}
    row: Row = {"bytes": round(chosen.bits / 8, 1), "gaussians": chosen.head.count}
    row |= compared(source, image, networks) | {"psnr_at_bytes": round(best, 4)}
    return image, row | {"unrounded_psnr": round(chosen.float_psnr, 3), "seconds": seconds, "bits": bits}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("images", "train", "weights", "save"):
        parser.add_argument(f"--{name}", type=Path, help="folder of decoded pictures" if name == "save" else None)
    parser.add_argument("--bpp", default="0.25")
    parser.add_argument("--models", default="sum,mixture", help=", ".join(VARIANTS))
    parser.add_argument("--part", default="0/1", help="of the pictures: 1/2 is the second half, taken in turns")
    parser.add_argument("--out", type=Path, default=RUNS / "mixture.json")
    o = parser.parse_args()
    content: Row = {"command": command("benchmarks.mixture"), **origin(), "settings": {"side": SIDE}}
    content |= {"shares": {}, "rows": []}
    if o.out.exists():
        content = json.loads(o.out.read_text())
    models, (part, parts) = o.models.split(","), map(int, o.part.split("/"))
    if o.train:
        content["shares"] |= {model: trained(o.train, VARIANTS[model]) for model in models}
        write_json(o.out, content)
    networks = Networks(o.weights) if o.weights else None
    pictures = pictures_in(o.images)[part::parts] if o.images else []
    for bpp, path in product(map(float, o.bpp.split(",")), pictures):
        source = crop(path)
        file = sgmethod.encode(source, bytes=round(bpp * SIDE * SIDE / 8), tune="psnr").data
        for model in ("rd", *models):
            key = {"picture": path.stem, "bpp": bpp, "model": model}
            if found(key, content["rows"]):
                continue
            if model == "rd":
                image, row = of_profile_rd(file, source, networks)
            else:
                prior = prior_of(content["shares"].get(model))
                image, row = of_trial(VARIANTS[model], prior, source, len(file), networks)
            content["rows"].append(key | row)
            write_json(o.out, content)
            print(key | row, flush=True)
            if o.save:
                o.save.mkdir(exist_ok=True, parents=True)
                Image.fromarray(image).save(o.save / f"{path.stem}-{bpp}-{model}.png")
                Image.fromarray(source).save(o.save / f"{path.stem}.png")


if __name__ == "__main__":
    main()
