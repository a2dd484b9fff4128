"""The README's tables, between marks: <!-- table NAME --> and <!-- end -->."""

from __future__ import annotations

import re
import statistics
from pathlib import Path

from benchmarks.perceptual import means as perceptual
from benchmarks.rd.report import SEEN, TITLES, against_quoted, means
from benchmarks.report import rate
from benchmarks.report.section import load, number, table

MARKED = r"<!-- table {} -->\n.*?<!-- end -->"


def filled(text: str, results: Path) -> str:
    """The README with its tables as the JSON has them. Raises SystemExit where marks are missing."""
    for name, make in {"codecs": codecs, "versions": versions, "seen": seen, "profiles": profiles}.items():
        made = f"<!-- table {name} -->\n{make(results)}\n<!-- end -->"
        text, count = re.subn(MARKED.format(name), lambda _, made=made: made, text, flags=re.DOTALL)  # type: ignore[misc]
        if count != 1:
            raise SystemExit(f"the README has {count} tables {name}, and not one")
    return text


def codecs(results: Path) -> str:
    """All codecs of one run at 0.25 bits per pixel, the best PSNR first."""
    average = means(rate.rows_of(load(results, "kodak-rd") or {"rows": []}))
    chosen = sorted(
        ((c, m) for (c, limit), m in average.items() if limit == 0.25), key=lambda cm: -(cm[1]["psnr"] or 0)
    )
    seen = SEEN if any(m["lpips"] for _, m in chosen) else {}
    forms = {"bpp": ".3f", "psnr": ".2f", "ms_ssim": ".4f", **seen, "encode_s": ".2f", "decode_ms": ".2f"}
    lines = [[rate.name_of(c), *(number(m[name], form) for name, form in forms.items())] for c, m in chosen]
    return table(" | ".join(["codec", *(TITLES.get(name, name) for name in forms)]), lines)


def versions(results: Path) -> str:
    """Times beside those of version 3, libavif and libjpeg-turbo, all of which took turns."""
    content = load(results, "version4/turns") or {"rows": []}

    def mean(who: str, what: str) -> float:
        return statistics.fmean(row[who][what] for row in content["rows"])

    decode, encode = (mean("this", what) / mean("other", what) for what in ("decode_ms", "encode_s"))
    db = mean("this", "psnr") - mean("other", "psnr")
    behind = f"{abs(db):.2f} dB {'behind' if db < 0 else 'ahead'}"
    return (
        f"[In turns](benchmarks/results/version4) a file is encoded in {mean('this', 'encode_s'):.1f} s, which is "
        f"{mean('this', 'encode_s') / mean('rivals', 'avif_encode_s'):.1f} of libavif's time at speed 4 and "
        f"{encode:.2f} of that of\nversion 3 of this codec, {behind} of it; it is decoded in "
        f"{mean('this', 'decode_ms'):.2f} ms, {mean('this', 'decode_ms') / mean('rivals', 'jpeg_decode_ms'):.1f} of "
        f"libjpeg-turbo's and {decode:.2f} of version 3's."
    )


def seen(results: Path) -> str:
    """What figures that follow the eye say, at 0.25 bits per pixel."""
    found = perceptual.means((load(results, "perceptual/kodak") or {"rows": []})["rows"], 0.25)
    ours, avif = found["visual"], found["avif"]
    points = ours["ssimulacra2"] - avif["ssimulacra2"]
    return (
        f"Tuned for the eye, which is the default, files have {ours['lpips'] / avif['lpips']:.2f} of AVIF's distance "
        f"by LPIPS\nand {ours['dists'] / avif['dists']:.2f} by DISTS at the same bytes, and {abs(points):.1f} points "
        f"{'less' if points < 0 else 'more'} of SSIMULACRA 2\n([What people see](docs/results.md#what-people-see); "
        "AVIF with `tune=iq`)."
    )


def profiles(results: Path) -> str:
    """Profiles rd and paper at two rates, and against GaussianImage as published."""
    average = means(rate.rows_of(*(load(results, name) or {"rows": []} for name in ("kodak-rd", "kodak-paper"))))
    lines = []
    for profile, low, high in (("rd", 0.15, 0.4), ("paper", 0.147, 0.43)):
        psnrs = [number(average[profile, limit]["psnr"], ".2f") + " dB" for limit in (low, high)]
        lines.append([f"`{profile}`", *psnrs, number(against_quoted(average, profile, rate.ANCHOR), "+.1f") + " %"])
    titles = (
        "profile | at 0.147 or 0.15 bpp | at 0.40 or 0.43 bpp | rate against GaussianImage (quoted) for the same PSNR"
    )
    return table(titles, lines)
