"""Time and memory."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import published
from benchmarks.report.section import MISSING, Content, Section, table
from benchmarks.speed import OPERATIONS

REACHED_BY = {"arithmetic": "a product of matrices", "memory": "a copy"}
MOVED = {"forward": 12, "forward + backward": 24}  # bytes of a pixel: three float32 written, and as many read
PIXELS = 768 * 512  # of the picture that kernels draw
PAPERS = {"parts, Kodak, 30,000 Gaussians": 30_000, "representation, Kodak, 70,000 Gaussians": 70_000}  # with frames
DEFAULT_STEPS = 50_000  # of GSImage's train.py, https://github.com/Xinjie-Q/GaussianImage
Rows = Sequence[dict[str, Any]]


def section(content: Content) -> Section:
    """From speed.json."""
    kinds = ("size", "file", "gaussians", "kernel")
    by_what = {what: [r for r in content["rows"] if r["what"] == what] for what in kinds}
    ceilings = {row["ceiling"]: row["value"] for row in content["rows"] if row["what"] == "ceiling"}
    makers = {"size": sizes_table, "file": numbers_table, "gaussians": gaussians_table}
    tables = [make(by_what[what]) for what, make in makers.items() if by_what[what]]
    if gpu := beside_the_gpu(by_what["gaussians"], content["settings"]["steps"]):
        tables.append(gpu)
    if by_what["kernel"]:
        tables.append(kernels_table(by_what["kernel"], ceilings))
    said = (
        "How do time and memory grow with the picture and the Gaussians, and how near do kernels come to what the "
        f"machine can do? {found(by_what)} Medians of one machine are no promise for another, and ratios count "
        "more than seconds."
    )
    how = (
        "sizes are of one picture each at the same bits per pixel, tuned for PSNR; pictures larger than the folder's "
        "are mosaics. Each of our encodes is the first of a process, so that its memory is its own, where other "
        "codecs' come after a search and are warm: in the README's table ours are warm as well, and the ratio to AVIF "
        "is smaller. Other codecs' files have at most as many bytes, and there is a dash where they make none so "
        "small; AVIF is 4:2:0, `tune=iq`, speed 4, JPEG XL of effort 7, HEIC x265's preset slow. Where Gaussians are "
        "asked for, those not worth their bits are left out of the file. Kernels draw 5,000 on one picture. Times of "
        "other sections are of other hours."
    )
    return Section("speed", "Time and memory", said, tables, [content], how=how)


def found(by_what: Mapping[str, Rows]) -> str:
    """What came out."""
    parts = []
    sizes, files, gaussians = by_what["size"], by_what["file"], by_what["gaussians"]
    if len(sizes) > 1:
        pixels = [row["pixels"] for row in sizes]
        columns = (
            [statistics.median(row["encode_s"]) for row in sizes],
            [row["decode_ms"] for row in sizes],
            [row["encode_mib"] for row in sizes],
        )
        encode, decode, memory = (exponent(pixels, values) for values in columns)
        last = [exponent(pixels[-2:], values[-2:]) for values in columns]
        parts.append(
            f"with the pixels to the power of {encode:.2f} an encode, {decode:.2f} a decode, {memory:.2f} an encode's "
            f"memory, of which {sizes[0]['encode_mib']:.0f} MiB are there for the smallest (from the last size but one "
            f"to the last: {', '.join(f'{power:.2f}' for power in last)})"
        )
    powers = []
    counts = [row["gaussians"] for row in files]
    if len({*counts}) > 1:
        encode = exponent(counts, [statistics.median(row["encode_s"]) for row in files])
        powers = [f"{encode:.2f} an encode", f"{exponent(counts, [row['decode_ms'] for row in files]):.2f} a decode"]
    if len(gaussians) > 1:
        counts = [row["gaussians"] for row in gaussians]
        drawing, step = (exponent(counts, [row[name] for row in gaussians]) for name in ("forward_ms", "step_ms"))
        powers += [f"{drawing:.2f} drawing them", f"{step:.2f} a step of a fit"]
    if powers:
        parts.append(f"with the Gaussians to the power of {', '.join(powers)}")
    if not parts and by_what["kernel"]:
        rows = by_what["kernel"]
        most = max(row["threads"] for row in rows)
        best = [row for row in rows if row["threads"] == most and row["isa"] == rows[-1]["isa"]]
        parts = [f"{row['job']} takes {row['median_ms']:.2f} ms with {most} threads" for row in best]
    sentence = "; ".join(parts)
    return f"{sentence[:1].upper()}{sentence[1:]}."


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """The slope of the line through the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def sizes_table(rows: Rows) -> str:
    """By megapixels."""
    return beside_table("megapixels", [f"{row['megapixels']:g}" for row in rows], rows)


def numbers_table(rows: Rows) -> str:
    """By number of Gaussians."""
    size = f"{rows[0]['megapixels']:g} megapixels"
    return beside_table(f"Gaussians asked for, at {size}", [f"{row['asked']:,}" for row in rows], rows)


def beside_table(title: str, labels: Sequence[str], rows: Rows) -> str:
    """Our figures, and below them the other codecs' times as ratios. labels: the first column, of that title."""
    names = list(dict.fromkeys(name for row in rows for name in row["rivals_decode_ms"]))
    own, ratios = [], []
    for label, row in zip(labels, rows, strict=True):
        encode = statistics.median(row["encode_s"])
        spread = f"{min(row['encode_s']):.2f} to {max(row['encode_s']):.2f}"
        sizes = [f"{row['bytes']:,}", f"{row['psnr']:.2f}", f"{row['gaussians']:,}"]
        memory = [f"{row[name]:,.0f}" for name in ("encode_mib", "decode_mib")]
        own.append([label, *sizes, f"{encode:.2f}", spread, f"{row['decode_ms']:.2f}", *memory])
        small = {name for name in names if row["rivals_bytes"].get(name, math.inf) <= row["bytes"]}
        pairs = (encode, row["rivals_encode_s"]), (row["decode_ms"], row["rivals_decode_ms"])
        ratios.append(
            [label, *(ratio(ours / of[name]) if name in small else MISSING for ours, of in pairs for name in names)]
        )
    titles = "bytes | PSNR | Gaussians in the file | encode s | from, to | decode ms | encode MiB | decode MiB"
    beside = [f"{what} over {name}'s" for what in ("encode", "decode") for name in names]
    return (
        f"{table(f'{title} | {titles}', own)}\n\n{table(' | '.join([title, *beside]), ratios) if names else ''}".strip()
    )


def ratio(value: float) -> str:
    """With as many digits as matter."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.2f}"


def gaussians_table(rows: Rows) -> str:
    """By number of Gaussians."""
    lines = [
        [
            f"{r['gaussians']:,}",
            *(f"{r[name]:.2f}" for name in ("binning_ms", "forward_ms", "forward + backward_ms", "step_ms")),
        ]
        for r in rows
    ]
    return table("Gaussians at 768x512 | binning ms | forward ms | forward and backward ms | step of a fit ms", lines)


def kernels_table(rows: Rows, ceilings: dict[str, float]) -> str:
    """By instruction set and threads, and how near drawing and its gradients come to what the machine reaches:
    operations on covered pixels alone, and bytes of the pictures alone."""
    lines = []
    most = max(row["threads"] for row in rows)
    for row in rows:
        parts = ["-", "-"]
        if row["job"] in OPERATIONS and row.get("covered") and ceilings and row["threads"] == most:
            done = OPERATIONS[row["job"]] * row["covered"], MOVED[row["job"]] * PIXELS
            rates = [amount / row["median_ms"] / 1e6 for amount in done]
            reached = ceilings["arithmetic, GFLOP/s"], ceilings["memory, GB/s"]
            parts = [f"{rate:.1f} ({100 * rate / of:.0f} %)" for rate, of in zip(rates, reached, strict=True)]
        times = [f"{row[name]:.2f}" for name in ("median_ms", "p10_ms", "p90_ms")]
        lines.append([row["job"], row["isa"], row["threads"], *times, *parts])
    units = ((name.split(", "), value) for name, value in ceilings.items())
    told = " and ".join(f"{value:.1f} {unit} in {REACHED_BY[of]}" for (of, unit), value in units)
    titles = "job | instruction set | threads | median ms | p10 | p90 | GFLOP/s, of a product of matrices | "
    titles += "GB/s, of a copy"
    note = (
        f"The machine reaches {told}. Operations are the fewest that are known to do: {OPERATIONS['forward']} for a "
        f"Gaussian on a pixel, {OPERATIONS['forward + backward']} with its gradients; bytes are those of the picture "
        "and of the gradient by its pixels.\n\n"
    )
    return (note if told else "") + table(titles, lines)


def beside_the_gpu(rows: Rows, steps: int) -> str:
    """The paper's frames a second and seconds of training for as many Gaussians, and ours. steps: of ours that were
    timed."""
    paper = published.paper()
    ours = {row["gaussians"]: row for row in rows}
    lines = []
    for title, asked in PAPERS.items():
        if asked in ours:
            quoted = [row for row in paper["rows_of"][title] if row["method"] in ("the paper", "GSImage")]
            hardware = f"quoted, {paper['hardware']}"
            lines += [
                [f"{asked:,}", f"{row['method']}, {hardware}", f"{row['fps']:,.0f}", f"{row['seconds']:.0f}"]
                for row in quoted
            ]
            frames, seconds = 1e3 / ours[asked]["forward_ms"], DEFAULT_STEPS * ours[asked]["step_ms"] / 1e3
            lines.append([f"{asked:,}", "here", f"{frames:,.0f}", f"({seconds:.0f})"])
    titles = "Gaussians | who | frames a second | seconds of training"
    note = (
        f"Quoted seconds are those of a whole training, whose steps the paper does not say. GSImage's code has "
        f"{DEFAULT_STEPS:,} by default; ours, in brackets, are so many times a step's mean of {steps:,} steps of "
        "profile `paper`, and nobody ran them. A file then takes tuning on top."
    )
    return f"{note}\n\n{table(titles, lines)}" if lines else ""
