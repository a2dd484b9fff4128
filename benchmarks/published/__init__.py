"""Figures of others as they published them. Nothing here was measured; every table that shows one says "quoted".

kodak.json: rate and quality on Kodak, means over the 24 pictures, with the source of each codec and how it averages.
The files of CompressAI (BSD-3-Clause-Clear) have one quality for all pictures, so that rate differs between pictures.
Means at one rate for all look better against them than they are: the two are never compared.

kodak-cool-chic-5.0.tsv: Cool-Chic 5.0, results/v5.0 (BSD-3-Clause), each picture and point. The sounder comparison: a
difference in rate for each picture, then the mean over pictures.

seen.json: learned codecs whose decoders are trained for the eye, LPIPS (AlexNet) and DISTS as measured here.
"""

from __future__ import annotations

import csv
import json
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


@cache
def kodak() -> dict[str, dict[str, Any]]:
    """By codec: source, what it says of itself, how it averages, and points with bpp, psnr (dB), ms_ssim."""
    content: dict[str, dict[str, Any]] = json.loads((HERE / "kodak.json").read_text())
    return content


@cache
def cool_chic() -> dict[str, list[tuple[float, float]]]:
    """By picture ("kodim01"): points of bits per pixel and PSNR (dB)."""
    points: dict[str, list[tuple[float, float]]] = {}
    with (HERE / "kodak-cool-chic-5.0.tsv").open() as file:
        for row in csv.DictReader(file, delimiter="\t"):
            points.setdefault(row["seq_name"], []).append((float(row["rate_bpp"]), float(row["psnr_db"])))
    return points


@cache
def seen() -> dict[str, dict[str, Any]]:
    """Codecs trained for the eye, by name: source, what each says of itself, and points with bpp, psnr (dB) if it is
    known, lpips, dists. encode_ms, decode_ms: of one that gives its times on a CPU."""
    content: dict[str, dict[str, Any]] = json.loads((HERE / "seen.json").read_text())
    return content
