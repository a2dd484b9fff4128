"""Make docs/results, its plots, CSV files and the README's tables from the JSON of benchmarks/results.

    python -m benchmarks.report [--check] [--root FOLDER]

Nobody types a figure of a page. --check writes nothing, and exits with 1 where a document differs from the JSON; it
needs no matplotlib, as plots are not compared. --root: a folder with benchmarks/results, docs and README.md; this
checkout's.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.flat import flat
from benchmarks.report import previews, rate, readme, seen, service, speed, stability
from benchmarks.report.plots import save
from benchmarks.report.section import Content, Page, load, table
from sgmethod.io.files import write_atomically
from tests.harness.data import ROOT

# Each page, the JSON that it cannot do without, and further ones.
MAKERS: tuple[tuple[Callable[[Mapping[str, Content]], Page], tuple[str, ...], tuple[str, ...]], ...] = (
    (rate.page, ("rd/kodak",), ("rd/effort", "rd/avif", "rd/quality")),
    (
        speed.page,
        ("convergence/kodak",),
        ("convergence/2-megapixels", "convergence/12-megapixels", "speed", "growth"),
    ),
    (previews.page, ("previews/kodak",), ()),
    (seen.page, ("perceptual/kodak",), ("perceptual/photographs",)),
    (stability.page, (), ("stiff", "stability", "strict")),
    (service.page, (), ("service/load", "service/attacks", "service/chaos-sqlite", "service/chaos-postgresql")),
)
APART = {"stiff": "picture"}  # of the CSV, besides the usual
HEAD = """# Results

Each page answers one question. `python -m benchmarks.report` generates all but the page on the paper from the JSON in
[benchmarks/results](../../benchmarks/results); no figure of these is typed by hand."""
BY_HAND = ["[The paper](paper.md)", "Which of the paper's gains show here, sentence by sentence and table by table."]
TAIL = """## Words

- **bpp**: bits per pixel, 8 times the bytes of a file divided by its pixels.
- Higher is better for **PSNR** (dB), **MS-SSIM** and **SSIMULACRA 2**; lower is better for **LPIPS** (AlexNet) and
  **DISTS**.
- **Bits for the same PSNR**: the BD-rate over the range of PSNR that both codecs reach, computed for each picture and
  averaged over pictures. Negative means fewer bits.
- **Quoted**: published by others and not measured here; the sources are in
  [benchmarks/published](../../benchmarks/published).
- **Mosaic**: a large picture assembled from several of Kodak's.

## Repeat a measurement

The command on each page runs in a checkout after `pip install -e '.[benchmark]'`, or `'.[test]'` for the
service. It writes to `benchmarks/results` and resumes where it was interrupted. KODAK is a folder with the 24 PNG files
of [Kodak's set](https://r0k.us/graphics/kodak/), and WEIGHTS the folder that
`python -m benchmarks.perceptual.weights WEIGHTS` fills. MEASURED and LARGE are the folders `measured` and `large` that
`python -m benchmarks.perceptual.photographs FOLDER` makes. For a quick trial, run `make bench`, which runs small
versions of most measurements in ten minutes, or `python -m benchmarks.rd --images KODAK --pictures kodim05 --bpp 0.25
--rivals`. Both write to `build/bench`."""


def pages(results: Path) -> list[Page]:
    """The pages whose figures were measured."""
    found = []
    for make, needed, more in MAKERS:
        contents = {name: content for name in (*needed, *more) if (content := load(results, name))}
        if contents and {*needed} <= {*contents}:
            found.append(make(contents))
    return found


def index(made: list[Page]) -> str:
    """A line for each page, and the words that all use."""
    lines = [[f"[{page.title}]({page.name}.md)", page.conclusion] for page in made]
    return "\n\n".join([HEAD, table("page | result", [*lines, BY_HAND]), TAIL]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--root", type=Path, default=ROOT)
    options = parser.parse_args()
    root: Path = options.root
    results, docs = root / "benchmarks" / "results", root / "docs"
    made = pages(results)
    texts = {docs / "results" / f"{page.name}.md": f"{page.text()}\n" for page in made}
    texts |= {docs / "results" / "README.md": index(made)}
    contents = {name: content for page in made for name, content in page.contents.items()}
    texts |= {
        results / "csv" / f"{name}.csv": flat(content["rows"], APART.get(name, ""))
        for name, content in contents.items()
    }
    texts |= {root / "README.md": readme.filled((root / "README.md").read_text(), results)}
    if options.check:
        stale = [path for path, text in texts.items() if not path.exists() or path.read_text() != text]
        if stale:
            names = ", ".join(str(path.relative_to(root)) for path in stale)
            raise SystemExit(f"{names}: not what the JSON says; run python -m benchmarks.report")
        return
    for page in made:
        if page.panels:
            save(page.panels, page.title, page.of, docs / "plots" / page.name)
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.encode())


if __name__ == "__main__":
    main()
