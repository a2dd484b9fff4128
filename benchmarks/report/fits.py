"""Float quality at a fixed number of Gaussians; and the paper's tables, quoted beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from benchmarks import published
from benchmarks.report.section import Content, Section, mean, number, table

# Our methods, and what the paper calls them
NAMES = {
    "rd": "`rd`",
    "paper": "`paper`",
    "unregularised": "`paper` without regularisation",
    "random-start": "`paper` without structure-guided start",
    "baseline": "`baseline`, without both",
    "siren": "SIREN",
    "wire": "WIRE",
}
QUOTED = {
    "paper": "the paper",
    "unregularised": "without regularisation",
    "random-start": "without structure-guided start",
    "baseline": "GSImage",
    "siren": "SIREN",
    "wire": "WIRE",
}
COLUMNS = {
    "psnr": ("PSNR", ".2f"),
    "ms_ssim": ("MS-SSIM", ".4f"),
    "lpips": ("LPIPS", ".4f"),
    "seconds": ("seconds", ".1f"),
    "frames_per_s": ("frames a second", ",.4g"),
    "mib": ("MiB", ".0f"),
    "thousand_numbers": ("thousand parameters", ".1f"),
}
NOTHING_DB = 0.05  # of one seed
# The paper's tables that a run with that many Gaussians repeats
TABLES = {30_000: "parts, Kodak, 30,000 Gaussians", 70_000: "representation, Kodak, 70,000 Gaussians"}


def representation(content: Content) -> Section:
    """From representation.json; rows without a method are those of rd."""
    rows = [{"method": "rd", **row} for row in content["rows"]]
    lines, found, beside, best, every = [], [], [], [], []
    for asked in sorted({row["asked"] for row in rows}):
        means = _means([row for row in rows if row["asked"] == asked])
        for method, figures in means.items():
            cells = [number(figures[name], form) for name, (_, form) in COLUMNS.items()]
            lines.append([f"{asked:,}", NAMES[method], figures["pictures"], *cells])
        if "rd" in means:
            found.append(f"{means['rd']['psnr']:.2f} dB with {asked:,}")
        best.append(f"{asked:,} Gaussians: {best_of(means)}")
        every.append(means)
        if asked in TABLES:
            ours = by_method({"rows": rows}, asked)
            beside.append(f"{asked:,} Gaussians, by PSNR: {order(ours, quoted_values(TABLES[asked], 'psnr'))}")
    told = f"{', '.join(found)} Gaussians by profile `rd`, " if found else "See the table: "
    by_figure = {COLUMNS[figure][0] for means in every for figure, method in best_by_figure(means) if method != "rd"}
    behind = f"; others are ahead somewhere by {' and '.join(sorted(by_figure))}" if found and by_figure else ""
    said = (
        f"How well do N Gaussians show a picture before any number is rounded? {told}after "
        f"{content['settings']['steps']:,} steps{behind}. No file holds them, and the paper's figures, which are "
        "quoted, are of all 24 pictures, more steps and a GPU."
    )
    how = ""
    if any(row["method"] in QUOTED for row in rows):
        how = (
            "`paper` and what is left out of it are fitted by our optimiser and kernels, and a network for as many "
            "seconds as `rd` took in that run, which are few for it on processor cores. What the paper calls GSImage "
            "is GaussianImage, `baseline` here; nothing was measured on DIV2K. MiB is the fit's whole process, Python "
            "and torch included."
        )
    titles = " | ".join(["Gaussians", "method", "pictures", *(title for title, _ in COLUMNS.values())])
    told = f"The best with {'. With '.join(best)}."
    tables = [table(titles, lines), told, *beside, *quoted("representation"), *quoted("parts")]
    return Section("representation", "A fixed number of Gaussians", said, tables, [content], how=how)


def best_of(means: Mapping[str, Mapping[str, Any]]) -> str:
    """Which method is the best by each figure that every method has, in words."""
    return ", ".join(f"{NAMES[ahead]} by {COLUMNS[figure][0]}" for figure, ahead in best_by_figure(means))


def best_by_figure(means: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Each figure that every method has, and the method that is the best by it."""
    found = []
    for figure, pick in (("psnr", max), ("ms_ssim", max), ("lpips", min)):
        if all(figures[figure] is not None for figures in means.values()):
            found.append((figure, pick(means, key=lambda method: means[method][figure])))
    return found


def by_method(content: Content, asked: int) -> dict[str, float]:
    """PSNR of every method with so many Gaussians, by the paper's names."""
    rows = [{"method": "rd", **row} for row in content["rows"] if row["asked"] == asked]
    means = _means(rows) if rows else {}
    return {QUOTED[method]: figures["psnr"] for method, figures in means.items() if method in QUOTED}


def _means(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """By method, over the pictures that every method has; a figure that a row lacks is None."""
    by_method: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        by_method.setdefault(row["method"], {})[row["image"]] = row
    common = set.intersection(*(set(pictures) for pictures in by_method.values()))
    found: dict[str, dict[str, Any]] = {}
    for method in NAMES:
        mine = [row for image, row in by_method.get(method, {}).items() if image in common]
        if mine:
            figures = {name: mean([row.get(name) for row in mine]) for name in COLUMNS}
            found[method] = {"pictures": len(mine), **figures}
    return found


def order(ours: Mapping[str, float], theirs: Mapping[str, float], spreads: Mapping[str, float] | None = None) -> str:
    """Whether our rows, of which more is better, come in the paper's order. What differs by less than the larger of
    two spreads, or rounds to nothing, has none."""
    names = sorted((name for name in theirs if name in ours), key=lambda name: -theirs[name])
    if len(names) < 2:
        return "there are no two rows that the paper has."
    told, near = [], []
    for ahead, behind in pairwise(names):
        difference = ours[behind] - ours[ahead]
        if abs(difference) < max(NOTHING_DB, *((spreads or {}).get(name, 0.0) for name in (ahead, behind))):
            near.append(f"{ahead} against {behind}")
        elif difference >= 0:
            told.append(f"the paper has {ahead} ahead of {behind}, here {behind} is ahead by {difference:.2f} dB")
    if not told and not near:
        return "our rows come in the paper's order."
    by = f"less than {NOTHING_DB:g} dB" + (", or than the spread of seeds" if spreads else "")
    found = [f"our order differs: {'; '.join(told)}"] if told else []
    found += [f"too near to tell ({by}): {'; '.join(near)}"] if near else []
    return ". ".join(found).replace(". too", ". Too") + "."


def quoted_values(title: str, figure: str) -> dict[str, float]:
    """A figure of one of the paper's tables, by row; of Kodak where it has other pictures too."""
    rows = [row for row in published.paper()["rows_of"][title] if row.get("dataset", "Kodak") == "Kodak"]
    return {str(row["method"]) if "method" in row else f"{row['bits']:g}": float(row[figure]) for row in rows}


def quoted(name: str) -> list[str]:
    """The paper's tables whose names begin so."""
    paper = published.paper()
    found = []
    for title, rows in paper["rows_of"].items():
        if title.startswith(name):
            cells = [
                [value if isinstance(value, str) else number(value, "g") for value in row.values()] for row in rows
            ]
            titles = " | ".join(column.replace("_", " ") for column in rows[0])
            found.append(f"Quoted from the paper ({paper['hardware']}): {title}.\n\n" + table(titles, cells))
    return found
