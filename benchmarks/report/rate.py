"""Rate against quality on Kodak: measured here, and quoted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks import published
from benchmarks.rd.report import COSTS, FORMATS, SEEN, TITLES, Means, Row, against, against_means, curve, means, scaled
from benchmarks.report.plots import style
from benchmarks.report.section import Content, Draw, Section, folded, number, table

NAMES = {
    "rd": "`rd`, tuned for PSNR",
    "rd visual": "`rd`, tuned for the eye (the default)",
    "paper": "`paper`",
    "baseline": "`baseline`",
    "avif tune=psnr": "AVIF, 4:4:4, speed 4, `tune=psnr`",
    "avif tune=psnr speed 0": "AVIF, 4:4:4, speed 0, `tune=psnr`",
    "avif tune=iq": "AVIF, 4:2:0, speed 4, `tune=iq`",
    "avif grain": "AVIF, 4:2:0, speed 4, `tune=iq`, grain",
    "heic": "HEIC, x265, 4:2:0, `tune=psnr`",
    "jpeg2000": "JPEG 2000",
    "webp": "WebP, method 6",
    "jpegxl": "JPEG XL, effort 7",
    "jpegxl effort 4": "JPEG XL, effort 4",
    "mozjpeg": "mozjpeg, 4:2:0",
    "jpeg": "JPEG, 4:2:0",
    "coin": "COIN",
}
RATES = (0.15, 0.25, 0.4)
ANCHOR = "GaussianImage"
BD_SEEN = ("ms_ssim", *SEEN)
MAX_BPP, SORTED_AT_BPP = 0.5, 0.2  # of the plot, and of its legend
MUCH_LEFT_PERCENT = 2  # of the bytes, from where on it is said
AVIF, AVIF_FOR_EYES = "avif tune=psnr", "avif tune=iq"  # its rows that are compared with
PATIENT = "rd effort 9", "avif tune=psnr speed 0"  # whatever it takes
UNTIMED = {"encode_s": None, "decode_ms": None}
NOTE = (
    '"Above it": where a codec makes no file so small, its smallest stands, and its means are of more bytes. Some '
    "leave a part of the bytes, as their qualities are whole numbers{left}: BD-rates compare better than lines. "
    "Seconds of other codecs are those of one encode, without the search for the quality that fits; those of `rd` have "
    "it in them. A row that was measured beside other work or on another processor has none. Effort 9 was measured in "
    "another hour, so that its seconds compare with no other row. `rd` and JPEG XL are decoded by every thread; AVIF "
    "and JPEG 2000 gain nothing from a second."
)


def rows_of(*contents: Content) -> list[Row]:
    """All of them; without times where the command had some of the threads alone, as beside another one, or another
    processor than the first of them."""
    found = []
    for content in contents:
        is_alone = not content.get("command", "").startswith("SG_THREADS=")
        is_timed = is_alone and processor(content) == processor(contents[0])
        found += [Row(**(row | ({} if is_timed else UNTIMED))) for row in content["rows"]]
    return found


def processor(content: Content) -> str | None:
    """That it was measured on."""
    name: str | None = content.get("machine", {}).get("processor")
    return name


def name_of(codec: str) -> str:
    """As a reader sees it. What stands behind a known name, an effort or a number of steps, says what it is."""
    known = max((name for name in NAMES if f"{codec} ".startswith(f"{name} ")), key=len, default="")
    return ", ".join(part for part in (NAMES.get(known, ""), codec.removeprefix(known).strip()) if part)


def section(
    main: Content | None,
    effort: Content | None,
    paper: Content | None,
    fitted: Content | None = None,
    settings: Content | None = None,
    patient: Content | None = None,
) -> Section:
    """From rd/kodak.json, rd/effort.json, rd/paper.json, rd/fitted.json, rd/settings.json and rd/patient.json, as far
    as there are."""
    at_rates = [content for content in (main, effort, paper, settings, patient) if content]
    rows = rows_of(*at_rates)
    average = means(rows)
    told = []
    for codec, rival in (("rd", AVIF), ("rd visual", AVIF_FOR_EYES), PATIENT):
        if (rate := first(against(rows, codec, rival))) is not None:
            least, most = by_picture(rows, codec, rival)
            spread = f"(by picture {least:+.0f} to {most:+.0f} %)"
            told.append(f"{name_of(codec)}, needs {fewer(rate)} {spread} than {name_of(rival)}")
    said = (
        "How many bits does each codec need for the same PSNR, by the sizes of real files and the pixels decoded from "
        f"them? Profile {'; '.join(told)}. {best_seen(average)}Kodak alone is no statement on other "
        "pictures, and a figure is none on what an eye sees."
    )
    tables = [measured(average), NOTE.format(left=left(average)), every_pair(rows, average, "psnr")]
    panels: list[Draw] = [lambda axes: draw_psnr(axes, average)]
    if any(row.lpips is not None for row in rows):
        tables += [seen(average), rates_seen(rows, average)]
        tables += [folded(f"BD-rates by {TITLES[name]}", every_pair(rows, average, name)) for name in BD_SEEN]
        panels.append(lambda axes: draw_lpips(axes, average))
    tables += [on_fewer(rows, rows_of(fitted))] if fitted else []
    pictures = len({row.image for row in rows})
    contents = [*at_rates, *([fitted] if fitted else [])]
    return Section(
        "rate", "Rate against quality", said, tables, contents, panels, f"means of {pictures} pictures of Kodak"
    )


def by_picture(rows: Sequence[Row], codec: str, anchor: str) -> tuple[float, float]:
    """The least and the most of a codec's BD-rates for the same PSNR over the pictures that both have."""
    images = dict.fromkeys(row.image for row in rows if row.codec == codec)
    found = (against([row for row in rows if row.image == image], codec, anchor) for image in images)
    rates = [rate for rate, _ in filter(None, found)]
    return min(rates), max(rates)


def best_seen(average: Means) -> str:
    """Who is ahead by each figure that follows the eye, in a sentence; none where there are no such figures."""
    told = []
    for figure in SEEN:
        pick = max if figure == "ssimulacra2" else min
        values = [(m[figure], codec) for (codec, limit), m in average.items() if limit == RATES[1]]
        known = [(value, codec) for value, codec in values if value is not None]
        if known:
            told.append(f"{name_of(pick(known)[1])} by {TITLES[figure]}")
    return f"At {RATES[1]:g} bpp the best for the eye is {'; '.join(told)}. " if told else ""


def left(average: Means) -> str:
    """Which codecs leave bytes that they may have, and how many, in brackets."""
    parts: dict[str, list[float]] = {}
    for (codec, limit), m in average.items():
        if not m["above"] and m["bpp"] is not None:
            parts.setdefault(codec, []).append(100 - 100 * m["bpp"] / limit)
    found = {codec: (min(some), max(some)) for codec, some in parts.items() if max(some) >= MUCH_LEFT_PERCENT}
    told = "; ".join(f"{name_of(codec)}: {least:.0f} to {most:.0f} %" for codec, (least, most) in found.items())
    return f" ({told})" if told else ""


def measured(average: Means, more: dict[str, str] | None = None) -> str:
    """Means over the pictures for each codec and rate; how many, where that differs. more: further figures and their
    forms."""
    forms = {"images": "g", "above": "g"} | FORMATS | {"bpp": ".4f"} | (more or {}) | COSTS
    del forms["bytes"]  # which bits per pixel say already, and the page is narrow
    if len({m["images"] for m in average.values()}) == 1:
        del forms["images"]
    titles = " | ".join(["codec", "bpp at most", *(TITLES.get(name, name) for name in forms)])
    cells = [
        [name_of(codec), f"{limit:g}", *(number(m[name], form) for name, form in forms.items())]
        for (codec, limit), m in sorted(average.items(), key=lambda item: (item[0][1], -(item[1]["psnr"] or 0)))
    ]
    return table(titles, cells)


def fewer(rate: float) -> str:
    """A difference in words."""
    return f"{abs(rate):.1f} % {'fewer' if rate < 0 else 'more'} bits"


def every_pair(rows: Sequence[Row], average: Means, figure: str) -> str:
    """BD-rates of every codec that has a figure against every other, averaged either way."""
    codecs = list(dict.fromkeys(row.codec for row in rows if getattr(row, figure) is not None))
    lines = []
    for codec in codecs:
        cells = []
        for anchor in codecs:
            found = first(against(rows, codec, anchor, figure)), against_means(average, codec, anchor, figure)
            cells.append("-" if codec == anchor else " / ".join(number(rate, "+.1f") for rate in found))
        lines.append([name_of(codec), *cells])
    note = (
        f"BD-rate for the same {TITLES[figure]}, in percent, below 0 for fewer bits, of each row against each column: "
        "mean of pictures / of means. No figure where on some picture the two share none, or a curve falls. Figures "
        "over other qualities do not compare."
    )
    return f"{note}\n\n" + table(" | ".join(["codec", *map(name_of, codecs)]), lines)


def seen(average: Means) -> str:
    """Metrics that follow the eye, beside AVIF as it is tuned for that."""
    limits = sorted({limit for codec, limit in average if codec == AVIF_FOR_EYES})
    lines = []
    for limit in limits:
        mine = {codec: m for (codec, at), m in average.items() if at == limit and m["lpips"] is not None}
        for codec, m in sorted(mine.items(), key=lambda item: item[1]["lpips"] or 0):
            cells = [number(m[name], form) for name, form in ({"bpp": ".3f"} | SEEN).items()]
            lines.append([f"{limit:g}", name_of(codec), *cells])
    note = (
        "SSIMULACRA 2 (higher is better), LPIPS (AlexNet) and DISTS (lower is better), the lowest LPIPS first. AVIF's "
        "row with `tune=iq`, which libavif takes by default, is the fair one to compare with."
    )
    return f"{note}\n\n" + table("bpp at most | codec | bpp | SSIMULACRA 2 | LPIPS | DISTS", lines)


def rates_seen(rows: Sequence[Row], average: Means) -> str:
    """BD-rates for the same of each figure that follows the eye, against AVIF as it is tuned for that."""
    codecs = list(dict.fromkeys(row.codec for row in rows if row.lpips is not None and row.codec != AVIF_FOR_EYES))
    lines = []
    for codec in codecs:
        of_pictures = [first(against(rows, codec, AVIF_FOR_EYES, figure)) for figure in BD_SEEN]
        of_means = [against_means(average, codec, AVIF_FOR_EYES, figure) for figure in BD_SEEN]
        lines.append([name_of(codec), *map(percent, [*of_pictures, *of_means])])
    titles = [f"{TITLES[figure]}, {how}" for how in ("mean of pictures", "of means") for figure in BD_SEEN]
    note = (
        "BD-rate against AVIF with `tune=iq` for the same of each figure, below 0 for fewer bits, averaged either way. "
        "No figure where on some picture the two share no quality, or a curve falls."
    )
    return f"{note}\n\n" + table(" | ".join(["codec", *titles]), lines)


def on_fewer(rows: Sequence[Row], fitted: Sequence[Row]) -> str:
    """What takes minutes for a picture, beside the others on the same pictures."""
    images = {row.image for row in fitted}
    others = {"rd", AVIF}
    beside = [row for row in rows if row.image in images and row.codec in others]
    note = f"On {len(images)} of the pictures, what is fitted for minutes, beside `rd` and AVIF on the same ones."
    if any(row.codec == "coin" for row in fitted):
        note += (
            " COIN's authors fit each picture on a GPU, with some hundred times the work: it can reach more than here."
        )
    return f"{note}\n\n" + measured(means([*fitted, *beside]), SEEN)


def percent(rate: float | None) -> str:
    """A difference in rate."""
    return number(rate, "+.1f") + (" %" if rate is not None else "")


def first(found: tuple[float, int] | None) -> float | None:
    """The rate alone, where the number of pictures is known."""
    return found[0] if found else None


def at(points: Sequence[tuple[Any, ...]], rate: float, column: int) -> float | None:
    """A published quality at a rate, None beyond the points."""
    known = sorted((p[0], p[column]) for p in points if p[column] is not None)
    if len(known) < 2 or not known[0][0] <= rate <= known[-1][0]:
        return None
    rates, values = np.array(known).T
    return float(PchipInterpolator(np.log(rates), values)(np.log(rate)))


def lines_of(average: Means) -> dict[str, dict[str, Any]]:
    """Every codec that has a curve, the best first, and how its line looks."""
    codecs = dict.fromkeys(codec for codec, _ in average)
    levels = {codec: at(curve(average, codec), SORTED_AT_BPP, 1) for codec in codecs}
    found = sorted(codecs, key=lambda codec: -(levels[codec] or 0))
    return {codec: style(k) | {"label": name_of(codec).replace("`", "")} for k, codec in enumerate(found)}


def draw_psnr(axes: Any, average: Means) -> None:
    """PSNR against bits per pixel."""
    shown = lines_of(average)
    for codec, how in shown.items():
        axes.plot(*zip(*sorted(scaled(curve(average, codec), 1)), strict=True), **how)
    quoted = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"] if p["bpp"] < MAX_BPP]
    axes.plot(*zip(*quoted, strict=True), **style(len(shown)), label=f"{ANCHOR}, quoted")
    axes.set(xlabel="bits per pixel", ylabel="PSNR, dB")


def draw_lpips(axes: Any, average: Means) -> None:
    """LPIPS against bits per pixel, of what has it, the best at the top as in the other panel."""
    for codec, how in lines_of(average).items():
        found = sorted((m["bpp"], m["lpips"]) for (name, _), m in average.items() if name == codec and m["lpips"])
        if found:
            axes.plot(*zip(*found, strict=True), **how)
    axes.set(xlabel="bits per pixel", ylabel="LPIPS, better upwards")
    axes.invert_yaxis()
