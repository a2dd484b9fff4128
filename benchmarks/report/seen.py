"""What people see: metrics that follow the eye, beside AVIF at the same bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from benchmarks import published
from benchmarks.perceptual import local
from benchmarks.perceptual.means import BETTER_IF_LOWER, means, rates, worse
from benchmarks.rd.report import TITLES
from benchmarks.report.plots import style
from benchmarks.report.section import Content, Draw, Page, number, several, table

SETS = {"perceptual/kodak": "Kodak", "perceptual/photographs": "other photographs"}
KINDS = {
    "visual": "tuned for the eye",
    "psnr": "tuned for PSNR",
    "avif": "AVIF, `tune=iq`",
    "avif grain": "AVIF, `tune=iq`, grain",
    "avif tune=ssimulacra2": "AVIF, `tune=ssimulacra2`",
    "jpegxl": "JPEG XL",
}
TITLES = TITLES | {
    "bytes": "bytes",
    "wasserstein": "Wasserstein Distortion",
    "spread_luma_fine": "spread kept",
    "kurtosis_luma_fine": "kurtosis",
}
TITLES |= {name: " ".join(reversed(name.split("_"))) for name in local.FIGURES if name not in TITLES}
FORMS = {"bytes": ",.0f", "psnr": ".2f", "ms_ssim": ".4f", "ssimulacra2": ".1f", "wasserstein": ".2f"}
FORMS |= {"lpips": ".3f", "dists": ".3f"} | dict.fromkeys(local.FIGURES, ".2f")
TABLE = ("bytes", "psnr", "ssimulacra2", "lpips", "dists", "wasserstein", "spread_luma_fine", "kurtosis_luma_fine")
PLOTTED = ("ssimulacra2", "lpips", "dists")


def tabled(contents: Mapping[str, Content], wanted: Sequence[str], bpp: float) -> str:
    """A table of means of those figures that were measured."""
    figures, found = measured(contents, wanted), []
    for name, content in contents.items():
        for kind, mean in means(content["rows"], bpp).items():
            if kind in KINDS:
                cells = [number(mean[figure], FORMS[figure]) for figure in figures]
                found.append([SETS[name], KINDS[kind], *cells])
    return table(" | ".join(["pictures", "file", *map(TITLES.__getitem__, figures)]), found)


def measured(contents: Mapping[str, Content], figures: Sequence[str]) -> list[str]:
    """The figures that some row has."""
    rows = [row for content in contents.values() for row in content["rows"]]
    return [name for name in figures if any(name in row for row in rows)]


def middle(content: Content) -> float:
    """The rate that the page is about."""
    at = rates(content["rows"])
    return at[len(at) // 2]


def page(contents: Mapping[str, Content]) -> Page:
    """The page from perceptual/kodak.json and perceptual/photographs.json, as far as there are."""
    bpp = middle(next(iter(contents.values())))
    appendix = []
    if measured(contents, local.FIGURES):
        appendix = [f"Local statistics over the source's:\n\n{tabled(contents, local.FIGURES, bpp)}"]
    panels: list[Draw] = [partial(draw, contents=contents, figure=figure, bpp=bpp) for figure in PLOTTED]
    first = means(next(iter(contents.values()))["rows"], bpp)
    texture = f"{100 * first['visual']['texture']:.1f} %" if "visual" in first else "some"
    return Page(
        name="seen",
        title="What people see",
        question="How good do files look, according to metrics that are designed to agree with people? Each picture is "
        f"encoded at {bpp:g} bpp tuned for the eye (the default), and by others at the best quality that takes no more "
        "bytes; `tune=iq` is AVIF's own default. Higher is better for SSIMULACRA 2, lower for LPIPS, "
        "DISTS and Wasserstein Distortion. Spread kept and kurtosis are those of detail of 2 to 4 pixels over the "
        "source's, in squares of 48 pixels that have some: below 1, the first is a wash; above 1, the second is a few "
        "lonely strokes.",
        table=tabled(contents, TABLE, bpp),
        conclusion=" ".join(sentence(SETS[name], content) for name, content in contents.items()),
        limits=f"{trained(bpp)}"
        "- Equal sizes: AVIF's settings are coarse, and leave bytes unused.\n"
        "- Human judgement: no panel of viewers was asked. Three readers of this project picked between ours and "
        "AVIF's without names at 0.2 bpp, in twelve parts of each kind. Ours had 13 of 36 votes in hard grainy crops, "
        "18 in grainy parts of Kodak, 15 in parts of other photographs, and 33 in faces, lettering, buildings and sky. "
        "These sheets helped to choose the noise, and readers prefer what is called A ([more]"
        "(../notebook/eye.md#should-faint-grain-come-back-whole)). [A sheet of crops at twice their "
        "size](../seen.webp) shows the source, this codec, AVIF and JPEG XL; `python -m benchmarks.perceptual.sheet` "
        "generates it.\n"
        "- Artefacts that no metric detects well, such as streaks and dots in smooth areas.\n"
        "- Pictures that AVIF (as built into imagecodecs) cannot compress this far: no mean includes them. A codec "
        "that cannot with another picture has no row.\n"
        f"- Texture on its own: it takes {texture} of the bytes, and PSNR counts it as an error.\n"
        "- Photographs that never influenced the codec: constants were chosen on other photographs from the same "
        "packages (`python -m benchmarks.perceptual.photographs` fetches both sets), and some settings of texture were "
        "tried on these too.",
        command="python -m benchmarks --full --images KODAK --weights WEIGHTS --only perceptual\n"
        "python -m benchmarks.perceptual --images MEASURED --weights WEIGHTS --bpp 0.25 --kinds visual avif "
        "--out benchmarks/results/perceptual/photographs.json",
        contents=contents,
        panels=panels,
        appendix=appendix,
        of="each mark is a picture; right of the line ours is better",
    )


def trained(bpp: float) -> str:
    """A line on a codec that is trained for the eye, at the quoted rate next to bpp."""
    at = min(published.seen()["points"], key=lambda point: abs(point["bpp"] - bpp))
    return (
        "- Learned decoders that are trained for the eye, which are far ahead of everything here. On Kodak, CRDR has "
        f"an LPIPS of {at['lpips']:.3f}, a DISTS of {at['dists']:.3f} and {at['psnr']:.1f} dB at {at['bpp']:.2f} bpp, "
        "by its published figures; a decode takes a network, and seconds.\n"
    )


def sentence(name: str, content: Content) -> str:
    """What came out beside AVIF at the middle rate."""
    bpp = middle(content)
    average = means(content["rows"], bpp)
    if not {"visual", "avif"} <= set(average):
        return f"On {name}, AVIF was not measured."
    ours, avif = average["visual"], average["avif"]
    lower = measured({name: content}, BETTER_IF_LOWER)
    parts = [f"{ours[figure] / avif[figure]:.2f} times AVIF's {TITLES[figure]}" for figure in lower]
    points = ours["ssimulacra2"] - avif["ssimulacra2"]
    behind, of = worse(content["rows"], bpp)
    return (
        f"On {name} at {bpp:g} bpp, files tuned for the eye have {several(parts)}. Their SSIMULACRA 2 is "
        f"{abs(points):.1f} points {'lower' if points < 0 else 'higher'} on average, and lower on {behind} of {of} "
        "pictures."
    )


def draw(axes: Any, contents: Mapping[str, Content], figure: str, bpp: float) -> None:
    """One figure of AVIF's files against that of ours, picture by picture, on axes from bad to good."""
    for k, (name, content) in enumerate(contents.items()):
        rows = [row for row in content["rows"] if row["max_bpp"] == bpp]
        ours, avif = ({r["image"]: r[figure] for r in rows if r["kind"] == kind} for kind in ("visual", "avif"))
        both = [(ours[image], avif[image]) for image in ours if image in avif]
        if both:
            axes.plot(*zip(*both, strict=True), **style(k) | {"linestyle": "none", "label": SETS[name]})
    ends = min(axes.get_xlim()[0], axes.get_ylim()[0]), max(axes.get_xlim()[1], axes.get_ylim()[1])
    good_last = ends if figure == "ssimulacra2" else ends[::-1]
    axes.plot(ends, ends, color="0.6", linewidth=0.8)
    axes.set(xlim=good_last, ylim=good_last, xlabel=f"{TITLES[figure]} of ours, better to the right", ylabel="of AVIF")
