"""Measure everything that runs on a GPU, in eight minutes at most. Each row is written as soon as it is measured.

    python -m benchmarks.gpu --images FOLDER --out JSON

errors     values and gradients of the kernels on the device against float64 there, relative to the largest
decode     pictures a second, from Gaussians in memory to pictures in memory, and from a file's bytes
steps      a step of batches of fits, its price of bits included
fits       sgmethod.torch.fit of 10,000, 30,000 and 70,000 Gaussians: seconds, PSNR and memory
batches    the same of pictures of 256 x 256 by 1,000 Gaussians, 1, 16 and 256 at a time

A second call continues where the first one stopped; rows for which no time is left are skipped. --quick runs the first
three at the smallest sizes on the CPU, in Triton's interpreter. That tests the command, but measures nothing.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import torch
from torch import Tensor

import sgmethod
import sgmethod.torch
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels, pictures_in, sized
from sgmethod.backend.protocol import CUTOFF, Descent, Frame, Moments
from sgmethod.fitting.level import Histogram, target_of
from sgmethod.io.image import read_image_8_bit
from sgmethod.scene import Gaussians
from sgmethod.settings.rd import NEWTON_ADAM
from sgmethod.torch.pairs import Pairs

Row = dict[str, Any]
LIMIT_S = 400  # no row begins later, and fits stop then, so that the last one ends within eight minutes
Measured = tuple[Row, Callable[[], Row]]  # what tells a row apart, and its values


@dataclass(frozen=True)
class Sizes:
    """The sizes to measure: megapixels and Gaussians of pictures, pictures of a batch, repetitions."""

    decoded: tuple[tuple[float, int], ...] = ((0.4, 10_000), (2.0, 50_000), (12.0, 200_000))
    fitted: tuple[int, ...] = (10_000, 30_000, 70_000)
    batches: tuple[int, ...] = (1, 16, 256)
    side: int = 256  # of a batch's pictures
    each: int = 1000  # Gaussians of one of them
    repeats: int = 50


QUICK = Sizes(((0.001, 10),), (), (1, 2), 16, 5, 1)


class Bench:
    """All measurements on a device, with a folder of pictures."""

    def __init__(self, device: torch.device, paths: list[Path], sizes: Sizes) -> None:
        self.device, self.paths, self.sizes = device, paths, sizes
        self.ends = time.monotonic() + LIMIT_S

    def rows(self) -> Iterator[Measured]:
        """All rows, beginning with the errors, on which the trust in the others depends."""
        s = self.sizes
        for megapixels, n in s.decoded[:2]:
            for pyramid in (True, False):
                key = {"what": "errors", "megapixels": megapixels, "gaussians": n, "pyramid": pyramid}
                yield key, partial(self.errors, megapixels, n, pyramid)
        for megapixels, n in s.decoded:
            for batch in (1, 2 if s is QUICK else 16):
                key = {"what": "decode", "megapixels": megapixels, "gaussians": n, "pictures": batch}
                yield key, partial(self.decode, megapixels, n, batch)
            key = {"what": "decode bytes", "megapixels": megapixels, "gaussians": n}
            yield key, partial(self.decode_bytes, megapixels, n)
        for batch in s.batches:
            key = {"what": "steps", "pictures": batch, "side": s.side, "gaussians": s.each}
            yield key, partial(self.steps, batch)
        for n in s.fitted:
            for path in (self.paths[0], self.paths[len(self.paths) // 2]):
                pixels = partial(self._pictures, 1, path)
                yield {"what": "fits", "picture": path.stem, "gaussians": n}, partial(self.fit, pixels, n)
        for batch in s.batches if s.fitted else ():
            key = {"what": "batches", "pictures": batch, "side": s.side, "gaussians": s.each}
            yield key, partial(self.fit, partial(self._pictures, batch), s.each)

    def errors(self, megapixels: float, n: int, pyramid: bool) -> Row:
        """The kernels against lists of pairs in double precision."""
        from sgmethod.torch.tiles import Tiles

        width, height = self._size(megapixels)
        values = self._gaussians(width, height, n, 1)
        by_image = torch.randn(1, 3, height, width, generator=torch.Generator().manual_seed(0)).to(self.device)
        drawn = Tiles(Frame(width, height, CUTOFF, pyramid), *values)
        means, factors, colors = (one[0].double() for one in values)
        pairs = Pairs(means, factors, (width, height), CUTOFF, pyramid)
        found = drawn.draw(), *drawn.gradients(by_image)
        true = pairs.draw(colors), *pairs.gradients(colors, by_image[0].double())
        names = "of_picture", "of_means", "of_factors", "of_colors"
        return {name: _worst(one[0], other) for name, one, other in zip(names, found, true, strict=True)}

    def decode(self, megapixels: float, n: int, batch: int) -> Row:
        """Drawn pictures a second, as the paper counts them."""
        from sgmethod.torch.tiles import Tiles

        width, height = self._size(megapixels)
        values = self._gaussians(width, height, n, batch)

        def draw() -> Tensor:
            return Tiles(Frame(width, height), *values).draw()

        return {"per_second": batch / self._seconds(draw)}

    def decode_bytes(self, megapixels: float, n: int) -> Row:
        """Bits on the CPU, drawing on the device; beside decode(), which draws on the CPU."""
        data = sgmethod.encode(sized(self.paths, 0, megapixels), gaussians=n, effort=1, tune="psnr").data
        drawn = sgmethod.torch.draw(data, self.device).permute(1, 2, 0).cpu().numpy().astype(int)
        row = {"bytes": len(data), "max_levels": int(np.abs(drawn - sgmethod.decode(data)).max())}
        on_device = self._seconds(lambda: sgmethod.torch.draw(data, self.device))
        return {
            **row,
            "per_second": 1 / on_device,
            "per_second_on_cpu": 1 / self._seconds(lambda: sgmethod.decode(data)),
        }

    def steps(self, batch: int) -> Row:
        """Milliseconds of a step, and the error that some of them leave from a random start."""
        from sgmethod.torch.batched import BatchedTensors

        side, n, count = self.sizes.side, self.sizes.each, 2 * self.sizes.repeats
        backend, frame, price = BatchedTensors(self.device, 1, Event()), Frame(side, side), 1e-4 / (3 * side * side)
        means, factors, colors = (values.cpu().numpy() for values in self._gaussians(side, side, n, batch))
        fits = []
        for k, picture in enumerate(self._pictures(batch)):
            target = target_of(picture, Histogram(picture).background)
            descent = Descent(frame, target, None, 0.3, price, side, side, NEWTON_ADAM)
            fits.append((Gaussians(means[k], factors[k], 0 * colors[k]), Moments.none(n), descent))

        def error() -> float:
            return statistics.mean(backend.error(one, frame, descent.target) for one, _, descent in fits)

        first = error()
        seconds = self._seconds(lambda: backend.steps_of(fits, [1.0] * count), 1) / count
        last = error()
        return {"step_ms": 1e3 * seconds, "first_error": first, "last_error": last, "finite": bool(np.isfinite(last))}

    def fit(self, pictures: Callable[[], Pixels], n: int) -> Row:
        """Fit a batch by the public function."""
        images = torch.from_numpy(pictures()).permute(0, 3, 1, 2).to(self.device)
        torch.cuda.reset_peak_memory_stats()
        began = time.perf_counter()
        found = sgmethod.torch.fit(images, n, stop=lambda: time.monotonic() > self.ends)
        error = found.error.double().cpu()
        seconds = time.perf_counter() - began
        memory = torch.cuda.max_memory_allocated() / 2**20
        decibels = -10 * torch.log10(error).mean().item()
        return {
            "seconds": seconds,
            "per_second": len(images) / seconds,
            "psnr": decibels,
            "mebibytes": memory,
            "stopped": time.monotonic() > self.ends,
        }

    def _size(self, megapixels: float) -> tuple[int, int]:
        height, width = sized(self.paths, 0, megapixels).shape[:2]
        return width, height

    def _pictures(self, batch: int, path: Path | None = None) -> Pixels:
        """One whole picture [1, H, W, 3], or square parts of the folder's, [B, side, side, 3]."""
        if path is not None:
            return read_image_8_bit(path.read_bytes())[None]
        side, rng, parts = self.sizes.side, np.random.default_rng(0), []
        for k in range(batch):
            own = read_image_8_bit(self.paths[k % len(self.paths)].read_bytes())
            y, x = (rng.integers(0, max(length - side, 0) + 1) for length in own.shape[:2])
            parts.append(own[y : y + side, x : x + side])
        return np.stack(parts)

    def _gaussians(self, width: int, height: int, n: int, batch: int) -> list[Tensor]:
        """Random Gaussians of the sizes and shapes of a fit: some are wide, and some needles."""
        rng, scale = np.random.default_rng(0), 0.6 * np.sqrt(width * height / n)
        means = rng.uniform(0, 1, (batch, n, 2)) * (width, height)
        factors = scale * np.exp(rng.normal(0, 0.6, (batch, n, 3)))
        factors[..., 1] *= rng.choice([-1, 0, 1], (batch, n))
        factors[..., ::2] = np.maximum(factors[..., ::2], NEWTON_ADAM.min_scale_px)
        arrays = means, factors, rng.normal(0, 0.1, (batch, n, 3))
        return [torch.tensor(values, dtype=torch.float32, device=self.device) for values in arrays]

    def _seconds(self, work: Callable[[], object], repeats: int = 0) -> float:
        """Seconds of one run: the median of five turns, each to its end on the device, after one that compiles."""
        work()
        turns = []
        for _ in range(5 if self.sizes.repeats > 1 else 1):
            self._finish()
            began = time.perf_counter()
            for _ in range(repeats or self.sizes.repeats):
                work()
            self._finish()
            turns.append((time.perf_counter() - began) / (repeats or self.sizes.repeats))
        return statistics.median(turns)

    def _finish(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize()


def _worst(found: Tensor, true: Tensor) -> float:
    return float((found.double() - true).abs().max() / true.abs().max())


def measure(bench: Bench, record: Record) -> bool:
    """Add every row that is not there yet; return whether all went well. An error keeps no other row from running."""
    is_well = True
    for key, values in bench.rows():
        if record.has(**key):
            continue
        if time.monotonic() > bench.ends:
            print(f"{key['what']} left out: no time is left", file=sys.stderr)
            continue
        try:
            record.add({**key, **values()})
        except Exception as error:
            is_well = False
            print(f"{key}: {type(error).__name__}: {error}", file=sys.stderr)
    return is_well


def main() -> int:
    """The command; its exit status is 2 where it cannot measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="folder of pictures")
    parser.add_argument("--quick", action="store_true", help="the tiniest sizes, interpreted on the CPU")
    parser.add_argument("--out", type=Path, default=RUNS / "gpu.json")
    options = parser.parse_args()
    paths = pictures_in(options.images)
    reasons = {
        "there is no GPU here that this build of PyTorch can use": options.quick or torch.cuda.is_available(),
        "Triton is missing: pip install -e '.[gpu]'": find_spec("triton") is not None,
        f"there is no picture in {options.images}": paths,
    }
    if missing := [reason for reason, is_met in reasons.items() if not is_met]:
        print(missing[0], file=sys.stderr)
        return 2
    if options.quick:
        os.environ["TRITON_INTERPRET"] = "1"
    device = torch.device("cpu" if options.quick else "cuda")
    name = "interpreter" if options.quick else torch.cuda.get_device_name(device)
    settings = {"device": name, "cuda": torch.version.cuda, "sizes": "quick" if options.quick else "whole"}
    record = Record(options.out, "benchmarks.gpu", settings)
    with np.errstate(all="ignore"):  # NumPy, which interprets the kernels, warns where values overflow
        return 0 if measure(Bench(device, paths, QUICK if options.quick else Sizes()), record) else 1


if __name__ == "__main__":
    sys.exit(main())
