"""The README's tables, between marks: <!-- table NAME --> and <!-- end -->."""

from __future__ import annotations

import re
import statistics
import textwrap
from pathlib import Path

from benchmarks.published import report as published
from benchmarks.rd.report import SEEN, TITLES, against_cool_chic, against_quoted, means, shared_bpp, shared_db
from benchmarks.report import rate, stability
from benchmarks.report.section import Content, load, mean, number, table

WIDTH = 120  # of a line
MARKED = r"<!-- table {} -->\n.*?<!-- end -->"


def filled(text: str, results: Path) -> str:
    """The README with its tables as the JSON has them. Raises SystemExit where marks are missing."""
    makers = {
        "limits": limits,
        "codecs": codecs,
        "versions": versions,
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
    return table(" | ".join(["codec", *(TITLES.get(name, name) for name in forms)]), lines)


def versions(results: Path) -> str:
    """Times beside those of version 3, libavif and libjpeg-turbo, all of which took turns."""
    psnr, visual = (load(results, f"version4/{name}") or {"rows": []} for name in ("turns", "turns-visual"))

    def average(content: Content, who: str, what: str) -> float:
        return statistics.fmean(row[who][what] for row in content["rows"])

    def beside(content: Content, what: str, rival: str) -> tuple[float, float]:
        ours = average(content, "this", what)
        return ours, ours / average(content, "rivals", rival)

    encode, of_avif = beside(psnr, "encode_s", "avif_encode_s")
    decode, of_jpeg = beside(psnr, "decode_ms", "jpeg_decode_ms")
    eye_encode, eye_of_avif = beside(visual, "encode_s", "avif_encode_s")
    eye_decode, eye_of_jpeg = beside(visual, "decode_ms", "jpeg_decode_ms")
    db = average(psnr, "this", "psnr") - average(psnr, "other", "psnr")
    return paragraph(
        f"[In turns](benchmarks/results/version4) with `--tune psnr` a file is encoded in {encode:.1f} s, which is "
        f"{of_avif:.1f} times libavif's time (4:2:0, `tune=iq`, speed 4) and "
        f"{encode / average(psnr, 'other', 'encode_s'):.2f} times that of version 3 of this codec, {abs(db):.2f} dB "
        f"{'behind' if db < 0 else 'ahead'} of it; it is decoded in {decode:.2f} ms, {of_jpeg:.1f} times "
        f"libjpeg-turbo's and {decode / average(psnr, 'other', 'decode_ms'):.2f} times version 3's.",
        f"By default it is {eye_encode:.1f} s, {eye_of_avif:.1f} times libavif's, and {eye_decode:.2f} ms, "
        f"{eye_of_jpeg:.1f} times libjpeg-turbo's.",
        "Other hours and sizes have [other ratios](docs/results.md#time-and-memory).",
    )


def large(results: Path) -> str:
    """Who is ahead of those in a hurry, what larger pictures take, and what time limits come to."""
    names = ("kodak", "2-megapixels", "12-megapixels")
    contents = [load(results, f"convergence/{name}") or {"rows": []} for name in names]
    rows = [row for content in contents for row in content["rows"]]

    def cell(megapixels: float, method: str, setting: str) -> str:
        mine = [r for r in rows if (r["method"], r["setting"], r["megapixels"]) == (method, setting, megapixels)]
        db, seconds = (mean([row[name] for row in mine]) for name in ("psnr", "seconds"))
        return f"{number(db, '.1f')} dB, {number(seconds, '.2g')} s"

    columns = {
        "AVIF, speed 6": ("avif", "6"),
        "AVIF, speed 4": ("avif", "4"),
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
        "Whoever is in a hurry takes AVIF, the more so the larger the picture is; and a time limit is kept as far as "
        "the start and the file allow. At 0.25 bits per pixel "
        "([error against run time](docs/results.md#error-against-run-time)):"
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
        "of the bytes ([What people see](docs/results.md#what-people-see)).",
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
        "([beside what others published](docs/results.md#rate-against-quality-beside-what-others-published)).",
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
    titles += "figure) for the same PSNR | over so many dB | for which GaussianImage takes so many bpp"
    return table(titles, lines)
