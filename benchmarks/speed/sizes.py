"""Encode and decode of pictures of several sizes, beside other codecs; each in a process of its own, for its peak of
memory."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.machine import peak_bytes
from benchmarks.pictures import Pixels, sized
from benchmarks.rd.baselines import Avif, Baseline, Jpeg, versions
from sgmethod import Budget, decode, encode

BASELINES: dict[str, Callable[[], Baseline]] = {"jpeg": Jpeg, "avif": Avif}
DECODES = 9  # of each codec, in turns; the first does not count


def row(paths: Sequence[Path], megapixels: float, bpp: float, repeats: int) -> dict[str, Any]:
    """Seconds of repeated encodes of one size, milliseconds of decodes and MiB; and of other codecs' files of at most
    as many bytes."""
    ours = [alone(encoded, paths, megapixels, bpp) for _ in range(repeats)]
    data = ours[0].pop("data")
    return {
        "megapixels": megapixels,
        "pixels": ours[0]["pixels"],
        "bytes": len(data),
        "psnr": ours[0]["psnr"],
        "gaussians": ours[0]["gaussians"],
        "encode_s": [one["encode_s"] for one in ours],
        "encode_mib": max(one["mib"] for one in ours),
        **alone(beside, paths, megapixels, data),
    }


def alone(function: Callable[..., dict[str, Any]], *arguments: object) -> dict[str, Any]:
    """Run a function in a process of its own and return its result."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def encoded(paths: Sequence[Path], megapixels: float, bpp: float) -> dict[str, Any]:
    """One encode, and the peak of memory after it."""
    pixels = sized(paths, 0, megapixels)
    found = encode(pixels, Budget("bpp", bpp))
    size = {"pixels": pixels.shape[0] * pixels.shape[1], "data": found.data, "mib": peak_bytes() / 2**20}
    return {**size, "encode_s": found.stats.seconds, "psnr": found.stats.psnr, "gaussians": found.stats.gaussians}


def beside(paths: Sequence[Path], megapixels: float, data: bytes) -> dict[str, Any]:
    """Median times of decodes, ours and the other codecs' in turns."""
    pixels = sized(paths, 0, megapixels)
    decodes: dict[str, Callable[[], Pixels]] = {"rd": lambda: decode(data)}
    bpp = 8 * len(data) / (pixels.shape[0] * pixels.shape[1])
    for name, make in BASELINES.items() if versions() else ():
        baseline = make()
        decodes[name] = partial(baseline.decode, baseline.best(pixels, bpp).data)
    times: dict[str, list[float]] = {name: [] for name in decodes}
    for _ in range(DECODES + 1):
        for name, run in decodes.items():
            began = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - began))
    shown = {name: round(statistics.median(taken[1:]), 3) for name, taken in times.items()}
    return {"decode_ms": shown.pop("rd"), "baselines_decode_ms": shown}
