"""Encode and decode of pictures of several sizes, beside other codecs; each in a process of its own, for its peak of
memory."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.pictures import Pixels, sized
from benchmarks.rd.rivals import Avif, Heic, Jpeg, Jpeg2000, JpegXl, Rival, WebP, versions
from sgmethod import Budget, decode, encode
from tests.harness.data import ROOT

RIVALS: dict[str, Callable[[], Rival]] = {
    "jpeg": Jpeg,
    "jpeg2000": Jpeg2000,
    "webp": WebP,
    "avif": Avif,
    "heic": Heic,
    "jpegxl": JpegXl,
}
DECODE = """
import sys
from pathlib import Path
from sgmethod import decode
decode(sys.stdin.buffer.read())
print(Path("/proc/self/status").read_text())
"""
DECODES = 9  # of each codec, in turns; the first does not count


def row(paths: Sequence[Path], megapixels: float, budget: Budget, repeats: int) -> dict[str, Any]:
    """Seconds of repeated encodes of one size and budget, milliseconds and MiB; and of other codecs' files of at most
    as many bytes."""
    ours = [alone(encoded, paths, megapixels, budget) for _ in range(repeats)]
    data = ours[0].pop("data")
    return {
        "megapixels": megapixels,
        "pixels": ours[0]["pixels"],
        "bytes": len(data),
        "psnr": ours[0]["psnr"],
        "gaussians": ours[0]["gaussians"],
        "encode_s": [one["encode_s"] for one in ours],
        "encode_mib": max(one["mib"] for one in ours),
        "decode_mib": decoding_mib(data),
        **alone(beside, paths, megapixels, repeats, data),
    }


def alone(function: Callable[..., dict[str, Any]], *arguments: object) -> dict[str, Any]:
    """What a function returns in a process of its own."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def encoded(paths: Sequence[Path], megapixels: float, budget: Budget) -> dict[str, Any]:
    """One encode, and the peak of memory after it."""
    pixels = sized(paths, 0, megapixels)
    found = encode(pixels, budget, tune="psnr")
    size = {"pixels": pixels.shape[0] * pixels.shape[1], "data": found.data, "mib": peak_mib()}
    return {**size, "encode_s": found.stats.seconds, "psnr": found.stats.psnr, "gaussians": found.stats.gaussians}


def decoding_mib(data: bytes) -> float:
    """The peak of memory after one decode, in a process that loads nothing else."""
    command = [sys.executable, "-c", DECODE]
    return peak_mib(subprocess.run(command, input=data, capture_output=True, check=True, cwd=ROOT).stdout.decode())


def beside(paths: Sequence[Path], megapixels: float, repeats: int, data: bytes) -> dict[str, Any]:
    """Decodes of ours and of the other codecs in turns, and the others' encodes; medians, and the others' bytes."""
    pixels = sized(paths, 0, megapixels)
    decodes: dict[str, Callable[[], Pixels]] = {"rd": lambda: decode(data)}
    encodes: dict[str, list[float]] = {}
    sizes: dict[str, int] = {}
    bpp = 8 * len(data) / (pixels.shape[0] * pixels.shape[1])
    for name, make in RIVALS.items() if versions() else ():
        rival = make()
        quality = rival.best(pixels, bpp).quality
        encodes[name] = []
        for _ in range(repeats):
            began = time.perf_counter()
            file = rival.encode(pixels, quality)
            encodes[name].append(time.perf_counter() - began)
        decodes[name], sizes[name] = partial(rival.decode, file), len(file)
    times: dict[str, list[float]] = {name: [] for name in decodes}
    for _ in range(DECODES + 1):
        for name, run in decodes.items():
            began = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - began))
    shown = {name: round(statistics.median(taken[1:]), 3) for name, taken in times.items()}
    return {
        "decode_ms": shown.pop("rd"),
        "rivals_bytes": sizes,
        "rivals_decode_ms": shown,
        "rivals_encode_s": {name: round(statistics.median(taken), 4) for name, taken in encodes.items()},
    }


def peak_mib(status: str | None = None) -> float:
    """The peak of this process, or of that whose status is given. getrusage would count the process before too."""
    lines = (status or Path("/proc/self/status").read_text()).splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:"))
