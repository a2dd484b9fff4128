"""The README's tables, between marks: <!-- table NAME --> and <!-- end -->."""

from __future__ import annotations

import re
import statistics
from pathlib import Path

from benchmarks.perceptual import means as perceptual
from benchmarks.rd.report import SEEN, TITLES, against_quoted, means, shared_db
from benchmarks.report import rate, stability
from benchmarks.report.section import Content, load, number, table

MARKED = r"<!-- table {} -->\n.*?<!-- end -->"


def filled(text: str, results: Path) -> str:
    """The README with its tables as the JSON has them. Raises SystemExit where marks are missing."""
    makers = {
        "limits": limits,
        "codecs": codecs,
        "versions": versions,
        "large": large,
        "seen": seen,
        "profiles": profiles,
    }
    for name, make in makers.items():
        made = f"<!-- table {name} -->\n{make(results)}\n<!-- end -->"
        text, count = re.subn(MARKED.format(name), lambda _, made=made: made, text, flags=re.DOTALL)  # type: ignore[misc]
        if count != 1:
            raise SystemExit(f"the README has {count} tables {name}, and not one")
    return text


def limits(results: Path) -> str:
    """What is broken."""
    return stability.limits(load(results, "version4/stiff"), load(results, "stability"))


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
    psnr, visual = (load(results, f"version4/{name}") or {"rows": []} for name in ("turns", "turns-visual"))

    def mean(content: Content, who: str, what: str) -> float:
        return statistics.fmean(row[who][what] for row in content["rows"])

    def beside(content: Content, what: str, rival: str) -> tuple[float, float]:
        ours = mean(content, "this", what)
        return ours, ours / mean(content, "rivals", rival)

    encode, of_avif = beside(psnr, "encode_s", "avif_encode_s")
    decode, of_jpeg = beside(psnr, "decode_ms", "jpeg_decode_ms")
    eye_encode, eye_of_avif = beside(visual, "encode_s", "avif_encode_s")
    eye_decode, eye_of_jpeg = beside(visual, "decode_ms", "jpeg_decode_ms")
    db = mean(psnr, "this", "psnr") - mean(psnr, "other", "psnr")
    return (
        f"[In turns](benchmarks/results/version4) with `--tune psnr` a file is encoded in {encode:.1f} s, which is "
        f"{of_avif:.1f} of libavif's time\n(4:2:0, `tune=iq`, speed 4) and "
        f"{encode / mean(psnr, 'other', 'encode_s'):.2f} of that of version 3 of this codec, {abs(db):.2f} dB "
        f"{'behind' if db < 0 else 'ahead'} of it;\nit is decoded in {decode:.2f} ms, {of_jpeg:.1f} of libjpeg-turbo's "
        f"and {decode / mean(psnr, 'other', 'decode_ms'):.2f} of version 3's. By default it is {eye_encode:.1f} s,\n"
        f"{eye_of_avif:.1f} of libavif's, and {eye_decode:.2f} ms, {eye_of_jpeg:.1f} of libjpeg-turbo's."
    )


def large(results: Path) -> str:
    """What 12 megapixels take, and who is ahead on them within ten seconds."""
    rows = (load(results, "convergence/mosaics") or {"rows": []})["rows"]

    def mean(method: str, setting: str, what: str) -> str:
        found = [r[what] for r in rows if (r["method"], r["setting"], r["megapixels"]) == (method, setting, 12)]
        return f"{statistics.fmean(found):.1f}"

    ours, avif = ("rd", "effort 1"), ("avif", "6")
    return (
        f"12 megapixels take {mean('rd', '', 'seconds')} s tuned for PSNR and {mean('rd visual', '', 'seconds')} s by "
        f"default, {mean('rd', '', 'psnr')} and {mean('rd visual', '', 'psnr')} dB.\n"
        "Whoever has ten seconds for 12 megapixels takes AVIF: at 0.25 bits per pixel its speed 6 has\n"
        f"[{mean(*avif, 'psnr')} dB after {mean(*avif, 'seconds')} s](docs/results.md#12-megapixels), `--effort 1` "
        f"{mean(*ours, 'psnr')} dB after {mean(*ours, 'seconds')} s.\nA `--time-limit` of 4 s leaves "
        f"{mean('rd', '4 s', 'psnr')} dB there, and shorter ones take {mean('rd', '2 s', 'seconds')} s all the same."
    )


def seen(results: Path) -> str:
    """What figures that follow the eye say, at 0.25 bits per pixel."""
    found = perceptual.means((load(results, "perceptual/kodak") or {"rows": []})["rows"], 0.25)
    ours, avif = found["visual"], found["avif"]
    points = ours["ssimulacra2"] - avif["ssimulacra2"]
    average = means(rate.rows_of(load(results, "kodak-rd") or {"rows": []}))
    grain, own = (average.get((codec, 0.25)) for codec in ("avif grain", "rd visual"))
    with_grain = (
        f"\nWith grain of its own AVIF has an LPIPS of {number(grain['lpips'], '.3f')} where ours is "
        f"{number(own['lpips'], '.3f')}, and a DISTS of {number(grain['dists'], '.3f')} where ours is "
        f"{number(own['dists'], '.3f')}."
        if grain and own
        else ""
    )
    return (
        f"Tuned for the eye, which is the default, files have {ours['lpips'] / avif['lpips']:.2f} of AVIF's distance "
        f"by LPIPS\nand {ours['dists'] / avif['dists']:.2f} by DISTS, and {abs(points):.1f} points "
        f"{'less' if points < 0 else 'more'} of SSIMULACRA 2, where both may take 0.25 bits per pixel\nand AVIF leaves "
        f"{100 * (1 - avif['bytes'] / ours['bytes']):.0f} % of them ([What people see]"
        f"(docs/results.md#what-people-see); AVIF with `tune=iq`).{with_grain}"
    )


def profiles(results: Path) -> str:
    """Profiles rd and paper at two rates, and against GaussianImage as published."""
    average = means(rate.rows_of(*(load(results, name) or {"rows": []} for name in ("kodak-rd", "kodak-paper"))))
    lines = []
    for profile, low, high in (("rd", 0.15, 0.4), ("paper", 0.147, 0.43)):
        psnrs = [number(average[profile, limit]["psnr"], ".2f") + " dB" for limit in (low, high)]
        fewer = number(against_quoted(average, profile, rate.ANCHOR), "+.1f") + " %"
        lines.append([rate.name_of(profile), *psnrs, fewer, shared_db(average, profile, rate.ANCHOR)])
    titles = "profile | at 0.147 or 0.15 bpp | at 0.40 or 0.43 bpp | rate against GaussianImage (quoted) for the same "
    titles += "PSNR | over so many dB"
    return table(titles, lines)
