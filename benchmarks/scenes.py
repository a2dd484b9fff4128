"""What a scene does not need: Gaussians, bytes and seconds by content at one PSNR, and what each saving saves.

    SG_THREADS=1 python -m benchmarks.scenes --images KODAK [--psnr 34] [--repeats 3]
    SG_THREADS=1 python -m benchmarks.scenes --large PHOTOGRAPHS [--megapixels 4,12] [--bytes 1000,50000]

Scenes have 256x256 pixels: half are parts of Kodak's photographs, half are drawn here. --large encodes large pictures
that are nearly empty or smooth, beside a photograph full of texture, with a budget, because one colour exceeds any
PSNR; its folder has photographs of 12 megapixels. Seconds are processor time, on which other work on the machine has
little effect.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import product
from pathlib import Path
from statistics import median
from unittest.mock import PropertyMock, patch

import cv2
import numpy as np

from benchmarks.arguments import integers, numbers
from benchmarks.machine import RUNS, Record, alone, forget_peak, peak_bytes
from benchmarks.pictures import Pixels
from benchmarks.speed.growth import reduced
from sgmethod import Encoded, encode
from sgmethod.io.image import read_image_8_bit
from sgmethod.rd.problem import Problem
from sgmethod.rd.rate_control import EXACT_DB

SIDE = 256
PHOTOGRAPHED = {  # a picture of Kodak's, and the scene's first row and column
    "sky": ("kodim19", 0, 0),
    "face": ("kodim04", 180, 190),
    "foliage": ("kodim13", 100, 0),
    "facade": ("kodim08", 200, 300),
}
TEXTURED, SMOOTH = "textured photograph", "smooth photograph"
LARGE = {SMOOTH: "peony.jpg", TEXTURED: "two_samoyeds.jpg"}
TEXT = ("Structure-guided", "allocation of 2D", "Gaussians: more of", "them where there is", "more to be seen")

# Each saving, and the constants that refuse it.
BY_CONSTANTS: dict[str, dict[str, float]] = {
    "reduced pictures while Gaussians are few": {"fitting.level.CONTRAST_KEPT": np.inf},
    "fewer steps for sparse Gaussians": {"rd.schedule.SPARSE": -2.0, "rd.schedule.DENSE": -1.0},
    "no growth at a price that found nothing": {"rd.densify.SATURATED": 0.0},
    "Gaussians dropped that are not worth their bits": {
        "rd.densify.WORTHLESS_BITS": 0.0,
        "rd.densify.BITS_OF_DROPPED": 0.0,
    },
}
# Savings by what tells that the scene allows them.
BY_PROPERTY = {"no Gaussians for a single colour": "is_one_colour", "no chroma for grey": "grey"}
SAVINGS = (*BY_CONSTANTS, *BY_PROPERTY)


def gradient(side: int) -> Pixels:
    """Colours that change evenly from corner to corner."""
    x, y = np.meshgrid(*2 * [np.linspace(0, 1, side)])
    return np.rint(np.stack([20 + 200 * x, 40 + 160 * y, 220 - 120 * x * y], axis=2)).astype(np.uint8)


def drawn() -> dict[str, Pixels]:
    """The scenes that are no photographs."""
    text = np.full((SIDE, SIDE, 3), 255, np.uint8)
    for k, line in enumerate(TEXT):
        cv2.putText(text, line, (8, 44 + 46 * k), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA)
    noise = np.random.default_rng(0).normal(128, 30, (SIDE, SIDE, 3))
    return {
        "one colour": np.full((SIDE, SIDE, 3), (90, 140, 200), np.uint8),
        "gradient": gradient(SIDE),
        "text": text,
        "noise": np.clip(np.rint(noise), 0, 255).astype(np.uint8),
    }


def sparse(side: int) -> dict[str, Pixels]:
    """Large scenes that are nearly empty."""
    grey, white = (np.full((side, side, 3), level, np.uint8) for level in (128, 255))
    dot, line, word, stars = grey, grey.copy(), white, grey // 16
    at = side / 2000
    dot[int(700 * at), int(900 * at)] = 255
    ends = [(int(x * at), int(y * at)) for x, y in ((100, 300), (1800, 1500), (800, 1000))]
    cv2.line(line, ends[0], ends[1], (255, 255, 255), 3, cv2.LINE_AA)
    cv2.putText(word, "word", ends[2], cv2.FONT_HERSHEY_SIMPLEX, 3, (0, 0, 0), 5, cv2.LINE_AA)
    rng = np.random.default_rng(0)
    for x, y in rng.integers(0, 16 * side, (200, 2)).tolist():
        cv2.circle(stars, (x, y), 20, (255, 255, 255), cv2.FILLED, cv2.LINE_AA, shift=4)
    return {"one dot": dot, "one line": line, "one word": word, "stars": stars}


def large(scene: str, megapixels: float, photographs: Path) -> Pixels:
    """A large scene of about that size."""
    if scene in LARGE:
        return reduced(read_image_8_bit((photographs / LARGE[scene]).read_bytes()), megapixels)
    side = round(math.sqrt(1e6 * megapixels))
    return gradient(side) if scene == "gradient" else sparse(side)[scene]


def scenes(images: Path) -> dict[str, Pixels]:
    """All scenes by name. Raises OSError if a photograph is missing."""
    photographed = {
        scene: np.ascontiguousarray(read_image_8_bit((images / f"{name}.png").read_bytes())[y : y + SIDE, x : x + SIDE])
        for scene, (name, y, x) in PHOTOGRAPHED.items()
    }
    return drawn() | photographed


@contextmanager
def without(saving: str) -> Iterator[None]:
    """Refuse a saving, if one is named, for as long as the context lasts."""
    with ExitStack() as patched:
        for name, value in BY_CONSTANTS.get(saving, {}).items():
            patched.enter_context(patch(f"sgmethod.{name}", value))
        if saving in BY_PROPERTY:
            patched.enter_context(patch.object(Problem, BY_PROPERTY[saving], PropertyMock(return_value=False)))
        yield


def encoded(pixels: Pixels, psnr: float, saving: str) -> tuple[Encoded, float]:
    """Encode without a saving ("" for none); return the file and the processor time in seconds."""
    with without(saving):
        began = time.process_time()
        file = encode(pixels, psnr=psnr, tune="psnr")
        return file, time.process_time() - began


def of_large(scene: str, megapixels: float, max_bytes: int, photographs: Path) -> dict[str, float]:
    """Figures of a large scene, measured in this process."""
    pixels = large(scene, megapixels, photographs)
    encode(drawn()["gradient"], bytes=100)  # the first of a process loads what others find there
    before, began = forget_peak(), time.process_time()
    s = encode(pixels, bytes=max_bytes).stats
    return {
        **{"gaussians": s.gaussians, "bytes": s.bytes, "psnr": min(s.psnr, EXACT_DB)},
        **{"cpu_s": time.process_time() - began, "mib": (peak_bytes() - before) / 2**20},
    }


def measure_large(options: argparse.Namespace) -> None:
    """Measure each large scene, size and budget in a process of its own, whose memory is its own."""
    record = Record(options.out or RUNS / "sparse.json", "benchmarks.scenes", {})
    for key in product(options.megapixels, options.bytes, (*sparse(64), "gradient", *LARGE)):
        megapixels, max_bytes, scene = key
        named = {"scene": scene, "megapixels": megapixels, "max_bytes": max_bytes}
        if not record.has(**named):
            record.add({**named, **alone(of_large, scene, megapixels, max_bytes, options.large)})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--images", type=Path, help="folder with Kodak's photographs")
    which.add_argument("--large", type=Path, help="folder with large photographs")
    parser.add_argument("--megapixels", type=numbers, default="4,12", help="of --large")
    parser.add_argument("--bytes", type=integers, default="1000,50000", help="of --large, at most")
    parser.add_argument("--psnr", type=float, default=34.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if options.large:
        measure_large(options)
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
