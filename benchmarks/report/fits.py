"""Float quality at a fixed number of Gaussians, and what each part of profile rd is worth."""

from __future__ import annotations

import statistics

from benchmarks import published
from benchmarks.report.section import Content, Section, number, table


def representation(content: Content) -> Section:
    """From representation.json."""
    rows = content["rows"]
    lines, found = [], []
    for asked in sorted({row["asked"] for row in rows}):
        mine = [row for row in rows if row["asked"] == asked]
        mean = {name: statistics.fmean(row[name] or 0 for row in mine) for name in ("psnr", "ms_ssim", "seconds")}
        found.append(f"{mean['psnr']:.2f} dB with {asked:,}")
        lines.append(
            [f"{asked:,}", len(mine), f"{mean['psnr']:.2f}", f"{mean['ms_ssim']:.4f}", f"{mean['seconds']:.1f}"]
        )
    said = (
        f"How well do N Gaussians show a picture before any number is rounded? {' and '.join(found)} Gaussians, after "
        f"{content['settings']['steps']:,} steps. No file holds them, and the paper's figures, which are quoted, are "
        "of 70,000 Gaussians, more steps and a GPU."
    )
    tables = [table("Gaussians | pictures | PSNR | MS-SSIM | seconds", lines), *_quoted("representation, Kodak")]
    return Section("representation", "A fixed number of Gaussians", said, tables, [content])


def ablation(content: Content) -> Section:
    """From ablation.json."""
    rows = content["rows"]
    whole = rows[0]["psnr"]
    lines = [
        [
            row["without"],
            f"{row['psnr']:.2f}",
            f"{row['psnr'] - whole:+.2f}",
            f"{row['bpp']:.4f}",
            f"{row['gaussians']:.0f}",
            f"{row['seconds']:.1f}",
        ]
        for row in rows
    ]
    worst = min(rows[1:], key=lambda row: row["psnr"])
    said = (
        f"What is each part of profile `rd` worth, by the PSNR without it at {content['settings']['bpp']:g} bpp? "
        f"{worst['without'][0].upper()}{worst['without'][1:]} is worth most, {whole - worst['psnr']:.2f} dB. "
        "Differences do not add up, and a part that is worth little on these pictures may decide on others."
    )
    tables = [table("without | PSNR | change | bpp | Gaussians | seconds", lines)]
    tables += [
        part for name in ("parts", "regularisation", "quantisation", "bits of a position") for part in _quoted(name)
    ]
    return Section("ablation", "Part by part", said, tables, [content])


def _quoted(name: str) -> list[str]:
    """The paper's tables whose names begin so."""
    paper = published.paper()
    found = []
    for title, rows in paper["rows_of"].items():
        if title.startswith(name):
            cells = [
                [value if isinstance(value, str) else number(value, "g") for value in row.values()] for row in rows
            ]
            titles = " | ".join(column.replace("_", " ") for column in rows[0])
            found.append(f"Quoted from the paper ({paper['hardware']}): {title}.\n\n" + table(titles, cells))
    return found
