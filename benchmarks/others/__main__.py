"""Methods that the paper compares with and quotes, fitted here for the same time: python -m benchmarks.others

    python -m benchmarks.others --images FOLDER [--most 6] [--pictures kodim05] [--sides 192,128] [--seconds 8]
                                [--bpp 0.6] [--methods ingp,2dgs,...]

representation: I-NGP and NeuRBF with as many numbers as profile paper's Gaussians have, whose fit stands beside them;
as many Gaussians as 70,000 are on 768x512 pixels. compression: files of 2DGS and of 3D-GS flattened to the picture
within --bpp, decoded again; a file of profile rd, tuned for PSNR, stands beside them. Everything but our kernels is
plain torch. Seconds are those of the processor, on one thread; a file of profile rd takes what it takes. Pictures are
reduced to --sides, or what is as large and lies the other way, so that slow methods get anywhere.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from benchmarks.ablation.fits import FLOAT, fit_of_paper
from benchmarks.ablation.paper import PIXELS
from benchmarks.arguments import integers, some_of
from benchmarks.convergence.network import Training, drawn
from benchmarks.machine import RUNS, Record
from benchmarks.others.fields import ingp, neurbf
from benchmarks.others.splats import ENTRIES_BITS, FlatSplats, Splats, bits_of
from benchmarks.pictures import Pixels, add_options, named_in
from sgmethod import decode, encode
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import ms_ssim, psnr

DENSE, NUMBERS = 70_000, 8  # Gaussians of 768x512 pixels; numbers of each
LEAST = 6000  # pixels: with fewer, networks have more numbers than Gaussians have
FIELDS = {"ingp": ingp, "neurbf": neurbf}
SPLATS = {"2dgs": Splats, "3dgs": FlatSplats}
TABLES = {"representation": ("paper", *FIELDS), "compression": (*SPLATS, "rd")}
METHODS = tuple(name for names in TABLES.values() for name in names)
Found = tuple[Pixels, dict[str, Any]]  # what is shown, and figures


class ProcessorClock(Clock):
    """A clock of processor time, so that every method gets as much on a busy machine."""

    def __init__(self) -> None:
        super().__init__()
        self._began = time.process_time()

    def seconds(self) -> float:
        return time.process_time() - self._began


def stepped(step: Callable[[], None], seconds: float) -> int:
    """Repeat a step for a number of seconds of the processor; the number of steps."""
    until, steps = time.process_time() + seconds, 0
    while time.process_time() < until:
        step()
        steps += 1
    return steps


def represented(method: str, pixels: Pixels, seconds: float) -> Found:
    """Fit a picture by numbers in floating point."""
    gaussians = round(DENSE * pixels[..., 0].size / PIXELS)
    if method in FIELDS:
        network = FIELDS[method](NUMBERS * gaussians, pixels)
        steps = stepped(Training(network, pixels).step, seconds)
        numbers = sum(one.numel() for one in network.numbers)
        return drawn(network, pixels.shape), {"numbers": numbers, "steps": steps}
    fit = fit_of_paper(pixels, gaussians, replace(FLOAT, fit_steps=100_000), 0, ProcessorClock(), seconds)
    return draw(fit.scene), {"numbers": NUMBERS * len(fit.gaussians), "steps": fit.steps}


def compressed(method: str, pixels: Pixels, seconds: float, bpp: float) -> Found:
    """Code a picture as a file."""
    size = pixels[..., 0].size
    if method == "rd":
        data = encode(pixels, bpp=bpp, tune="psnr").data
        return decode(data), {"bytes": len(data)}
    each, beside = bits_of(SPLATS[method])
    splats = SPLATS[method](pixels, max(int((bpp * size - beside) / each), 1 << ENTRIES_BITS))
    steps = stepped(splats.step, seconds)
    data = splats.data()
    splats.take(data)
    return splats.picture(), {"bytes": len(data), "steps": steps}


def reduced(path: Path, sides: list[int]) -> Pixels:
    """A picture reduced to the sides, lying or standing as it is."""
    pixels = read_image_8_bit(path.read_bytes())
    long, short = max(sides), min(sides)
    size = (long, short) if pixels.shape[1] >= pixels.shape[0] else (short, long)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser, most=6)
    parser.add_argument("--sides", type=integers, default="192,128")
    parser.add_argument("--seconds", type=float, default=8.0, help="of each fit")
    parser.add_argument("--bpp", type=float, default=0.6, help="of each file, at most")
    parser.add_argument("--methods", type=some_of(METHODS, "method"), default=",".join(METHODS))
    parser.add_argument("--out", type=Path, default=RUNS / "others.json")
    options = parser.parse_args()
    if len(options.sides) != 2 or options.sides[0] * options.sides[1] < LEAST:
        parser.error(f"--sides takes two, of {LEAST:,} pixels at least")
    torch.set_num_threads(1)
    settings = {"sides": options.sides, "seconds": options.seconds, "bpp": options.bpp}
    record = Record(options.out, "benchmarks.others", settings)
    for path in named_in(options):
        pixels = reduced(path, options.sides)
        for method in options.methods:
            key = {"table": next(of for of, names in TABLES.items() if method in names), "method": method}
            if record.has(**key, image=path.name):
                continue
            began = time.process_time()
            if key["table"] == "representation":
                shown, figures = represented(method, pixels, options.seconds)
            else:
                shown, figures = compressed(method, pixels, options.seconds, options.bpp)
            figures |= {"seconds": time.process_time() - began, "psnr": psnr(shown, pixels)}
            record.add({**key, "image": path.name, **figures, "ms_ssim": ms_ssim(shown, pixels)})


if __name__ == "__main__":
    main()
