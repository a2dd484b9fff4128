"""Previews: files of 32 to 4,096 bytes, beside placeholders and other codecs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.rd.report import SEEN, TITLES
from benchmarks.report import results
from benchmarks.report.plots import style
from benchmarks.report.results import Row
from benchmarks.tables import MISSING, mean, number, table

OURS, OTHERS = "sgmethod", ("WebP", "AVIF")  # the better of these is compared by bytes for the same PSNR
CODECS = (OURS, "BlurHash", "ThumbHash", "WebP", "AVIF", "JPEG XL", "JPEG")
NAMES = {"text": "characters", "encode_s": "encode s", "decode_ms": "decode ms"}
SEEN_BYTES = 512  # at which networks compared
BUSY, BUSY_BYTES = ("kodim05", "kodim08", "kodim13"), 1024  # the photographs that need most bytes


def rows() -> list[Row]:
    """The rows of the measurement."""
    return results.rows("previews/kodak")


def points(rows: Sequence[Row], codec: str) -> dict[int, tuple[float, float]]:
    """By bytes at most, the mean bytes and PSNR over all pictures; no point where a picture has none."""
    mine = [row for row in rows if row["codec"] == codec]
    images, found = {row["image"] for row in rows}, {}
    for limit in sorted({row["max_bytes"] for row in mine}):
        these = [row for row in mine if row["max_bytes"] == limit]
        size, value = mean([row["bytes"] for row in these]), mean([row["psnr"] for row in these])
        if {row["image"] for row in these} == images and size is not None and value is not None:
            found[limit] = size, value
    return found


def times_our_bytes(rows: Sequence[Row], limit: int) -> float | None:
    """The bytes of WebP or AVIF, the better, for our mean PSNR at so many bytes, over ours; between points along the
    logarithm of bytes."""
    ours = points(rows, OURS).get(limit)
    found = []
    for other in OTHERS:
        curve = sorted((db, math.log(size)) for size, db in points(rows, other).values())
        if ours and curve and curve[0][0] <= ours[1] <= curve[-1][0]:
            dbs, logs = np.array(curve).T
            found.append(math.exp(float(np.interp(ours[1], dbs, logs))) / ours[0])
    return min(found, default=None)


def by_bytes() -> str:
    """Mean PSNR by bytes and codec."""
    found = {codec: points(rows(), codec) for codec in CODECS}
    lines = []
    for limit in found[OURS]:
        cells = [number(found[codec].get(limit, (0, None))[1], ".2f") for codec in CODECS]
        times = times_our_bytes(rows(), limit)
        lines.append([f"{limit:,}", *cells, MISSING if times is None else f"{times:.2f} times ours"])
    return table(" | ".join(["bytes at most", *CODECS, "bytes of WebP or AVIF for our PSNR"]), lines)


def at_one_size() -> str:
    """Every figure of each codec's largest file of at most SEEN_BYTES, and times."""
    forms = {"bytes": ",.0f", "text": ",.0f", "psnr": ".2f", **SEEN, "encode_s": ".3f", "decode_ms": ".1f"}
    lines = []
    for codec in CODECS:
        largest = max(limit for limit in points(rows(), codec) if limit <= SEEN_BYTES)
        these = [row for row in rows() if row["codec"] == codec and row["max_bytes"] == largest]
        lines.append([codec, *(number(mean([row.get(name) for row in these]), form) for name, form in forms.items())])
    titles = [f"at most {SEEN_BYTES:,} bytes", *(NAMES.get(name, TITLES.get(name, name)) for name in forms)]
    return table(" | ".join(titles), lines)


def figures() -> dict[str, float | None]:
    """The figures of sentences, by mark."""
    found = {f"previews.times-{limit}": times_our_bytes(rows(), limit) for limit in points(rows(), OURS)}
    for codec in (OURS, "BlurHash", "ThumbHash"):
        for limit, (size, db) in points(rows(), codec).items():
            found |= {f"previews.{codec.lower()}-{limit}-bytes": size, f"previews.{codec.lower()}-{limit}-psnr": db}
    for row in rows():
        if row["codec"] == OURS and row["max_bytes"] == BUSY_BYTES and row["image"][:7] in BUSY:
            found[f"previews.{row['image'][:7]}-{BUSY_BYTES}-psnr"] = row["psnr"]
    return found


def draw(axes: Any) -> None:
    """PSNR against bytes."""
    for k, codec in enumerate(CODECS):
        axes.plot(*zip(*points(rows(), codec).values(), strict=True), **style(k), label=codec)
    axes.set_xscale("log", base=2)
    axes.set(xlabel="bytes", ylabel="PSNR, dB")
    axes.xaxis.set_major_formatter("{x:,.0f}")
