"""Make the tables and plots of docs/results and README.md from the JSON of benchmarks/results.

    python -m benchmarks.report [--check]

People write the pages. The command replaces what lies between <!-- table NAME --> and <!-- end -->. Behind a measured
figure of a sentence stands its name, as in 13.9<!-- rate.fewer-than-avif -->: the command compares the two, and exits
with 1 where a sentence has to change. --check writes nothing, and also exits with 1 where a table would change; it
needs no matplotlib, as plots are not compared.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial

from benchmarks.machine import ROOT, write_text
from benchmarks.report import equal, paper, previews, rate, scenes, service, speed, stability
from benchmarks.report.plots import Draw, save
from benchmarks.report.results import sources

TABLE = re.compile(r"( *)<!-- table ([\w-]+)((?: \S+)*) -->\n.*?<!-- end -->", re.DOTALL)
FIGURE = re.compile(r"(\S*)<!--\s+([\w-]+\.[\w.-]+)\s+-->")  # a line may end within a mark
TABLES: dict[str, Callable[[], str]] = {
    "readme": rate.readme_table,
    "rate": rate.codecs_table,
    "headline": rate.headline_table,
    "headline-eye": rate.eye_table,
    "quoted": rate.quoted_table,
    **{f"equal-{size}": partial(equal.means_table, size) for size in equal.FILES},
    **{f"equal-{size}-differences": partial(equal.differences_table, size) for size in equal.FILES},
    "costs-small": partial(speed.costs_table, 0.4),
    "costs-large": partial(speed.costs_table, 4),
    "costs-largest": partial(speed.costs_table, 12),
    "until": speed.until,
    "growth-by-pixels": partial(speed.growth, "megapixels"),
    "growth-by-bytes": partial(speed.growth, "max_bytes"),
    "paper-optimiser": paper.optimiser_table,
    "paper-files": paper.files_table,
    "paper-baselines": paper.baselines_table,
    "paper-positions": paper.positions_table,
    "paper-seeds": paper.seeds_table,
    "paper-bitwidths": paper.bitwidths_table,
    "paper-jpeg": paper.jpeg_table,
    "previews": previews.by_bytes,
    "previews-at-512-bytes": previews.at_one_size,
    "trained": rate.trained_table,
    "stability": stability.rules_table,
    "needles": stability.needles_table,
    "worse": stability.worse_list,
    "scenes": scenes.needs_table,
    "large-scenes": scenes.large_table,
    "savings": scenes.savings_table,
    "service": service.situations,
}
# Title, second line and panels of each plot.
PLOTS: dict[str, tuple[str, str, Sequence[Draw]]] = {
    "rate": (
        "Rate against quality",
        "means of 24 pictures of Kodak",
        [partial(rate.draw, figure=figure) for figure in ("psnr", "ssimulacra2")],
    ),
    "speed": (
        "Error against run time",
        "PSNR against seconds, means over the pictures of each size",
        [partial(speed.draw, megapixels=size) for size in speed.SIZES],
    ),
    "paper": ("Gaussians by structure", "before coding, means of 12 pictures and standard errors", [paper.draw]),
    "previews": ("Previews", "means of 24 pictures of Kodak", [previews.draw]),
    "service": ("The service", "p99 of other clients under each attack", [service.draw]),
}


@cache
def figures() -> dict[str, float | None]:
    """Every figure that a sentence may have, by its mark."""
    parts = (paper, rate, equal, speed, scenes, previews, stability, service)
    return {mark: value for part in parts for mark, value in part.figures().items()}


def filled(text: str) -> str:
    """A page with its tables as the JSON has them. Raises KeyError for a table that is not known."""

    def made(match: re.Match[str]) -> str:
        indent, name, words = match.groups()
        content = sources(words.split()) if name == "sources" else TABLES[name]()
        return f"{indent}<!-- table {name}{words} -->\n{content}\n{indent}<!-- end -->"

    return TABLE.sub(made, text)


def stale(text: str) -> Iterator[str]:
    """The marked figures of a page that differ from the JSON, each as a line."""
    for shown, mark in FIGURE.findall(text):
        digits = re.search(r"-?[\d,]*\.?\d+$", shown)
        value = figures().get(mark)
        if digits is None or value is None:
            yield f"{shown or 'no figure'} ({mark}): {'no such figure' if value is None else 'no number'}"
            continue
        decimals = len(digits[0].partition(".")[2])
        if f"{value:,.{decimals}f}" != digits[0]:
            yield f"{digits[0]} ({mark}): the JSON has {value:,.{decimals + 1}f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    documents = [path for folder in ("docs", "docs/results") for path in sorted((ROOT / folder).glob("*.md"))]
    pages = {path: path.read_text() for path in (ROOT / "README.md", *documents)}
    texts = {path: filled(text) for path, text in pages.items()}
    errors = [f"{path.relative_to(ROOT)}: {line}" for path, text in pages.items() for line in stale(text)]
    changed = [path for path, text in texts.items() if text != pages[path]]
    if options.check:
        errors += [f"{path.relative_to(ROOT)}: run python -m benchmarks.report" for path in changed]
    else:
        for path in changed:
            write_text(path, texts[path])
        for name, (title, of, panels) in PLOTS.items():
            save(panels, title, of, ROOT / "docs" / "plots" / name)
    if errors:
        sys.exit("\n".join(errors))


if __name__ == "__main__":
    main()
