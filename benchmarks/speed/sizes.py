"""Encode and decode of pictures of several sizes, each in a process of its own: it has a peak of memory of its own."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.pictures import Pixels, sized
from benchmarks.rd.rivals import Avif, Jpeg, JpegXl, Rival, WebP, versions
from tests.harness.data import ROOT

RIVALS: dict[str, Callable[[], Rival]] = {"jpeg": Jpeg, "webp": WebP, "avif": Avif, "jpegxl": JpegXl}
DECODE = """
import sys
from pathlib import Path
from sgmethod import decode
decode(sys.stdin.buffer.read())
print(Path("/proc/self/status").read_text())
"""
DECODES = 9  # of each codec, in turns; the first does not count


def row(paths: Sequence[Path], megapixels: float, bpp: float, repeats: int) -> dict[str, Any]:
    """Seconds, milliseconds and MiB of one size: medians of so many encodes, in turns with the other codecs."""
    ours = [alone(encoded, paths, megapixels, bpp) for _ in range(repeats)]
    data = ours[0].pop("data")
    return {
        "what": "size",
        "megapixels": megapixels,
        "pixels": ours[0]["pixels"],
        "bytes": len(data),
        "psnr": ours[0]["psnr"],
        "gaussians": ours[0]["gaussians"],
        "encode_s": [one["encode_s"] for one in ours],
        "encode_mib": max(one["mib"] for one in ours),
        "decode_mib": decoding_mib(data),
        **alone(beside, paths, megapixels, bpp, repeats, data),
    }


def alone(function: Callable[..., dict[str, Any]], *arguments: object) -> dict[str, Any]:
    """What a function returns in a process of its own."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def encoded(paths: Sequence[Path], megapixels: float, bpp: float) -> dict[str, Any]:
    """One encode, and the peak of memory after it."""
    from sgmethod import encode

    pixels = sized(paths, 0, megapixels)
    found = encode(pixels, bpp=bpp, tune="psnr")
    size = {"pixels": pixels.shape[0] * pixels.shape[1], "data": found.data, "mib": peak_mib()}
    return {**size, "encode_s": found.stats.seconds, "psnr": found.stats.psnr, "gaussians": found.stats.gaussians}


def decoding_mib(data: bytes) -> float:
    """The peak of memory after one decode, in a process that loads nothing else."""
    command = [sys.executable, "-c", DECODE]
    return peak_mib(subprocess.run(command, input=data, capture_output=True, check=True, cwd=ROOT).stdout.decode())


def beside(paths: Sequence[Path], megapixels: float, bpp: float, repeats: int, data: bytes) -> dict[str, Any]:
    """Decodes of ours and of the other codecs in turns, and the others' encodes; medians."""
    from sgmethod import decode

    pixels = sized(paths, 0, megapixels)
    decodes: dict[str, Callable[[], Pixels]] = {"rd": lambda: decode(data)}
    encodes: dict[str, list[float]] = {}
    for name, make in RIVALS.items() if versions() else ():
        made = [make().run(pixels, bpp) for _ in range(repeats)]
        encodes[name] = [one.encode_s for one in made]
        decodes[name] = lambda one=made[0]: one.decode(one.data)  # type: ignore[misc]
    times: dict[str, list[float]] = {name: [] for name in decodes}
    for _ in range(DECODES + 1):
        for name, run in decodes.items():
            began = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - began))
    shown = {name: round(statistics.median(taken[1:]), 3) for name, taken in times.items()}
    return {
        "decode_ms": shown.pop("rd"),
        "rivals_decode_ms": shown,
        "rivals_encode_s": {name: round(statistics.median(taken), 4) for name, taken in encodes.items()},
    }


def peak_mib(status: str | None = None) -> float:
    """Of this process until now, or of that whose status is given. getrusage would count the process before too."""
    lines = (status or Path("/proc/self/status").read_text()).splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:"))
