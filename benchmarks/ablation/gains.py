"""Measure what the paper's start and regularisation gain in floating point, over all pictures of a folder.

    python -m benchmarks.ablation gains --images FOLDER [--device cuda] [--tables whole,numbers,optimiser,crops]
                                      [--seeds 3] [--minutes M]

whole      30,000 and 70,000 Gaussians on whole pictures: start and regularisation, each with and without the other
numbers    10,000 to 90,000 on the middle 384x256 of each picture: random, fixed 6:2:1 and dynamic
optimiser  GaussianImage's own optimiser, shapes and colours, on the middle 64x64: random, fixed and dynamic, and
           regularisation
crops      our optimiser on the same parts: random, fixed and dynamic

Numbers of Gaussians are for 768x512 pixels; smaller pictures have as many for each pixel, and n_0 and N_t with them.
All pictures of a row are fitted at once on a GPU.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import compress, product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import conv2d

from benchmarks.ablation.gaussian_image import Adan, AdanSettings, fit as fit_by_adan, shaped
from benchmarks.arguments import some_of
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels, add_options, middle_of, named_in
from benchmarks.tables import mean, number, standard_error, table
from sgmethod.backend.kernels import Kernels
from sgmethod.backend.protocol import CUTOFF_V1, Frame, Moments
from sgmethod.decoder import draw
from sgmethod.fitting.deadline import Clock, Deadline, cosine
from sgmethod.fitting.recorder import Recorder
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import ms_ssim, psnr
from sgmethod.paper import fit as paper
from sgmethod.scene import Gaussians, Scene
from sgmethod.settings.paper import PAPER, PaperSettings
from sgmethod.settings.shared import StartSettings
from sgmethod.start.placement import place_by_structure
from tests.definitions.backend import SOBEL

PIXELS = 768 * 512
Measured = dict[str, Any]  # a row of a JSON


@dataclass(frozen=True)
class Row:
    """A row of a table: fits of so many Gaussians on all pictures.

    middle: of a picture, in pixels; None for all of it; theirs: GaussianImage's optimiser, shapes and colours.
    """

    gaussians: int
    setting: str
    settings: PaperSettings
    middle: tuple[int, int] | None = None
    theirs: bool = False


def starting(of: PaperSettings, name: str) -> PaperSettings:
    """The same settings with another start."""
    start = {
        "random": replace(of.start, structure_guided=False),
        "fixed": replace(of.start, threshold_factor=math.inf),
        "dynamic": of.start,
    }
    return replace(of, start=start[name])


PLAIN = replace(PAPER, lambda_g=0.0, fit_steps=3000)
THEIRS = replace(PLAIN, fit_steps=50_000)


# Equation 11 divides by HW alone: as printed, channels are summed, which is three times their mean.
REGULARISED = {"": 0.0, " + regularisation": PAPER.lambda_g, " + regularisation as printed": 3 * PAPER.lambda_g}


def starts_of(n: int) -> tuple[str, ...]:
    """The starts that differ with so many Gaussians: the dynamic ratio begins as the fixed one."""
    return ("random", "fixed", "dynamic") if n > 30_000 else ("random", "dynamic")


TABLES: dict[str, list[Row]] = {
    "whole": [
        Row(n, f"{start}{' + regularisation' if weight else ''}", replace(starting(PLAIN, start), lambda_g=weight))
        for n in (70_000, 30_000)
        for weight in (0.0, PAPER.lambda_g)
        for start in ("random", "dynamic")
    ],
    "optimiser": [
        Row(n, f"{start}{name}", replace(starting(THEIRS, start), lambda_g=weight), (64, 64), theirs=True)
        for n in (70_000, 30_000)
        for name, weight in REGULARISED.items()
        for start in (starts_of(n) if weight == 0 else ("dynamic",))
    ],
    "crops": [Row(n, start, starting(PLAIN, start), (64, 64)) for n in (70_000, 30_000) for start in starts_of(n)],
    "numbers": [
        Row(n, start, starting(PLAIN, start), (384, 256))
        for n in (70_000, 90_000, 50_000, 30_000, 10_000)
        for start in starts_of(n)
    ],
}


@cache  # of several rows and seeds
def pixels_of(path: Path, middle: tuple[int, int] | None) -> Pixels:
    """A picture or its middle; turned where it is upright, so that all have one size."""
    pixels = read_image_8_bit(path.read_bytes())
    if pixels.shape[0] > pixels.shape[1]:
        pixels = np.rot90(pixels)
    if middle is not None:
        return middle_of(pixels, middle[1], middle[0])
    return np.ascontiguousarray(pixels)


def placed(row: Row, pixels: Pixels, seed: int) -> Gaussians:
    """The start of a row on a picture."""
    part = pixels.shape[0] * pixels.shape[1] / PIXELS
    start: StartSettings = row.settings.start
    k = start.threshold_factor * part ** (1 - start.threshold_exponent)  # so that N_t is that part, too
    start = replace(start, ratio_start=round(part * start.ratio_start), threshold_factor=k)
    image = pixels.astype(np.float32) / np.float32(255)
    rng = np.random.default_rng(seed)
    found = place_by_structure(image, round(part * row.gaussians), start, rng)
    return shaped(found, rng) if row.theirs else found


def on_cpu(row: Row, pixels: Pixels, start: Gaussians) -> Gaussians:
    """The fit of profile paper, or GaussianImage's."""
    clock = Clock()
    level = paper.level_of(pixels)
    if row.theirs:
        gradient_of = partial(by_clamped, lambda_g=row.settings.lambda_g)
        return fit_by_adan(start, torch.from_numpy(level.image()), AdanSettings(), row.settings.fit_steps, gradient_of)
    return paper.fit(level, start, row.settings, Recorder(clock), Deadline.from_limit(clock, None))[0]


def on_gpu(
    device: str, ends: float, row: Row, pixels: Sequence[Pixels], starts: Sequence[Gaussians]
) -> list[Gaussians]:
    """The same fits, all at once: rows differ in their starts alone."""
    from sgmethod.torch.tiles import Tiles

    s, (height, width) = row.settings, pixels[0].shape[:2]
    max_count = max(map(len, starts))
    arrays = zip(*(one.arrays for one in starts), strict=True)
    filled = [np.stack([np.pad(one, ((0, max_count - len(one)), (0, 0))) for one in of]) for of in arrays]
    values = [torch.from_numpy(of).to(device) for of in filled]
    target = torch.from_numpy(np.stack(pixels)).to(device).permute(0, 3, 1, 2).float().div(255).contiguous()
    frame = Frame(width, height, CUTOFF_V1, pyramid=False)
    moments, adan = Moments.none(len(pixels) * max_count), Adan(AdanSettings(), width, height)
    nowhere = torch.tensor([len(one) for one in starts], device=device)[:, None] <= torch.arange(
        max_count, device=device
    )
    for step in range(s.fit_steps):
        if time.monotonic() > ends:
            raise TimeoutError(f"no time is left after {step} steps")
        tiles = Tiles(frame, *values)
        gradient = tiles.gradients((by_clamped if row.theirs else by_picture)(tiles.draw(), target, s.lambda_g))
        if row.theirs:
            adan.step(values, gradient)
        else:  # by the kernels on the CPU, as in on_cpu()
            moving, by = (Gaussians(*(one.flatten(0, 1).cpu().numpy() for one in of)) for of in (values, gradient))
            rate = cosine(s.optimiser.final_rate, step / s.fit_steps)
            Kernels().step(moving, by, moments, s.optimiser, rate, 1)
            for one, moved in zip(values, moving.arrays, strict=True):
                one.copy_(torch.from_numpy(moved).view_as(one))
        values[1][nowhere] = 0
    found = [of.cpu().numpy() for of in values]
    return [Gaussians(*(of[k, : len(one)].copy() for of in found)) for k, one in enumerate(starts)]


def by_picture(drawn: Tensor, target: Tensor, lambda_g: float) -> Tensor:
    """The gradient [B, 3, H, W] of MSE + lambda_g L_g by each picture drawn."""
    left = drawn - target
    numel = left[0].numel()
    if lambda_g == 0:
        return left * (2 / numel)
    kernels = torch.stack([SOBEL, SOBEL.T])[:, None].to(left)
    planes = left.flatten(0, 1)[:, None]
    with torch.enable_grad():
        planes.requires_grad_()
        wanted = conv2d(target.flatten(0, 1)[:, None], kernels).abs()
        loss = (planes.square().sum() + lambda_g * (wanted * conv2d(planes, kernels).square()).sum()) / numel
        (found,) = torch.autograd.grad(loss, planes)
    return found.view_as(left)


def by_clamped(drawn: Tensor, target: Tensor, lambda_g: float) -> Tensor:
    """The same as by_picture() where the picture is clamped to 0..1 before the loss, as GaussianImage does."""
    return by_picture(drawn.clamp(0, 1), target, lambda_g) * ((drawn >= 0) & (drawn <= 1))


def judged(pixels: Pixels, gaussians: Gaussians) -> dict[str, Any]:
    """The figures of a fit."""
    height, width = pixels.shape[:2]
    shown = draw(Scene(gaussians, width, height, (0, 0, 0), CUTOFF_V1, False))
    seen = ms_ssim(shown, pixels) if min(width, height) > 160 else None
    return {"gaussians": len(gaussians), "psnr": psnr(shown, pixels), "ms_ssim": seen}


def measure(
    record: Record, name: str, device: str, ends: float, paths: Sequence[Path], together: Sequence[Row], seeds: int
) -> None:
    """Measure rows that differ in their starts alone: on a GPU all at once."""
    cases = [*product(paths, together, range(seeds))]
    keys = [
        {"table": name, "asked": row.gaussians, "setting": row.setting, "image": path.stem, "seed": seed}
        for path, row, seed in cases
    ]
    every = [(row, pixels_of(path, row.middle), seed) for path, row, seed in cases]
    missing = [not record.has(**key) for key in keys]
    if device == "cpu":
        torch.set_num_threads(1)  # or its threads and the kernels' would wait for each other
        for key, (row, pixels, seed) in zip(compress(keys, missing), compress(every, missing), strict=True):
            if time.monotonic() < ends:
                record.add({**key, **judged(pixels, on_cpu(row, pixels, placed(row, pixels, seed)))})
    elif any(missing):
        rows, pictures, of_seeds = zip(*every, strict=True)
        with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:  # of whom none has touched the GPU
            found = on_gpu(device, ends, rows[0], pictures, [*pool.map(placed, rows, pictures, of_seeds)])
            for key, figures in zip(keys, pool.map(judged, pictures, found), strict=True):
                record.add({**key, **figures})


def summary(rows: Sequence[Measured]) -> str:
    """A table of means over pictures, and of the gains of each row over those before it."""
    lines = []
    every: dict[tuple[str, int, str], dict[str, list[Measured]]] = {}  # by picture, a row for each seed
    for row in rows:
        every.setdefault((row["table"], row["asked"], row["setting"]), {}).setdefault(row["image"], []).append(row)
    for name, asked in dict.fromkeys((name, row.gaussians) for name, of in TABLES.items() for row in of):
        settings = [row.setting for row in TABLES[name] if row.gaussians == asked]
        by = {setting: found for setting in settings if (found := every.get((name, asked, setting)))}
        for k, (setting, found) in enumerate(by.items()):
            psnr = number(mean([figure(rows, "psnr") for rows in found.values()]), ".2f")
            cells = [name, f"{asked:,}", setting, len(found), psnr]
            lines += [[*cells, *gain(found, by[other], other)] for other in [*by][:k]] or [[*cells, "", "", "", "", ""]]
    titles = "table | Gaussians | start | pictures | PSNR | against | dB | standard error | MS-SSIM | better on"
    return table(titles, lines)


def figure(rows: Sequence[Measured], name: str) -> float:
    """The mean of a figure over the seeds of one picture; NaN where it was not measured."""
    return statistics.fmean(math.nan if row[name] is None else row[name] for row in rows)


def gain(found: dict[str, list[Measured]], others: dict[str, list[Measured]], other: str) -> list[str]:
    """The cells of a gain over another setting, over the pictures of both. The error is over pictures."""
    pairs = [(rows, others[image]) for image, rows in found.items() if image in others]
    db = [figure(rows, "psnr") - figure(its, "psnr") for rows, its in pairs]
    seen = mean([by for rows, its in pairs if not math.isnan(by := figure(rows, "ms_ssim") - figure(its, "ms_ssim"))])
    better = f"{sum(one > 0 for one in db)} of {len(db)}"
    return [other, number(mean(db), "+.2f"), number(standard_error(db), ".2f"), number(seen, "+.5f"), better]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ablation gains",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_options(parser, most=24)
    parser.add_argument("--tables", type=some_of(tuple(TABLES), "table"), default=",".join(TABLES))
    parser.add_argument("--numbers", type=lambda text: [int(n) for n in text.split(",")], help="of Gaussians; all")
    parser.add_argument("--settings", type=lambda text: text.split(","), help="of a table's rows; all")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--steps", type=int, help="of each fit, instead of a table's own")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=math.inf, help="no fit goes on for longer")
    parser.add_argument("--out", type=Path, default=RUNS / "gains.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.ablation gains", {"steps": options.steps})
    paths, ends = named_in(options), time.monotonic() + 60 * options.minutes
    for name in options.tables:
        alike: dict[tuple[int, float], list[Row]] = {}
        for row in TABLES[name]:
            numbers, settings = options.numbers or [row.gaussians], options.settings or [row.setting]
            if row.gaussians in numbers and row.setting in settings:
                s = replace(row.settings, fit_steps=options.steps or row.settings.fit_steps)
                alike.setdefault((row.gaussians, s.lambda_g), []).append(replace(row, settings=s))
        for together in alike.values():
            if time.monotonic() < ends:
                measure(record, name, options.device, ends, paths, together, options.seeds)
    print(f"\n{summary(record.rows)}")
