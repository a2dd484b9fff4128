"""What people see: metrics that follow the eye, beside AVIF at the same bytes."""

from __future__ import annotations

from pathlib import Path

from benchmarks.perceptual.means import FIGURES, TITLES, lines, rates, worse
from benchmarks.rd.report import TITLES as NAMES
from benchmarks.report.section import Content, Section, table


def section(kodak: Content | None, photographs: Content | None) -> Section:
    """From perceptual/kodak.json and perceptual/photographs.json."""
    sets = [(name, content) for name, content in (("Kodak", kodak), ("Photographs", photographs)) if content]
    said = (
        "How good do files look, as far as figures can tell? SSIMULACRA 2 (higher is better), LPIPS (AlexNet) and "
        "DISTS (lower is better) are nearer to what people say of pictures than PSNR. Each picture is encoded tuned "
        "for PSNR and for the eye (`visual`, the default), and by AVIF (libavif, speed 4, 4:2:0, `tune=iq`) at the "
        "best quality that takes no more bytes. A picture that AVIF cannot make so small is left out of the means. "
        "Photographs are those that desktop packages carry, 768 pixels wide; constants of the codec were chosen on "
        "others of them, but some values for texture were tried on these too, which are not wholly unseen. AVIF leaves "
        "4 % of the bytes. Nobody was asked: these are metrics. [A sheet of parts at twice their size](seen.webp) "
        "shows the source, this codec, AVIF and JPEG XL; it is made by `python -m benchmarks.perceptual.sheet`."
    )
    tables = []
    for name, content in sets:
        brackets = (
            "in brackets the difference from AVIF or, where lower is better, the ratio to it; texture in % of bytes"
        )
        tables.append(f"{name}, {brackets}:\n\n" + table(TITLES, list(lines(content["rows"]))))
        tables.append(f"{name}, pictures in which `visual` is behind:\n\n" + _behind(content))
    return Section("seen", "What people see", said, tables, [content for _, content in sets])


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
