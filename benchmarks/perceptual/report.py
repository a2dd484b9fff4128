"""What people see: metrics that follow the eye, beside AVIF at the same bytes."""

from __future__ import annotations

from pathlib import Path

from benchmarks.perceptual.means import FIGURES, TITLES, lines, means, rates, worse
from benchmarks.rd.report import TITLES as NAMES
from benchmarks.report.section import Content, Section, table


def section(kodak: Content | None, photographs: Content | None) -> Section:
    """From perceptual/kodak.json and perceptual/photographs.json."""
    sets = [(name, content) for name, content in (("Kodak", kodak), ("Photographs", photographs)) if content]
    said = (
        "How good do files look, as far as figures can tell that are nearer to what people say of pictures than PSNR? "
        f"{' '.join(result(name, content) for name, content in sets)} Nobody was asked: these are metrics. [A sheet of "
        "parts at twice their size](seen.webp) shows the source, this codec, AVIF and JPEG XL; it is made by "
        "`python -m benchmarks.perceptual.sheet`."
    )
    how = (
        "each picture is encoded tuned for PSNR and for the eye (`visual`, the default), and by AVIF (libavif of "
        "imagecodecs, where tables of rate have Pillow's, speed 4, 4:2:0, `tune=iq`) at the best quality that takes no "
        "more bytes. A picture that AVIF cannot make so small is left out of the means. LPIPS is that of AlexNet. "
        "Photographs are those that desktop packages carry, 768 pixels wide; constants of the codec were chosen on "
        "others of them, but some values for texture were tried on these too, which are not wholly unseen."
    )
    tables = []
    for name, content in sets:
        brackets = (
            "in brackets the difference from AVIF or, where lower is better, the ratio to it; texture in % of bytes"
        )
        tables.append(f"{name}, {brackets}:\n\n" + table(TITLES, list(lines(content["rows"]))))
        tables.append(f"{name}, pictures in which `visual` is behind:\n\n" + _behind(content))
    return Section("seen", "What people see", said, tables, [content for _, content in sets], how=how)


def result(name: str, content: Content) -> str:
    """What came out beside AVIF at the middle rate, in a sentence; none where either was not measured."""
    at = rates(content["rows"])
    bpp = at[len(at) // 2]
    average = means(content["rows"], bpp)
    if not {"visual", "avif"} <= set(average):
        return ""
    ours, avif = average["visual"], average["avif"]
    parts = [f"{ours[figure] / avif[figure]:.2f} times AVIF's {NAMES[figure]}" for figure in ("lpips", "dists")]
    points = ours["ssimulacra2"] - avif["ssimulacra2"]
    parts.append(f"{abs(points):.1f} points {'less' if points < 0 else 'more'} of SSIMULACRA 2")
    behind, of = worse(content["rows"], bpp, "visual", "avif", "ssimulacra2")
    left = 100 - 100 * avif["bytes"] / ours["bytes"]
    return (
        f"{name} at {bpp:g} bpp: files tuned for the eye have {', '.join(parts)}, by which {len(behind)} of {of} are "
        f"behind; AVIF leaves {left:.0f} % of the bytes."
    )


def _behind(content: Content) -> str:
    rows = content["rows"]
    found = []
    for bpp in rates(rows):
        for other in ("psnr", "avif"):
            cells = []
            for name in FIGURES:
                images, of = worse(rows, bpp, "visual", other, name)
                cells.append(f"{len(images)} of {of}" + _named(images))
            found.append([f"{bpp:g}", "tuned for PSNR" if other == "psnr" else "AVIF", *cells])
    return table(" | ".join(["bpp at most", "behind", *(NAMES[name] for name in FIGURES)]), found)


def _named(images: list[str]) -> str:
    """Where they are few."""
    names = [Path(image).stem.split("_")[0] for image in images]
    return f": {', '.join(names)}" if 0 < len(names) <= 6 else ""
