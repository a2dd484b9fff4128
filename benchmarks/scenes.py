"""What a scene does not need: Gaussians, bytes and seconds by content at one PSNR, and what each saving saves.

    SG_THREADS=1 python -m benchmarks.scenes --images KODAK [--psnr 34] [--repeats 3]
    SG_THREADS=1 python -m benchmarks.scenes --sparse

Scenes have 256x256 pixels: half are parts of Kodak's photographs, half are drawn here. --sparse encodes pictures of
2000x2000 pixels that are nearly empty, with a budget, because one colour exceeds any PSNR. Seconds are processor time,
on which other work on the machine has little effect.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from statistics import median
from unittest.mock import PropertyMock, patch

import cv2
import numpy as np

from benchmarks.machine import RUNS, Record, peak_bytes
from benchmarks.pictures import Pixels
from sgmethod import Encoded, encode
from sgmethod.io.image import read_image_8_bit
from sgmethod.rd.problem import Problem
from sgmethod.rd.rate_control import EXACT_DB
from sgmethod.settings.rd import RD, RdSettings

SIDE = 256
LARGE_SIDE, LARGE_BYTES = 2000, 1000
PHOTOGRAPHED = {  # a picture of Kodak's, and the scene's first row and column
    "sky": ("kodim19", 0, 0),
    "face": ("kodim04", 180, 190),
    "foliage": ("kodim13", 100, 0),
    "facade": ("kodim08", 200, 300),
}
TEXT = ("Structure-guided", "allocation of 2D", "Gaussians: more of", "them where there is", "more to be seen")

# Each saving, and the settings that refuse it.
BY_SETTINGS: dict[str, RdSettings] = {
    "reduced pictures while Gaussians are few": replace(RD, pyramid=replace(RD.pyramid, contrast_kept=np.inf)),
    "fewer steps for sparse Gaussians": replace(RD, schedule=replace(RD.schedule, sparse=-2.0, dense=-1.0)),
    "no growth at a price that found nothing": replace(RD, densify=replace(RD.densify, saturated=0.0)),
    "Gaussians dropped that are not worth their bits": replace(
        RD, prune=replace(RD.prune, worthless_bits=0.0, bits_of_dropped=0.0)
    ),
}
# Savings that are no settings: what tells that the scene allows them.
BY_PROPERTY = {"no Gaussians for a single colour": "is_one_colour", "no chroma for grey": "grey"}
SAVINGS = (*BY_SETTINGS, *BY_PROPERTY)


def drawn() -> dict[str, Pixels]:
    """The scenes that are no photographs."""
    across = np.linspace(0, 1, SIDE)
    x, y = np.meshgrid(across, across)
    gradient = np.stack([20 + 200 * x, 40 + 160 * y, 220 - 120 * x * y], axis=2)
    text = np.full((SIDE, SIDE, 3), 255, np.uint8)
    for k, line in enumerate(TEXT):
        cv2.putText(text, line, (8, 44 + 46 * k), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA)
    noise = np.random.default_rng(0).normal(128, 30, (SIDE, SIDE, 3))
    return {
        "one colour": np.full((SIDE, SIDE, 3), (90, 140, 200), np.uint8),
        "gradient": np.rint(gradient).astype(np.uint8),
        "text": text,
        "noise": np.clip(np.rint(noise), 0, 255).astype(np.uint8),
    }


def sparse() -> dict[str, Pixels]:
    """Large scenes that are nearly empty."""
    grey, white = (np.full((LARGE_SIDE, LARGE_SIDE, 3), level, np.uint8) for level in (128, 255))
    dot, line, word, stars = grey, grey.copy(), white, grey // 16
    dot[700, 900] = 255
    cv2.line(line, (100, 300), (1800, 1500), (255, 255, 255), 3, cv2.LINE_AA)
    cv2.putText(word, "word", (800, 1000), cv2.FONT_HERSHEY_SIMPLEX, 3, (0, 0, 0), 5, cv2.LINE_AA)
    rng = np.random.default_rng(0)
    for x, y in rng.integers(0, 16 * LARGE_SIDE, (200, 2)).tolist():
        cv2.circle(stars, (x, y), 20, (255, 255, 255), cv2.FILLED, cv2.LINE_AA, shift=4)
    return {"one dot": dot, "one line": line, "one word": word, "stars": stars}


def scenes(images: Path) -> dict[str, Pixels]:
    """All scenes by name. Raises OSError if a photograph is missing."""
    photographed = {
        scene: np.ascontiguousarray(read_image_8_bit((images / f"{name}.png").read_bytes())[y : y + SIDE, x : x + SIDE])
        for scene, (name, y, x) in PHOTOGRAPHED.items()
    }
    return drawn() | photographed


def without(saving: str) -> AbstractContextManager[object]:
    """Refuse a saving that is no setting, for as long as the context lasts."""
    name = BY_PROPERTY.get(saving)
    return patch.object(Problem, name, PropertyMock(return_value=False)) if name else nullcontext()


def encoded(pixels: Pixels, psnr: float, saving: str) -> tuple[Encoded, float]:
    """Encode without a saving ("" for none); return the file and the processor time in seconds."""
    with without(saving):
        began = time.process_time()
        file = encode(pixels, psnr=psnr, tune="psnr", settings=BY_SETTINGS.get(saving, RD))
        return file, time.process_time() - began


def of_sparse(scene: str) -> dict[str, float]:
    """Figures of a large scene, measured in this process."""
    pixels = sparse()[scene]
    encode(drawn()["gradient"], bytes=100)  # the first of a process loads what others find there
    before, began = peak_bytes(), time.process_time()
    s = encode(pixels, bytes=LARGE_BYTES).stats
    return {
        **{"gaussians": s.gaussians, "bytes": s.bytes, "psnr": min(s.psnr, EXACT_DB)},
        **{"cpu_s": time.process_time() - began, "mib": (peak_bytes() - before) / 2**20},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--images", type=Path, help="folder with Kodak's photographs")
    which.add_argument("--sparse", action="store_true")
    parser.add_argument("--psnr", type=float, default=34.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.sparse:
        record = Record(options.out or RUNS / "sparse.json", "benchmarks.scenes", {"bytes": LARGE_BYTES})
        for scene in sparse():
            if not record.has(scene=scene):
                with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as alone:  # its memory is its own
                    record.add({"scene": scene, **alone.submit(of_sparse, scene).result()})
        return
    record = Record(options.out or RUNS / "scenes.json", "benchmarks.scenes", {"psnr": options.psnr})
    for scene, pixels in scenes(options.images).items():
        if record.has(scene=scene):
            continue
        encode(pixels, psnr=options.psnr, tune="psnr")  # the first of a process loads what others find there
        took: dict[str, list[float]] = {saving: [] for saving in ("", *SAVINGS)}
        files = {}
        for _ in range(options.repeats):
            for saving, seconds in took.items():
                files[saving], once = encoded(pixels, options.psnr, saving)
                seconds.append(once)
        for saving, file in files.items():
            s = file.stats
            figures = {"gaussians": s.gaussians, "bytes": s.bytes, "psnr": min(s.psnr, EXACT_DB), "steps": s.steps}
            record.add({"scene": scene, "without": saving, **figures, "cpu_s": median(took[saving])})


if __name__ == "__main__":
    main()
