"""What people see: metrics that follow the eye, beside AVIF at the same bytes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from benchmarks.perceptual.means import FIGURES, means, rates, worse
from benchmarks.rd.report import TITLES
from benchmarks.report.plots import style
from benchmarks.report.section import Content, Draw, Page, number, several, table

SETS = {"perceptual/kodak": "Kodak", "perceptual/photographs": "other photographs"}
KINDS = {"visual": "tuned for the eye", "psnr": "tuned for PSNR", "avif": "AVIF, `tune=iq`"}
FORMS = {"psnr": ".2f", "ms_ssim": ".4f", "ssimulacra2": ".1f", "lpips": ".3f", "dists": ".3f"}
RATES = (0.1, 0.25)  # of the table
PLOTTED = ("ssimulacra2", "lpips", "dists")


def page(contents: Mapping[str, Content]) -> Page:
    """From perceptual/kodak.json and perceptual/photographs.json, as far as there are."""
    lines = []
    for name, content in contents.items():
        for bpp in (bpp for bpp in rates(content["rows"]) if bpp in RATES):
            for kind, found in means(content["rows"], bpp).items():
                if kind in KINDS:
                    cells = [number(found[figure], FORMS[figure]) for figure in FIGURES]
                    lines.append([SETS[name], f"{bpp:g}", KINDS[kind], f"{found['bytes']:,.0f}", *cells])
    titles = " | ".join(["pictures", "bpp at most", "file", "bytes", *(TITLES[figure] for figure in FIGURES)])
    panels: list[Draw] = [partial(draw, contents=contents, figure=figure) for figure in PLOTTED]
    texture = [f"{100 * share:.1f} % at {bpp:g} bpp" for bpp, share in textures(contents).items()]
    return Page(
        name="seen",
        title="What people see",
        question="How good do files look, according to metrics that are designed to agree with people? Each picture is "
        "encoded tuned for the eye (the default) and for PSNR, and by AVIF with `tune=iq`, its own default, at the "
        "best quality that takes no more bytes. Higher is better for SSIMULACRA 2, lower for LPIPS and DISTS.",
        table=table(titles, lines),
        conclusion=" ".join(sentence(SETS[name], content) for name, content in contents.items()),
        limits="- Human judgement: no viewers were asked. [A sheet of crops at twice their size](../seen.webp) shows "
        "the source, this codec, AVIF and JPEG XL; `python -m benchmarks.perceptual.sheet` generates it.\n"
        "- Artefacts that no metric detects well, such as streaks and dots in smooth areas.\n"
        "- Pictures that AVIF (as built into imagecodecs) cannot compress this far: no mean includes them.\n"
        f"- Texture on its own: it takes {several(texture)} of the bytes, and PSNR counts it as an error.\n"
        "- Photographs that never influenced the codec: constants were chosen on other photographs from the same "
        "packages (`python -m benchmarks.perceptual.photographs` fetches both sets), and some settings of texture were "
        "tried on these too.",
        command="python -m benchmarks --full --images KODAK --weights WEIGHTS --only perceptual",
        contents=contents,
        panels=panels,
        of="means over the pictures; solid: Kodak, open marks: other photographs",
    )


def textures(contents: Mapping[str, Content]) -> dict[float, float]:
    """The share of texture in the bytes of files tuned for the eye, by rate, of the first set."""
    rows = next(iter(contents.values()))["rows"]
    found = {bpp: means(rows, bpp).get("visual") for bpp in rates(rows)}
    return {bpp: mine["texture"] for bpp, mine in found.items() if mine}


def sentence(name: str, content: Content) -> str:
    """What came out beside AVIF at the middle rate."""
    at = rates(content["rows"])
    bpp = at[len(at) // 2]
    average = means(content["rows"], bpp)
    if not {"visual", "avif"} <= set(average):
        return f"On {name}, AVIF was not measured."
    ours, avif = average["visual"], average["avif"]
    parts = [f"{ours[figure] / avif[figure]:.2f} times AVIF's {TITLES[figure]}" for figure in ("lpips", "dists")]
    points = ours["ssimulacra2"] - avif["ssimulacra2"]
    behind, of = worse(content["rows"], bpp, "visual", "avif", "ssimulacra2")
    return (
        f"On {name} at {bpp:g} bpp, files tuned for the eye have {several(parts)}. Their SSIMULACRA 2 is "
        f"{abs(points):.1f} points {'lower' if points < 0 else 'higher'} on average, and lower on {len(behind)} of "
        f"{of} pictures."
    )


def draw(axes: Any, contents: Mapping[str, Content], figure: str) -> None:
    """One figure against bits per pixel."""
    for k, kind in enumerate(KINDS):
        for name, content in contents.items():
            found = [(bpp, means(content["rows"], bpp).get(kind)) for bpp in rates(content["rows"])]
            points = [(bpp, of[figure]) for bpp, of in found if of]
            is_first = name == next(iter(contents))
            look = style(k) | ({"label": KINDS[kind].replace("`", "")} if is_first else {"fillstyle": "none"})
            if points:
                axes.plot(*zip(*points, strict=True), **look)
    axes.set(xlabel="bits per pixel", ylabel=TITLES[figure] + ("" if figure == "ssimulacra2" else ", better upwards"))
    if figure != "ssimulacra2":
        axes.invert_yaxis()
