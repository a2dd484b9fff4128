"""What a scene did not need: bytes of the file, what the file left out, what the fit left out, and the time saved.

    python -m benchmarks.needs [--scenes flat,text] [--quality 50] [--side 256] [--repeats 5] [--out FILE]

Each scene is encoded at one quality, which asks all for the same fineness, so that bytes show what each needed. Beside
it stand an encode with the same steps, all of them on the whole picture, in turns, for the time that smaller pictures
saved; and the bytes of WebP without loss, as sharp lines of few colours need no Gaussians at all.
"""

from __future__ import annotations

import argparse
import io
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from benchmarks.arguments import some_of
from benchmarks.bits import by_kind
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels
from benchmarks.stiff.drawings import chart, screenshot, text
from sgmethod import Budget, Encoded, encode, info
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import Frame, Target, Visibility
from sgmethod.fitting.deadline import Clock, Deadline
from sgmethod.fitting.objective import Objective
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.profiles import DEFAULT_TUNE
from sgmethod.rd import encode as rd
from sgmethod.rd.rate_control import RateControl
from sgmethod.rd.request import Request
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import RD, sized
from tests.harness.data import PHOTOGRAPHS

PHOTOGRAPH = PHOTOGRAPHS / "kodim23-crop.png"


def flat(side: int) -> Pixels:
    """One colour."""
    return np.full((side, side, 3), (90, 140, 200), np.uint8)


def gradient(side: int) -> Pixels:
    """Colours that change slowly from corner to corner."""
    y, x = np.mgrid[0:side, 0:side] / (side - 1)
    return np.round(np.stack([255 * x, 128 + 60 * (y - x), 255 * (1 - y)], axis=2)).astype(np.uint8)


def line_art(side: int) -> Pixels:
    """Black outlines on white."""
    pixels = np.full((side, side, 3), 255, np.uint8)
    random = np.random.default_rng(0)
    for _ in range(8):
        x, y, a, b, angle = (int(value) for value in random.integers(side // 8, side - side // 8, 5))
        cv2.ellipse(pixels, (x, y), (a // 3, b // 3), angle, 0, 360, (0, 0, 0), 2, cv2.LINE_AA)
    return pixels


def photograph(side: int) -> Pixels:
    """The middle of a test picture, brought to size."""
    pixels = read_image_8_bit(PHOTOGRAPH.read_bytes())
    least = min(pixels.shape[:2])
    y, x = (pixels.shape[0] - least) // 2, (pixels.shape[1] - least) // 2
    shown = cv2.resize(pixels[y : y + least, x : x + least], (side, side), interpolation=cv2.INTER_AREA)
    return np.asarray(shown, np.uint8)


def grey(side: int) -> Pixels:
    """The photograph without its colours."""
    return np.repeat(photograph(side).mean(axis=2, keepdims=True).round().astype(np.uint8), 3, axis=2)


def noise(side: int) -> Pixels:
    """Every level of every channel as likely as any other."""
    return np.random.default_rng(0).integers(0, 256, (side, side, 3), np.uint8)


def mostly_empty(side: int) -> Pixels:
    """White, with a small part of the photograph in one corner."""
    pixels = np.full((side, side, 3), 255, np.uint8)
    small = side // 5
    pixels[small : 2 * small, small : 2 * small] = photograph(small)
    return pixels


SCENES: dict[str, Callable[[int], Pixels]] = {
    "flat": flat,
    "gradient": gradient,
    "mostly empty": mostly_empty,
    "grey": grey,
    "photograph": photograph,
    "line art": line_art,
    "text": text,
    "screenshot": screenshot,
    "chart": chart,
    "noise": noise,
}


class Counting(Kernels):
    """Counts steps on each size of the picture, by its spacing in pixels of the whole."""

    def __init__(self) -> None:
        self.steps: Counter[int] = Counter()
        self._spacing = 1

    def gradients(
        self, gaussians: Gaussians, frame: Frame, target: Target, visibility: Visibility | None = None
    ) -> tuple[float, Gaussians]:
        """As Backend.gradients."""
        self._spacing = frame.spacing
        return super().gradients(gaussians, frame, target, visibility)

    def step(self, *arguments: Any, **named: Any) -> None:
        """As Backend.step."""
        self.steps[self._spacing] += 1
        super().step(*arguments, **named)


def steps_by_spacing(pixels: Pixels, budget: Budget) -> Counter[int]:
    """Steps of an encode on each size of the picture."""
    height, width = pixels.shape[:2]
    backend, clock, settings = Counting(), Clock(), sized(RD, width * height)
    objective = Objective.of(pixels, DEFAULT_TUNE, settings.objective)
    rate = RateControl.of(budget, (width, height), settings)
    rd.encode(Request(objective, rate, Deadline(clock), backend, settings, Recorder(clock)))
    return backend.steps


def measure(pixels: Pixels, quality: float, repeats: int) -> dict[str, Any]:
    """One scene: the file, the fit, and the same with the whole picture in every step, in turns."""
    budget = Budget("quality", quality)
    encoded = encode(pixels, budget)
    at_full_size = replace(RD, pyramid=replace(RD.pyramid, halvings=0))
    seconds, whole = [], []
    for _ in range(repeats):
        seconds.append(encode(pixels, budget).stats.seconds)
        whole.append(encode(pixels, budget, settings=at_full_size).stats.seconds)
    stats, asked = encoded.stats, scheduled(encoded)
    bits = dict(info(encoded.data).bits)
    del bits["payload"]
    return {
        "bytes": stats.bytes,
        "lossless_bytes": lossless_bytes(pixels),
        "psnr": stats.to_dict()["psnr"],
        "gaussians": stats.gaussians,
        "bits": bits | {kind: round(count) for kind, count in by_kind(encoded.data).items()},
        "left_out_of_the_file": left_out(encoded),
        "steps": stats.steps,
        "steps_scheduled": asked,
        "steps_by_spacing": {str(at): count for at, count in sorted(steps_by_spacing(pixels, budget).items())},
        "seconds": seconds,
        "seconds_whole": whole,
    }


def lossless_bytes(pixels: Pixels) -> int:
    """Of WebP, at its slowest."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, quality=100, method=6)
    return len(file.getvalue())


def scheduled(encoded: Encoded) -> int:
    """Steps that the fit would have had if it had not come to rest before."""
    return max(point.steps for point in encoded.trace)


def left_out(encoded: Encoded) -> list[str]:
    """What the file says that it does without."""
    fields = info(encoded.data).to_dict()
    if fields["gaussians"] == 0:
        return ["Gaussians"]
    flags = {"chroma": fields["grey"], "shear": fields["upright"], "texture": not fields["texture"]}
    return [name for name, missing in flags.items() if missing]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=some_of(SCENES, "scene"), default=",".join(SCENES))
    parser.add_argument("--quality", type=float, default=50)
    parser.add_argument("--side", type=int, default=256, help="pixels, 256 or more")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--out", type=Path, default=RUNS / "needs.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.needs", {"quality": options.quality, "side": options.side})
    encode(flat(16), bytes=100)  # what the first encode of a process loads is no scene's
    for name in options.scenes:
        if not record.has(scene=name):
            row = measure(SCENES[name](options.side), options.quality, options.repeats)
            record.add({"scene": name, **row})


if __name__ == "__main__":
    main()
