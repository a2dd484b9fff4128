"""Measure what runs on a GPU, in three minutes. Each row is written as soon as it is measured; a second call goes on.

    python -m benchmarks.gpu --images FOLDER [--out JSON]

decode         pictures a second, from Gaussians in memory to pictures in memory, as the paper counts them
decode bytes   the same from a file's bytes, beside decode(), which draws on the CPU
fits           sgmethod.torch.fit of a photograph by 10,000, 30,000 and 70,000 Gaussians: seconds, PSNR and memory
batches        the same of pictures of 256 x 256 by 1,000 Gaussians, 1, 16 and 256 at a time

--quick runs the first two at the smallest size on the CPU, in Triton's interpreter. That tests the command, but
measures nothing.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.benchmark import Timer

import sgmethod
import sgmethod.torch
from benchmarks.machine import RUNS, Record
from benchmarks.pictures import Pixels, pictures_in, sized
from sgmethod.backend.protocol import Frame
from sgmethod.io.image import read_image_8_bit
from sgmethod.settings.rd import NEWTON_ADAM

Row = dict[str, Any]
Measured = tuple[Row, Callable[[], Row]]  # what tells a row apart, and its values
SIDE, EACH = 256, 1000  # of a batch's pictures, and the Gaussians of one


@dataclass(frozen=True)
class Sizes:
    """The sizes to measure: megapixels and Gaussians of pictures, pictures of a batch, seconds of each timing."""

    decoded: tuple[tuple[float, int], ...] = ((0.4, 10_000), (2.0, 50_000), (12.0, 200_000))
    drawn_at_once: tuple[int, ...] = (1, 16)
    fitted: tuple[int, ...] = (10_000, 30_000, 70_000)
    batches: tuple[int, ...] = (1, 16, 256)
    timed_s: float = 2.0


QUICK = Sizes(((0.001, 10),), (1, 2), (), (), 0.0)


def rows(device: torch.device, paths: list[Path], s: Sizes) -> Iterator[Measured]:
    """All rows."""
    for megapixels, n in s.decoded:
        for batch in s.drawn_at_once:
            key = {"what": "decode", "megapixels": megapixels, "gaussians": n, "pictures": batch}
            yield key, partial(drawn, device, sized(paths, 0, megapixels), n, batch, s.timed_s)
        key = {"what": "decode bytes", "megapixels": megapixels, "gaussians": n}
        yield key, partial(decoded, device, sized(paths, 0, megapixels), n, s.timed_s)
    for n in s.fitted:
        for path in (paths[0], paths[len(paths) // 2]):
            whole = read_image_8_bit(path.read_bytes())[None]
            yield {"what": "fits", "picture": path.stem, "gaussians": n}, partial(fitted, device, whole, n)
    for batch in s.batches:
        key = {"what": "batches", "pictures": batch, "side": SIDE, "gaussians": EACH}
        yield key, partial(fitted, device, parts_of(paths, batch), EACH)


def drawn(device: torch.device, pixels: Pixels, n: int, batch: int, timed_s: float) -> Row:
    """Drawn pictures a second."""
    from sgmethod.torch.tiles import Tiles

    height, width = pixels.shape[:2]
    values = gaussians(device, width, height, n, batch)
    return {"per_second": batch / seconds(lambda: Tiles(Frame(width, height), *values).draw(), timed_s)}


def decoded(device: torch.device, pixels: Pixels, n: int, timed_s: float) -> Row:
    """Files a second: bits on the CPU and drawing on the device, and all on the CPU."""
    data = sgmethod.encode(pixels, gaussians=n, effort=1, tune="psnr").data
    shown = sgmethod.torch.draw(data, device).permute(1, 2, 0).cpu().numpy().astype(int)
    return {
        "bytes": len(data),
        "max_levels": int(np.abs(shown - sgmethod.decode(data)).max()),
        "per_second": 1 / seconds(lambda: sgmethod.torch.draw(data, device), timed_s),
        "per_second_on_cpu": 1 / seconds(lambda: sgmethod.decode(data), timed_s),
    }


def fitted(device: torch.device, pictures: Pixels, n: int) -> Row:
    """Fit pictures [B, H, W, 3] by the public function."""
    images = torch.from_numpy(pictures).permute(0, 3, 1, 2).to(device)
    torch.cuda.reset_peak_memory_stats()
    began = time.perf_counter()
    error = sgmethod.torch.fit(images, n).error.double().cpu()
    took = time.perf_counter() - began
    memory, decibels = torch.cuda.max_memory_allocated() / 2**20, -10 * torch.log10(error).mean().item()
    return {"seconds": took, "per_second": len(images) / took, "psnr": decibels, "mebibytes": memory}


def seconds(work: Callable[[], object], timed_s: float) -> float:
    """The median time of a run, after one that compiles."""
    work()
    return float(Timer("work()", globals={"work": work}).blocked_autorange(min_run_time=timed_s).median)


def parts_of(paths: list[Path], batch: int) -> Pixels:
    """Square parts of the folder's pictures, [B, SIDE, SIDE, 3]."""
    rng, parts = np.random.default_rng(0), []
    for k in range(batch):
        own = read_image_8_bit(paths[k % len(paths)].read_bytes())
        y, x = (rng.integers(0, max(length - SIDE, 0) + 1) for length in own.shape[:2])
        parts.append(own[y : y + SIDE, x : x + SIDE])
    return np.stack(parts)


def gaussians(device: torch.device, width: int, height: int, n: int, batch: int) -> list[Tensor]:
    """Random Gaussians of the sizes and shapes of a fit: some are wide, and some needles."""
    rng, scale = np.random.default_rng(0), 0.6 * np.sqrt(width * height / n)
    means = rng.uniform(0, 1, (batch, n, 2)) * (width, height)
    factors = scale * np.exp(rng.normal(0, 0.6, (batch, n, 3)))
    factors[..., 1] *= rng.choice([-1, 0, 1], (batch, n))
    factors[..., ::2] = np.maximum(factors[..., ::2], NEWTON_ADAM.min_scale_px)
    arrays = means, factors, rng.normal(0, 0.1, (batch, n, 3))
    return [torch.tensor(values, dtype=torch.float32, device=device) for values in arrays]


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
        for key, values in rows(device, paths, QUICK if options.quick else Sizes()):
            if not record.has(**key):
                record.add({**key, **values()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
