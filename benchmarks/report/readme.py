"""The README's tables, between marks: <!-- table NAME --> and <!-- end -->."""

from __future__ import annotations

import re
import statistics
import textwrap
from pathlib import Path

from benchmarks.published import report as published
from benchmarks.rd.report import SEEN, TITLES, against_cool_chic, against_quoted, means, shared_bpp, shared_db
from benchmarks.report import rate, stability
from benchmarks.report.section import load, mean, number, table

WIDTH = 120  # of a line
FULL_BPP = 0.23  # of 0.25: other codecs' qualities are whole numbers and leave some
MARKED = r"<!-- table {} -->\n.*?<!-- end -->"


def filled(text: str, results: Path) -> str:
    """The README with its tables as the JSON has them. Raises SystemExit where marks are missing."""
    makers = {
        "limits": limits,
        "codecs": codecs,
        "times": times,
        "large": large,
        "seen": seen,
        "ahead": ahead,
        "profiles": profiles,
    }
    for name, make in makers.items():
        made = f"<!-- table {name} -->\n{make(results)}\n<!-- end -->"
        text, count = re.subn(MARKED.format(name), lambda _, made=made: made, text, flags=re.DOTALL)  # type: ignore[misc]
        if count != 1:
            raise SystemExit(f"the README has {count} tables {name}, and not one")
    return text


def paragraph(*sentences: str) -> str:
    """Sentences, in lines."""
    return textwrap.fill(" ".join(filter(None, sentences)), WIDTH, break_long_words=False, break_on_hyphens=False)


def limits(results: Path) -> str:
    """What is broken."""
    return stability.limits(load(results, "version4/stiff"), load(results, "stability"))


def codecs(results: Path) -> str:
    """All codecs of one run at 0.25 bits per pixel, the best PSNR first."""
    average = means(rate.rows_of(load(results, "rd/kodak") or {"rows": []}))
    chosen = sorted(
        ((c, m) for (c, limit), m in average.items() if limit == 0.25), key=lambda cm: -(cm[1]["psnr"] or 0)
    )
    seen = SEEN if any(m["lpips"] for _, m in chosen) else {}
    forms = {"bpp": ".3f", "psnr": ".2f", "ms_ssim": ".4f", **seen, "encode_s": ".3f", "decode_ms": ".2f"}
    lines = [[rate.name_of(c), *(number(m[name], form) for name, form in forms.items())] for c, m in chosen]
    made = table(" | ".join(["codec", *(TITLES.get(name, name) for name in forms)]), lines)
    above = [f"{rate.name_of(c)} (pictures: {m['above']:g})" for c, m in chosen if m["above"]]
    note = f"A codec that makes no file so small of a picture counts with its smallest: {'; '.join(above)}."
    return f"{made}\n\n{paragraph(note)}" if above else made


def times(results: Path) -> str:
    """Times beside those of AVIF and libjpeg-turbo, picture by picture."""
    rows = rate.rows_of(load(results, "rd/kodak") or {"rows": []})
    timed = {(row.codec, row.image): row for row in rows if row.max_bpp == 0.25 and row.encode_s and row.decode_ms}
    if not {"rd", "rd visual", rate.AVIF, rate.AVIF_FOR_EYES, "jpeg"} <= {codec for codec, _ in timed}:
        return ""

    def beside(codec: str, rival: str, what: str) -> str:
        pairs = [(row, timed[rival, image]) for (name, image), row in timed.items() if name == codec]
        ratios = sorted(getattr(ours, what) / getattr(theirs, what) for ours, theirs in pairs)
        return f"{statistics.median(ratios):.1f} times ({ratios[0]:.1f} to {ratios[-1]:.1f}) that of"

    return paragraph(
        f"Tuned for PSNR, the time of an encode is {beside('rd', rate.AVIF, 'encode_s')} AVIF with `tune=psnr`, and of "
        f"a decode {beside('rd', 'jpeg', 'decode_ms')} libjpeg-turbo: medians over the pictures, the least and the "
        f"most. By default they are {beside('rd visual', rate.AVIF_FOR_EYES, 'encode_s')} AVIF with `tune=iq`, and "
        f"{beside('rd visual', 'jpeg', 'decode_ms')} libjpeg-turbo. `rd` decodes by both cores, JPEG by one. Each "
        "encode was timed once, ours with the search for what fits, others' without it. [Other sizes and numbers of "
        "Gaussians](docs/results/speed.md) have other ratios.",
    )


def large(results: Path) -> str:
    """What those in a hurry get, what larger pictures take, and what time limits come to; files that are far from the
    rate they may have say so."""
    names = ("kodak", "2-megapixels", "12-megapixels")
    contents = [load(results, f"convergence/{name}") or {"rows": []} for name in names]
    rows = [row for content in contents for row in content["rows"]]

    def cell(megapixels: float, method: str, setting: str) -> str:
        mine = [r for r in rows if (r["method"], r["setting"], r["megapixels"]) == (method, setting, megapixels)]
        db, seconds, size = (mean([row[name] for row in mine]) for name in ("psnr", "seconds", "bytes"))
        bpp = 8e-6 * (size or 0) / megapixels
        return f"{number(db, '.1f')} dB, {number(seconds, '.2g')} s" + (f" ({bpp:.2f} bpp)" if bpp < FULL_BPP else "")

    columns = {
        "AVIF, `tune=psnr`, speed 6": ("avif", "6"),
        "AVIF, `tune=psnr`, speed 4": ("avif", "4"),
        "`--effort 1 --tune psnr`": ("rd", "effort 1"),
        "`--tune psnr`": ("rd", ""),
        "by default": ("rd visual", ""),
        "`--tune psnr --time-limit 0.25`": ("rd", "0.25 s"),
        "`--tune psnr --time-limit 4`": ("rd", "4 s"),
    }
    lines = [
        [f"{size:g}", *(cell(size, *which) for which in columns.values())]
        for size in sorted({row["megapixels"] for row in rows})
    ]
    said = paragraph(
        "Whoever is in a hurry takes AVIF, the more so the larger the picture is. A time limit is kept as far as the "
        "start and the file allow: on large pictures a short one is exceeded, and its file is poor and uses a part of "
        "its bytes. At 0.25 bits per pixel where a cell says nothing else "
        "([error against run time](docs/results/speed.md)):"
    )
    return f"{said}\n\n{table(' | '.join(['megapixels', *columns]), lines)}"


def seen(results: Path) -> str:
    """What figures that follow the eye say, at 0.25 bits per pixel."""
    average = means(rate.rows_of(load(results, "rd/kodak") or {"rows": []}))
    ours, avif, grain = (average.get((codec, 0.25)) for codec in ("rd visual", rate.AVIF_FOR_EYES, "avif grain"))
    if not (ours and avif and ours["lpips"] and avif["lpips"]):
        return ""
    of_avif = {name: (ours[name] or 0) / (avif[name] or 1) for name in ("lpips", "dists", "bytes")}
    points = (ours["ssimulacra2"] or 0) - (avif["ssimulacra2"] or 0)
    with_grain = (
        f"With grain of its own AVIF has an LPIPS of {number(grain['lpips'], '.3f')} where ours is "
        f"{number(ours['lpips'], '.3f')}, and a DISTS of {number(grain['dists'], '.3f')} where ours is "
        f"{number(ours['dists'], '.3f')}."
        if grain
        else ""
    )
    return paragraph(
        f"Tuned for the eye, which is the default, files have {of_avif['lpips']:.2f} times the distance of "
        f"AVIF's (`tune=iq`) by LPIPS, {of_avif['dists']:.2f} times by DISTS, and {abs(points):.1f} points "
        f"{'less' if points < 0 else 'more'} of SSIMULACRA 2, where AVIF leaves {100 - 100 / of_avif['bytes']:.0f} % "
        "of the bytes ([rate against quality](docs/results/rate.md)).",
        with_grain,
    )


def ahead(results: Path) -> str:
    """The published codecs that are ahead in PSNR."""
    found = published.ahead(rate.rows_of(load(results, "rd/quality") or {"rows": []}))
    at_rates = rate.rows_of(load(results, "rd/kodak") or {"rows": []})
    found["Cool-Chic 5.0"] = rate.first(against_cool_chic(at_rates, "rd"))
    told = [
        f"{change:.0f} % more bits than {name}" for name, change in found.items() if change is not None and change > 0
    ]
    return paragraph(
        "By what others published, some codecs are ahead in PSNR, not all of them networks: `rd`, tuned for PSNR, "
        f"needs {', '.join(told)} for the same PSNR "
        "([beside what others published](docs/results/rate.md)).",
    )


def profiles(results: Path) -> str:
    """Profiles rd and paper at two rates, and against GaussianImage as published."""
    average = means(rate.rows_of(*(load(results, name) or {"rows": []} for name in ("rd/kodak", "rd/paper"))))
    lines = []
    for profile, low, high in (("rd", 0.15, 0.4), ("paper", 0.147, 0.43)):
        psnrs = [number(average[profile, limit]["psnr"], ".2f") + " dB" for limit in (low, high)]
        fewer = number(against_quoted(average, profile, rate.ANCHOR), "+.1f") + " %"
        shared = shared_db(average, profile, rate.ANCHOR), shared_bpp(average, profile, rate.ANCHOR)
        lines.append([rate.name_of(profile), *psnrs, fewer, *shared])
    titles = "profile | at 0.147 or 0.15 bpp | at 0.40 or 0.43 bpp | rate against GaussianImage (quoted, read off its "
    titles += "figure) for the same PSNR | from and to, dB | where GaussianImage takes, bpp"
    return table(titles, lines)
