"""Quality of a fixed number of Gaussians in floating point, before any is coded.

The figures compare with those of other representations of that size. The fit is profile rd's. While Gaussians come and
go, bits have their price: it decides well which Gaussians stay. At the end bits are free.

    python -m benchmarks.representation --images FOLDER [--gaussians 5000,10000] [--steps 3000]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.machine import RESULTS, Record, in_words
from benchmarks.pictures import chosen_from
from sgmethod.bitstream import v3
from sgmethod.fitting.recorder import Clock, Recorder
from sgmethod.fitting.schedule import Schedule
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.profiles import RD, RdSettings, Times
from sgmethod.rd.fit import RdFit
from sgmethod.rd.rate_control import GAUSSIANS_GUESS, RateControl

# Of a fit that is longer than the profile's, as parts of its steps:
STEPS_OF_GROWTH = 40  # between two growths
GROWTH_UNTIL, TRIM_UNTIL = 0.6, 0.8
TRIMS = 8
FREE_FROM = 0.82  # bits are free


def lengthened(steps: int) -> RdSettings:
    """The profile with more steps. Gaussians come and go for longer too: in 4,000 steps, 60 growths make 0.2 dB more
    than ten growths and a longer rest."""
    if steps == RD.steps:
        return RD
    growths = max(round(GROWTH_UNTIL * steps / STEPS_OF_GROWTH), len(RD.times.growth_at))
    trim_from = GROWTH_UNTIL + 0.02
    return replace(
        RD,
        steps=steps,
        final_rate=0.1,
        times=Times(
            steering_from=0.03,
            growth_at=tuple(np.linspace(0.01, GROWTH_UNTIL, growths).tolist()),
            trim_at=tuple(np.linspace(trim_from, TRIM_UNTIL, TRIMS).tolist()),
            excess_from=0.7 * GROWTH_UNTIL,
            excess_until=TRIM_UNTIL,
            halved_until=RD.times.halved_until * RD.steps / steps,
        ),
    )


def measure(picture: Path, gaussians: int, settings: RdSettings) -> dict[str, Any]:
    """PSNR and MS-SSIM of the float Gaussians, rendered and rounded to 8 bits."""
    pixels = read_image_8_bit(picture.read_bytes())
    recorder = Recorder(Clock(), None)
    area = pixels.shape[0] * pixels.shape[1]
    quantum = 0.8 * GAUSSIANS_GUESS * area / gaussians  # leaves a few more to choose from
    began = time.perf_counter()
    control = RateControl(settings, area, quantum, max_gaussians=gaussians)
    fit = RdFit(pixels, control, 0, recorder.clock)

    def step(rate: float, progress: float) -> tuple[float, tuple[int, int]]:
        if progress >= FREE_FROM:
            fit.coder = fit.coder.with_quantum(v3.MIN_QUANTUM)
        return fit.step(rate, progress)

    Schedule("fit", settings.steps, settings.final_rate, patience=1.0).run(recorder, step)
    seconds = time.perf_counter() - began
    shown = pixels / np.float32(255) - fit.picture.residual(fit.p)(0, pixels.shape[0]).transpose(1, 2, 0)
    levels = np.round(np.clip(shown, 0, 1) * 255).astype(np.uint8)
    return {
        "image": picture.name,
        "gaussians": len(fit.p.means),
        "psnr": psnr(levels, pixels),
        "ms_ssim": ms_ssim(levels, pixels),
        "seconds": seconds,
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.representation", description=__doc__)
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--most", type=int, default=24, help="pictures, evenly spread over the folder")
    parser.add_argument("--gaussians", default="5000,10000", help="numbers, separated by commas")
    parser.add_argument("--steps", type=int, default=RD.steps)
    parser.add_argument("--out", type=Path, default=RESULTS / "representation.json")
    options = parser.parse_args()
    pictures = chosen_from(options.images, options.most)
    settings = lengthened(options.steps)
    torch.set_num_threads(1)
    record = Record(options.out, "benchmarks.representation", {"steps": options.steps})
    for asked in (int(n) for n in options.gaussians.split(",")):
        for picture in pictures:
            if not record.has(asked=asked, image=picture.name):
                record.add({"asked": asked, **measure(picture, asked, settings)})
    print(f"\n{in_words(record.content)}")


if __name__ == "__main__":
    main()
