"""What a scene did not need."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import Any

from benchmarks.report.section import Content, Section, number, table

REFERENCE = "photograph"
KINDS = ("headers", "colour", "shape", "place", "texture", "begin and end")


def section(content: Content) -> Section:
    """From needs.json."""
    rows = content["rows"]
    by_name = {row["scene"]: row for row in rows}
    least, most = (find(rows, key=lambda row: row["bytes"]) for find in (min, max))
    reference = by_name.get(REFERENCE)
    saved = f"; of the {REFERENCE} smaller pictures at first {saving(reference)}" if reference else ""
    every = (
        "" if any("shear" in row["left_out_of_the_file"] for row in rows) else "No scene does without shear (slant). "
    )
    whole = [row for row in rows if row["steps_scheduled"] and row["steps"] == row["steps_scheduled"]]
    said = (
        f"What does profile `rd` leave out where a scene of {content['settings']['side']} pixels a side does not need "
        f"it, at one quality ({content['settings']['quality']:g}) for all? From {least['bytes']:,} bytes "
        f"({least['scene']}) to {most['bytes']:,} ({most['scene']}){saved}; {len(whole)} of "
        f"{len(rows)} take all steps of their schedule{lossless(rows)}. One picture of each kind is no average of "
        "its kind, and parts that no count shows (a Gaussian that could have been wider) are not seen."
    )
    note = (
        "Version 4 of the file has no oscillation and no tables of its own in a file, so that no scene pays for them. "
        "Shape: ratio, slant, and size within a class; place: how many of each class, and where; colour: with its "
        f"signs; begin and end: of the entropy coder. {every}Seconds: medians, and from the least to the most of "
        f"{len(rows[0]['seconds'])} encodes each, in turns with encodes that have the whole picture in every step."
    )
    titles = " | ".join(
        [
            *("scene", "bytes", "WebP's without loss", *(f"bits of {kind}" for kind in KINDS), "PSNR", "Gaussians"),
            *("left out of the file", "steps, of those scheduled"),
            *("steps at full size, 1/2, 1/4, 1/8, with those after the fit", "seconds", "of the photograph's"),
            "by smaller pictures",
        ]
    )
    made = table(titles, [line(row, reference) for row in rows])
    return Section("needs", "What a scene did not need", said, [made, note], [content])


def lossless(rows: Sequence[dict[str, Any]]) -> str:
    """Which scenes did not need this codec."""
    fewer = [row["scene"] for row in rows if row.get("lossless_bytes", math.inf) < row["bytes"]]
    return f"; WebP takes fewer bytes without any loss for {', '.join(fewer)}" if fewer else ""


def saving(row: dict[str, Any]) -> str:
    """What smaller pictures at first did to the median time, and whether single times say so too."""
    if not any(spacing != "1" for spacing in row["steps_by_spacing"]):
        return "-"
    seconds, whole = row["seconds"], row["seconds_whole"]
    saved = 100 * (1 - statistics.median(seconds) / statistics.median(whole))
    within = max(seconds) >= min(whole) and max(whole) >= min(seconds)
    return f"save {saved:.0f} % of the time" + (", within the spread" if within else "")


def line(row: dict[str, Any], reference: dict[str, Any] | None) -> list[object]:
    """The cells of one scene."""
    sizes = " ".join(str(row["steps_by_spacing"].get(str(2**k), 0)) for k in range(4))
    seconds = row["seconds"]
    part = None if reference is None else statistics.median(seconds) / statistics.median(reference["seconds"])
    return [
        row["scene"],
        f"{row['bytes']:,}",
        number(row.get("lossless_bytes"), ","),
        *(f"{row['bits'][kind]:,}" for kind in KINDS),
        number(row["psnr"], ".2f"),
        f"{row['gaussians']:,}",
        ", ".join(row["left_out_of_the_file"]) or "-",
        f"{row['steps']} of {row['steps_scheduled']}",
        sizes,
        f"{statistics.median(seconds):.2f} ({min(seconds):.2f} to {max(seconds):.2f})",
        number(part, ".2f"),
        saving(row),
    ]
