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
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import sgmethod
from benchmarks.machine import RUNS, command, origin, write_json
from benchmarks.mixture.fit import Array, Variant, at_budget, code, fit_bits, flat_prior, psnr, search, symbol_shares
from benchmarks.pictures import Pixels, pictures_in

SIDE = 192
VARIANTS = {
    "sum": Variant(mixture=False, reach=3.0, rounds=1),
    "mixture": Variant(reach=5.0, amplitudes="none", rate_weight=0.3, color_step=0.5, rounds=1),
}


def crop(path: Path, column: float = 0.5, row: float = 0.5) -> Pixels:
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    y, x = int((pixels.shape[0] - SIDE) * row), int((pixels.shape[1] - SIDE) * column)
    return np.ascontiguousarray(pixels[y : y + SIDE, x : x + SIDE])


def planes(pixels: Pixels) -> Array:
    return np.ascontiguousarray(pixels.transpose(2, 0, 1), np.float32) / np.float32(255)


def trained(folder: Path, v: Variant) -> list[list[int]]:
    """Frequencies of symbols [contexts, symbols], in thousandths."""
    counts = np.zeros_like(flat_prior())
    for path in pictures_in(folder):
        target = planes(crop(path))
        fitted, quantum = fit_bits(target, v, 0.25 * SIDE * SIDE, flat_prior())
        counts += code(fitted, target, v, quantum, v.sweeps, flat_prior()).counts - flat_prior()
    return symbol_shares(counts)


def measure(source: Pixels, image: Pixels, networks: Any) -> dict[str, float]:
    found = {"psnr": psnr(planes(image), planes(source))}
    if networks is not None:
        found |= networks(image, source)
    return {name: round(value, 5) for name, value in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path)
    parser.add_argument("--train", type=Path)
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--bpp", default="0.25")
    parser.add_argument("--models", default="sum,mixture", help=", ".join(VARIANTS))
    parser.add_argument(
        "--part", default="0/1", help="which part of the pictures: 1/2 is the second half, taken in turns"
    )
    parser.add_argument("--out", type=Path, default=RUNS / "mixture.json")
    parser.add_argument("--save", type=Path, help="folder for crops and decoded pictures")
    o = parser.parse_args()
    content = {
        "command": command("benchmarks.mixture"),
        **origin(),
        "settings": {"side": SIDE},
        "shares": {},
        "rows": [],
    }
    if o.out.exists():
        content = json.loads(o.out.read_text())

    def write() -> None:
        write_json(o.out, content)

    if o.train:
        for model in o.models.split(","):
            content["shares"][model] = trained(o.train, VARIANTS[model])
            write()
    if not o.images:
        return
    networks = None
    if o.weights:
        from sgmethod.metrics.perceptual import Networks

        networks = Networks(o.weights)
    part, parts = map(int, o.part.split("/"))
    for bpp in map(float, o.bpp.split(",")):
        for path in pictures_in(o.images)[part::parts]:
            source = crop(path)
            target = planes(source)
            file = sgmethod.encode(source, bytes=round(bpp * SIDE * SIDE / 8), tune="psnr").data
            for model in ["rd", *o.models.split(",")]:
                key = {"picture": path.stem, "bpp": bpp, "model": model}
                if any(key.items() <= row.items() for row in content["rows"]):
                    continue
                start = time.process_time()
                if model == "rd":
                    image, row = sgmethod.decode(file), {"bytes": len(file), "gaussians": sgmethod.info(file).gaussians}
                    row |= measure(source, image, networks)
                    row["psnr_at_bytes"] = row["psnr"]
                else:
                    v, shares = VARIANTS[model], content["shares"].get(model)
                    prior = flat_prior(shares)
                    fitted, quantum = fit_bits(target, v, 8 * len(file), prior)
                    best, chosen = at_budget(
                        search(fitted, quantum, target, v, 8 * len(file), prior), target, 8 * len(file)
                    )
                    image = chosen.image().transpose(1, 2, 0)
                    row = {"bytes": round(chosen.bits / 8, 1), "gaussians": chosen.head.count}
                    row |= measure(source, np.ascontiguousarray(image), networks) | {"psnr_at_bytes": round(best, 4)}
                    row["unrounded_psnr"], row["seconds"] = (
                        round(chosen.float_psnr, 3),
                        round(time.process_time() - start, 2),
                    )
                    names = ("cells", "raw", "colour", "shape", "amplitude")
                    row["bits"] = {
                        n: round(float(b) / max(chosen.head.count, 1), 2)
                        for n, b in zip(names, chosen.parts, strict=True)
                    }
                content["rows"].append(key | row)
                write()
                print(key, row, flush=True)
                if o.save:
                    o.save.mkdir(exist_ok=True, parents=True)
                    Image.fromarray(source).save(o.save / f"{path.stem}.png")
                    Image.fromarray(np.ascontiguousarray(image)).save(o.save / f"{path.stem}-{bpp}-{model}.png")


if __name__ == "__main__":
    main()
