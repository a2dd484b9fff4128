"""What a scene did not need."""

from __future__ import annotations

from typing import Any

from benchmarks.report.section import Content, Section, number, table

REFERENCE = "photograph"


def section(content: Content) -> Section:
    """From needs.json."""
    rows = content["rows"]
    by_name = {row["scene"]: row for row in rows}
    least, most = (find(rows, key=lambda row: row["bytes"]) for find in (min, max))
    reference = by_name.get(REFERENCE)
    saved = (
        f"; without smaller pictures at first the {REFERENCE} would take "
        f"{reference['seconds_whole'] / reference['seconds']:.2f} times as long"
        if reference
        else ""
    )
    said = (
        f"What does profile `rd` leave out where a scene of {content['settings']['side']} pixels a side does not need "
        f"it, at one quality ({content['settings']['quality']:g}) for all? From {least['bytes']:,} bytes "
        f"({least['scene']}) to {most['bytes']:,} ({most['scene']}){saved}. One picture of each kind is no average of "
        "its kind, and parts that no count shows (a Gaussian that could have been wider) are not seen."
    )
    lines = [line(row, reference) for row in rows]
    titles = "scene | bytes | bits by kind | PSNR | Gaussians | left out of the file | steps, of those scheduled | "
    titles += "steps at full size, 1/2, 1/4, 1/8, with those after the fit | seconds | of the photograph's | "
    titles += "saved by smaller pictures"
    return Section("needs", "What a scene did not need", said, [table(titles, lines)], [content])


def line(row: dict[str, Any], reference: dict[str, Any] | None) -> list[object]:
    """The cells of one scene."""
    bits = ", ".join(f"{name} {count:,}" for name, count in row["bits"].items())
    sizes = " ".join(str(row["steps_by_spacing"].get(str(2**k), 0)) for k in range(4))
    part = None if reference is None else row["seconds"] / reference["seconds"]
    smaller = any(spacing != "1" for spacing in row["steps_by_spacing"])
    return [
        row["scene"],
        f"{row['bytes']:,}",
        bits,
        number(row["psnr"], ".2f"),
        f"{row['gaussians']:,}",
        ", ".join(row["left_out_of_the_file"]) or "-",
        f"{row['steps']} of {row['steps_scheduled']}",
        sizes,
        f"{row['seconds']:.2f}",
        number(part, ".2f"),
        f"{row['seconds_whole'] - row['seconds']:.2f} s" if smaller else "-",
    ]
