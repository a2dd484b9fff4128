"""Make docs/results.md, its plots and the README's tables from the JSON of benchmarks/results.

    python -m benchmarks.report [--check] [--root FOLDER]

Nobody types a figure of a table. --check writes nothing, and exits with 1 where a document differs from the JSON; it
needs no matplotlib, as plots are not compared. --root: a folder with benchmarks/results, docs and README.md; this
checkout's.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from benchmarks.ablation import report as ablation
from benchmarks.again import report as again
from benchmarks.perceptual import report as perceptual
from benchmarks.published import claims
from benchmarks.published import report as published
from benchmarks.report import convergence, fits, needs, rate, readme, service, speed, stability
from benchmarks.report.plots import save
from benchmarks.report.section import Section, load
from sgmethod.io.files import write_atomically
from tests.harness.data import ROOT

# Each section, and the JSON that it is made from.
MAKERS: tuple[tuple[Callable[..., Section], tuple[str, ...]], ...] = (
    (rate.section, ("rd/kodak", "rd/effort", "rd/paper", "rd/fitted", "rd/settings", "rd/patient")),
    (published.section, ("rd/kodak", "rd/effort", "rd/paper", "rd/quality", "rd/effort-quality")),
    (perceptual.section, ("perceptual/kodak", "perceptual/photographs")),
    (convergence.whole, ("convergence/kodak",)),
    (convergence.large, ("convergence/2-megapixels", "convergence/12-megapixels")),
    (convergence.codecs, ("convergence/codecs",)),
    (needs.section, ("needs",)),
    (stability.section, ("version4/stiff", "stability")),
    (speed.section, ("speed",)),
    (fits.representation, ("representation",)),
    (ablation.section, ("ablation",)),
    (claims.section, ("representation", "ablation", "rd/paper")),
    (again.section, ("again",)),
    (service.under_load, ("service/load",)),
    (service.attacked, ("service/attacks",)),
    (service.killed, ("service/chaos-sqlite", "service/chaos-postgresql")),
    (service.soaked, ("service/soak",)),
    (service.image, ("service/image",)),
)
HEAD = """# Results

Made from the JSON of [benchmarks/results](../benchmarks/results) by `python -m benchmarks.report`. No figure of a table
was typed, only remarks on a run. Each section says what was asked and what came out, then what it does not show. The
line below its tables has the command, the machine, the commit and the date. "Quoted" marks figures that others
published, with their source in [benchmarks/published](../benchmarks/published); nobody measured them here.

bpp are bits per pixel: 8 times the bytes of a file, over its pixels. PSNR (dB), MS-SSIM and SSIMULACRA 2 are better if
higher, LPIPS and DISTS if lower. A BD-rate, Bjøntegaard's, says how many bits one codec takes more or less than another
for the same quality, a mean over the qualities that both reach: of each picture and then over pictures, or of one curve
of means. p50 and p99 are times that half of all requests, or 99 of 100, do not exceed.

To repeat a row, run the command below its table in a checkout, after `pip install -e '.[encode,benchmark]'`, or
`'.[test,benchmark]'` for those of the service and `--sanitize`: it writes to `build/bench`, or where `--out` says. Not
all rows are of one commit: the line and the remark below a table say of which. Most commands take `--pictures` and
fewer settings as well, such as
`python -m benchmarks.rd --images KODAK --pictures kodim05 --bpp 0.25 --profiles rd --rivals`.
`python -m benchmarks.again --images KODAK` does so for rows drawn by chance, and says which came out otherwise.
KODAK is a folder with the 24 PNG files of [Kodak's set](https://r0k.us/graphics/kodak/), WEIGHTS what
`python -m benchmarks.perceptual.weights FOLDER` fetches, and PHOTOGRAPHS the folder `measured` of what
`python -m benchmarks.perceptual.photographs FOLDER` fetches."""


def sections(results: Path) -> list[Section]:
    """Those that have been measured."""
    found = [(make, [load(results, name) for name in names]) for make, names in MAKERS]
    return [make(*contents) for make, contents in found if any(contents)]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--root", type=Path, default=ROOT)
    options = parser.parse_args()
    root: Path = options.root
    results = root / "benchmarks" / "results"
    made = sections(results)
    texts = {
        root / "docs" / "results.md": "\n\n".join([HEAD, *(section.text() for section in made)]) + "\n",
        root / "README.md": readme.filled((root / "README.md").read_text(), results),
    }
    if options.check:
        stale = [path.name for path, text in texts.items() if not path.exists() or path.read_text() != text]
        if stale:
            raise SystemExit(f"{' and '.join(stale)}: not what the JSON says; run python -m benchmarks.report")
        return
    for section in made:
        if section.panels:
            save(section.panels, section.title, section.of, root / "docs" / "plots" / section.name)
    for path, text in texts.items():
        write_atomically(path, text.encode())


if __name__ == "__main__":
    main()
