"""Rate against quality beside other codecs, on Kodak and on photographs on which nothing was chosen."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from benchmarks import published
from benchmarks.rd.equal import cells, difference
from benchmarks.rd.report import (
    AVIF,
    LESS_IS_BETTER,
    ONE_QUALITY,
    SEEN,
    TITLES,
    BdRate,
    Means,
    Row,
    against,
    against_cool_chic,
    against_quoted,
    curve,
    means,
    shared,
)
from benchmarks.report import results, speed
from benchmarks.report.plots import style
from benchmarks.report.results import load
from benchmarks.tables import MISSING, number, table

NAMES = {
    "rd": "`rd`, tuned for PSNR",
    "rd effort 9": "`rd`, tuned for PSNR, effort 9",
    "rd visual": "`rd`, tuned for the eye (the default)",
    "avif tune=psnr": "AVIF, 4:4:4, speed 4, `tune=psnr`",
    "avif tune=psnr 10 bits": "AVIF, 10 bits, 4:4:4, speed 4, `tune=psnr`",
    "avif tune=psnr 10 bits speed 0": "AVIF, 10 bits, 4:4:4, speed 0, `tune=psnr`",
    "avif tune=iq": "AVIF, 4:2:0, speed 4, `tune=iq`",
    "avif tune=iq 4:4:4": "AVIF, 4:4:4, speed 4, `tune=iq`",
    "avif tune=iq 10 bits": "AVIF, 10 bits, 4:4:4, speed 4, `tune=iq`",
    "avif grain": "AVIF, 4:2:0, speed 4, `tune=iq`, film grain",
    "avif sharp": "AVIF, 4:4:4, speed 5, `tune=iq` (the default of sharp 0.35)",
    "heic": "HEIC, x265, 4:2:0, `tune=psnr`",
    "jpeg2000": "JPEG 2000",
    "webp": "WebP, method 6",
    "jpegxl": "JPEG XL, effort 7",
    "mozjpeg": "mozjpeg, 4:2:0",
    "jpeg": "JPEG, 4:2:0",
}
GRAIN = "avif grain"
AVIF_VISUAL = ("avif tune=iq 4:4:4", "avif tune=iq 10 bits", "avif tune=iq", GRAIN)
EYE = {"ms_ssim": ".4f", **SEEN}  # figures of what is tuned for the eye
BPP = 0.25  # of the tables
MAX_BPP = 0.5  # of the plot
PLOTTED = ("rd", "rd visual", "heic", "jpegxl", "webp", "jpeg")  # and AVIF
ANCHOR = "GaussianImage"
# Published codecs, and their names in marks. Cool-Chic is compared picture by picture.
QUOTED = {"vtm": "VTM", "elic": "ELIC", "cheng": "Cheng 2020, attention", "hm": "HM", "av1": "AV1 (libaom)"}
QUOTED |= {"lottery-codec": "LotteryCodec"}

# The headline: photographs on which nothing was chosen, and Kodak's beside them; against whom, and over which rates.
UNSEEN, KODAK = "rd/unseen", "rd/kodak"
# The JSON of each set; some have other codecs alone, whose files ours leave as they are.
FILES = {UNSEEN: (UNSEEN, "rd/unseen-rates"), KODAK: (KODAK, "rd/effort", "rd/others", "rd/avif")}
HEADLINE_SETS = {UNSEEN: "held-out photographs", KODAK: "Kodak"}
HEADLINE_AGAINST = {"avif tune=psnr 10 bits": "AVIF, 10 bits", "heic": "HEIC", "webp": "WebP"}
HEADLINE_RATES = {
    "0.1 to 0.4 bpp": (0.1, 0.15, 0.25, 0.4),
    "0.1 to 0.25 bpp": (0.1, 0.15, 0.25),
    "0.15 to 0.4 bpp": (0.15, 0.25, 0.4),
}

TRAINED = {"lpips": ".3f", "dists": ".3f", "psnr": ".2f"}  # figures of codecs that were trained for the eye

RANGES = ("over pictures", "over bits per pixel")  # titles of differences()

# README's rows: column of the JSON, its format, what picks the best, and which of the two codecs is measured.
README_ROWS = {
    "PSNR, dB ↑": ("psnr", ".1f", max, 0),
    "MS-SSIM ↑": ("ms_ssim", ".3f", max, 1),
    "SSIMULACRA 2 ↑": ("ssimulacra2", ".0f", max, 1),
    "LPIPS ↓": ("lpips", ".3f", min, 1),
    "DISTS ↓": ("dists", ".3f", min, 1),
    "Size, bytes": ("bytes", ",.0f", None, 1),
    "Decoding by one thread, ms ↓": ("decode_ms", ".1f", min, 1),  # of AVIF in 8 bits, which is its faster one
}
# The settings of its row of encoding, whose times are those of the page on run time. AVIF's is the one tuned for PSNR,
# whose search was the shorter.
README_TIMED = (("rd visual", ""), ("avif", "4"), ("jpegxl", "7"), ("webp", "6"), ("jpeg", "0"))
LIBRARIES = ("libjxl-", "libwebp-", "libjpeg_turbo-", "libvips-", "libavif-")  # the last for AVIF with grain


@cache
def rows(name: str = KODAK) -> tuple[Row, ...]:
    """The rows of all files of one of HEADLINE_SETS that were made for a rate."""
    return tuple(Row(**row) for file in FILES[name] for row in results.rows(file))


@cache
def average(name: str = KODAK) -> Means:
    """Their means over pictures."""
    return means(rows(name))


def avif(figure: str = "psnr", name: str = KODAK) -> str:
    """AVIF as it is compared: the better of its settings for PSNR, or the best for the eye by another figure."""
    found = average(name)
    names = [codec for codec in (AVIF if figure == "psnr" else AVIF_VISUAL) if (codec, BPP) in found]
    if figure not in EYE:
        return names[0]
    sign = 1 if figure in LESS_IS_BETTER else -1
    return min(names, key=lambda codec: sign * (found[codec, BPP][figure] or 0))


def readme_codecs(figure: str) -> dict[str, tuple[str, str]]:
    """README's columns in the row of a figure: the codec tuned for PSNR and for the eye, if it can be tuned."""
    untuned = {"JPEG XL": "jpegxl", "WebP": "webp", "JPEG": "jpeg"}
    tuned = {"sgmethod": ("rd", "rd visual"), "AVIF": (avif(name=UNSEEN), avif(figure, UNSEEN))}
    return tuned | {title: (name, name) for title, name in untuned.items()}


def codecs_table() -> str:
    """At BPP, the best PSNR first; bits are those for the same PSNR over all rates."""
    found = {codec: average()[codec, BPP] for codec in NAMES if (codec, BPP) in average()}
    anchor = avif()
    forms = {"bpp": ".3f", "psnr": ".2f", **EYE}
    lines = []
    for codec, m in sorted(found.items(), key=lambda item: -(item[1]["psnr"] or 0)):
        bits = differences(against(rows(), codec, anchor)) if codec != anchor else ["", "", ""]
        above = f" (over the limit on {m['above']:g} of {m['images']:g})" if m["above"] else ""
        lines.append([NAMES[codec] + above, *(number(m[name], form) for name, form in forms.items()), *bits])
    titles = [f"codec, at most {BPP:g} bits per pixel", *(TITLES.get(name, name) for name in forms)]
    return table(" | ".join([*titles, f"bits for the same PSNR, against {NAMES[anchor]}", *RANGES]), lines)


def within(every: Sequence[Row], rates: str) -> list[Row]:
    """The rows of one of HEADLINE_RATES."""
    return [row for row in every if row.max_bpp in HEADLINE_RATES[rates]]


def headline_table() -> str:
    """The bits of `rd` tuned for PSNR at equal PSNR, by set of photographs and range of rates."""
    lines = []
    for name, title in HEADLINE_SETS.items():
        for anchor, other in HEADLINE_AGAINST.items():
            found = [against(within(rows(name), rates), "rd", anchor) for rates in HEADLINE_RATES]
            count = f" ({found[0].pictures})" if found[0] else ""
            lines.append([f"{title}{count}", other, *(differences(rate)[0] for rate in found)])
    return table(" | ".join(["photographs", "against", *HEADLINE_RATES]), lines)


def eye_table() -> str:
    """The default beside AVIF's best setting for each figure at BPP: means, and the difference picture by picture."""
    lines = []
    for name, title in HEADLINE_SETS.items():
        for figure, form in EYE.items():
            codecs = "rd visual", avif(figure, name)
            if found := difference(rows(name), *codecs, BPP, figure):
                lines.append([f"{title} ({found.pictures})", TITLES[figure], *cells(found, form)])
    return table("photographs | figure | ours | AVIF's | difference | ours is better on", lines)


def quoted_table() -> str:
    """The bits of profile rd for the same PSNR against published figures, most first."""
    names = QUOTED | {"cool-chic": "Cool-Chic 5.0", "gaussianimage": ANCHOR}
    found = sorted(((names[mark], rate) for mark, rate in quoted().items() if rate), key=lambda pair: -pair[1].mean)
    lines = [[name, *differences(rate)] for name, rate in found]
    return table(" | ".join(["published codec", "bits of `rd` for the same PSNR", *RANGES]), lines)


def trained_table() -> str:
    """Our files of Kodak at BPP beside codecs whose decoders are networks, at the nearest rate that they published."""
    ours = average()["rd visual", BPP]
    took = [f"{1e3 * (ours['encode_s'] or 0):,.0f} ms", f"{ours['decode_ms'] or 0:.1f} ms"]
    figures = [number(ours[name], form) for name, form in TRAINED.items()]
    lines = [["ours, tuned for the eye", f"{BPP:g}", *figures, *took]]
    for name, codec in published.seen().items():
        point = min(codec["points"], key=lambda point: abs(point["bpp"] - BPP))
        took = [f"{codec[one]} ms" if one in codec else MISSING for one in ("encode_ms", "decode_ms")]
        figures = [number(point.get(figure), form) for figure, form in TRAINED.items()]
        lines.append([f"{name} (quoted)", f"{point['bpp']:.3g}", *figures, *took])
    titles = ["codec", "bpp", *(TITLES[name] for name in TRAINED), "encode, on a CPU", "decode, on a CPU"]
    return table(" | ".join(titles), lines)


def differences(rate: BdRate | None) -> list[str]:
    """The cells of a BD-rate: mean and standard error, least and most, and the rates that were compared."""
    if rate is None:
        return [MISSING] * 3
    error = "" if rate.standard_error is None else f" ± {rate.standard_error:.1f}"
    ends = MISSING if rate.pictures == 1 else f"{number(rate.least, '+.0f')} to {number(rate.most, '+.0f')} %"
    return [f"{number(rate.mean, '+.1f')}{error} %", ends, f"{rate.from_bpp:.2f} to {rate.to_bpp:.2f}"]


def readme_table() -> str:
    """The README's table at BPP, with the best of each row in bold, and the versions of other codecs."""
    lines = []
    for title, (name, form, best_of, tuned) in README_ROWS.items():
        values = [average(UNSEEN)[codecs[tuned], BPP][name] or 0 for codecs in readme_codecs(name).values()]
        lines.append([title, *_best_in_bold(values, form, best_of)])
    timed = [m for method in README_TIMED if (m := speed.at(0.4, *method))]
    lines.append(["Encoding to that size, ms ↓", *_best_in_bold([1000 * m["seconds"] for m in timed], ",.0f", min)])
    named = [name for file in FILES[UNSEEN] for name in load(file)["settings"]["codecs"]]
    versions = dict(re.split("[-/ ]", name)[:2] for name in named if name.startswith(LIBRARIES))
    codecs = ", ".join(f"{library.replace('_', '-')} {version}" for library, version in sorted(versions.items()))
    return f"{table(' | '.join(['', *readme_codecs('psnr')]), lines)}\n\nMeasured with {codecs}."


def _best_in_bold(values: Sequence[float], form: str, best_of: Callable[..., float] | None) -> list[str]:
    """The cells of a row; those that look like the best are bold."""
    cells = [number(value, form) for value in values]
    best = number(best_of(values), form) if best_of else None
    return [f"**{cell}**" if cell == best else cell for cell in cells]


def figures() -> dict[str, float | None]:
    """The figures of sentences, by mark: of held-out photographs, and with -on-kodak of Kodak's."""
    found: dict[str, float | None] = {}
    for name, end in ((UNSEEN, ""), (KODAK, "-on-kodak")):
        every, m, anchor = rows(name), average(name), avif(name=name)
        for mark, codec in {"avif": anchor, "heic": "heic", "webp": "webp"}.items():  # at equal PSNR
            found |= of_rate(f"{mark}{end}", against(every, "rd", codec))
        worse, pictures = dists_worse(every, anchor)
        found |= {f"rate.dists-worse{end}": worse, f"rate.pictures{end}": pictures}
        found[f"rate.psnr-lpips{end}"] = m["rd", BPP]["lpips"]
        for figure in EYE:
            found[f"rate.rd-{figure}{end}"] = m["rd visual", BPP][figure]
            found[f"rate.avif-{figure}{end}"] = m[avif(figure, name), BPP][figure]
            found[f"rate.grain-{figure}{end}"] = m[GRAIN, BPP][figure]
        plain = [m[codec, BPP] for codec in AVIF_VISUAL if codec != GRAIN and (codec, BPP) in m]
        found |= {f"rate.plain-{figure}{end}": min(one[figure] or 0 for one in plain) for figure in ("lpips", "dists")}
        sizes = [m[codec, BPP]["bpp"] or 0 for codec in ("rd", anchor)]
        found[f"rate.avif-unused{end}"] = 100 * (1 - sizes[1] / sizes[0])
        found[f"rate.avif-filled-psnr{end}"] = value_at(m, anchor, "rd", "psnr")
        found[f"rate.avif-filled-ssimulacra2{end}"] = value_at(m, avif("ssimulacra2", name), "rd visual", "ssimulacra2")
    found |= decode_figures(average(UNSEEN))
    shown = [codecs[0] for codecs in readme_codecs("psnr").values()]
    found["rate.above"] = sum(average(UNSEEN)[codec, BPP]["above"] or 0 for codec in shown)
    by_default = {
        "avif-by-default-on-kodak": against(rows(), "rd visual", avif("ssimulacra2")),
        "avif-for-psnr-by-default-on-kodak": against(rows(), "rd visual", avif()),
    }
    for mark, rate in (by_default | quoted()).items():
        found |= of_rate(mark, rate)
    theirs = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"]]
    found["rate.gaussianimage-from-db"], found["rate.gaussianimage-to-db"] = shared(theirs, curve(average(), "rd"))
    found["rate.times-gaussianimage"] = 100 / (100 + (found["rate.more-than-gaussianimage"] or 0))
    return found


def decode_figures(m: Means) -> dict[str, float | None]:
    """Times of decoding by one thread, by mark: ours, AVIF's in 8 and in 10 bits, and ours in units of each."""
    ours = m["rd visual", BPP]["decode_ms"] or math.nan
    found: dict[str, float | None] = {"rate.rd-decode": ours}
    for bits, codec in {"8": "avif tune=iq 4:4:4", "10": "avif tune=iq 10 bits"}.items():
        theirs = found[f"rate.avif-{bits}-bits-decode"] = m[codec, BPP]["decode_ms"] or math.nan
        found[f"rate.times-avif-{bits}-bits-decode"] = ours / theirs
    return found


def dists_worse(every: Sequence[Row], other: str) -> tuple[int, int]:
    """On how many pictures the file tuned for PSNR has a worse DISTS than another codec's, and of how many."""
    at_bpp = {(row.codec, row.image): row.dists for row in every if row.max_bpp == BPP and row.dists is not None}
    images = [image for codec, image in at_bpp if codec == "rd" and (other, image) in at_bpp]
    return sum(at_bpp["rd", image] > at_bpp[other, image] for image in images), len(images)


def quoted() -> dict[str, BdRate | None]:
    """BD-rates of profile rd against published figures, by mark: of means, or picture by picture for Cool-Chic."""
    one_quality = means([Row(**row) for row in results.rows("rd/quality")])
    found = {mark: against_quoted(one_quality, f"rd {ONE_QUALITY}", codec) for mark, codec in QUOTED.items()}
    found["cool-chic"] = against_cool_chic(rows(), "rd")
    found["gaussianimage"] = against_quoted(average(), "rd", ANCHOR)
    return found


def of_rate(mark: str, rate: BdRate | None) -> dict[str, float | None]:
    """The figures of a BD-rate, by mark."""
    if rate is None:
        return {}
    figures = {"more-than": rate.mean, "fewer-than": -rate.mean, "error": rate.standard_error}
    figures |= {"least": -rate.most, "most": -rate.least, "from": rate.from_bpp, "to": rate.to_bpp}
    return {f"rate.{name}-{mark}": value for name, value in figures.items()}


def value_at(average: Means, codec: str, other: str, figure: str) -> float | None:
    """A figure of a codec at the mean size of another's files of BPP; None where it has no smaller and larger ones."""
    size, points = average.get((other, BPP), {}).get("bpp"), sorted(curve(average, codec, figure))
    if size is None or not points or not points[0][0] <= size <= points[-1][0]:
        return None
    logs = [math.log(bpp) for bpp, _ in points]
    return float(np.interp(math.log(size), logs, [value for _, value in points]))


def draw(axes: Any, figure: str) -> None:
    """PSNR or SSIMULACRA 2 against bits per pixel, the best codec first."""
    codecs = sorted((*PLOTTED, avif(), avif("ssimulacra2")), key=lambda codec: -(average()[codec, BPP]["psnr"] or 0))
    for k, codec in enumerate(codecs):
        how = style(k) | {"label": NAMES[codec].replace("`", "")}
        axes.plot(*zip(*sorted(curve(average(), codec, figure)), strict=True), **how)
    if figure == "psnr":
        quoted = [(p["bpp"], p["psnr"]) for p in published.kodak()[ANCHOR]["points"] if p["bpp"] < MAX_BPP]
        axes.plot(*zip(*quoted, strict=True), **style(len(codecs)), label=f"{ANCHOR}, quoted")
    axes.set(xlabel="bits per pixel", ylabel="PSNR, dB" if figure == "psnr" else TITLES[figure])
