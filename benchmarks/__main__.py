"""A small set of all measurements, in ten minutes at most, or what docs/results.md shows.

    python -m benchmarks [--full --images KODAK --weights FOLDER] [--only rd,needs]

The small set takes the pictures of the tests and writes to build/bench. --full writes to benchmarks/results and goes on
where it was stopped, as long as code and machine are the same; python -m benchmarks.report then makes the documents.
Each command's own text has its options. Not among them: benchmarks.perceptual and image, which need weights and root,
the document has their commands; turns, which compares with a second checkout; and again, for results of earlier code.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.arguments import some_of
from benchmarks.machine import RESULTS, RUNS
from tests.harness.data import PHOTOGRAPHS, ROOT

IMAGES = "--images {images}"
FEW = "--bpp 0.5 --most 1"


@dataclass(frozen=True)
class Part:
    """One command: the JSON that it writes, and its arguments in the small set and in the whole."""

    module: str
    result: str
    small: str
    full: str
    rivals: str = ""  # added where other codecs are there


PARTS = (
    Part("rd", "rd/kodak", f"{IMAGES} --bpp 0.5", f"{IMAGES} --bpp 0.1,0.15,0.25,0.4", "--rivals"),
    Part("rd", "rd/effort", "", f"{IMAGES} --effort 9 --tune psnr --bpp 0.15,0.25,0.4"),
    Part(
        "rd",
        "rd/settings",
        "",
        f"{IMAGES} --profiles '' --bpp 0.1,0.15,0.25,0.4 --rivals 'jpegxl effort 4'",
    ),
    Part(
        "rd",
        "rd/patient",
        "",
        f"{IMAGES} --profiles '' --bpp 0.1,0.15,0.25,0.4 --rivals 'avif tune=psnr speed 0'",
    ),
    Part("rd", "rd/quality", "", f"{IMAGES} --quality 20,30,40,50,60,70"),
    Part("rd", "rd/effort-quality", "", f"{IMAGES} --effort 9 --tune psnr --quality 20,30,40,50,60,70"),
    Part("rd", "rd/paper", "", f"{IMAGES} --profiles paper --bpp 0.147,0.43"),
    Part(
        "rd",
        "rd/fitted",
        "",
        f"{IMAGES} --most 6 --profiles baseline --steps 20000 --coin --bpp 0.15,0.25,0.4",
    ),
    Part(
        "convergence",
        "convergence/kodak",
        f"{IMAGES} {FEW} --megapixels 0.1 --seconds 6 --limits 0.25,0.5,1 --paper-limits 2 --few",
        f"{IMAGES} --most 5 --megapixels 0.4",
    ),
    Part("convergence", "convergence/2-megapixels", "", f"{IMAGES} --most 5 --megapixels 2 --few"),
    Part(
        "convergence",
        "convergence/12-megapixels",
        "",
        f"{IMAGES} --most 5 --megapixels 12 --few --limits 0.25,0.5,1,2,4,8,16,32 --paper-limits 10,30",
    ),
    Part(
        "convergence",
        "convergence/codecs",
        "",
        f"{IMAGES} --most 5 --megapixels 2,12 --methods 'rd,rd visual,jpeg,jpeg2000,webp,avif,jpegxl,avif visual' "
        "--settings ',effort 1,10,9,8,7,6,5,4,3,2,1,0'",
    ),
    Part("needs", "needs", "--repeats 1", ""),
    Part("stability", "stability", "--seeds 3 --generations 4 --mutations 2000", "--mutations 1000000 --sanitize"),
    Part("stiff", "version4/stiff", "--pictures text,row-300x1,pixel-1x1 --seeds 1 --only bpp", ""),
    Part(
        "speed",
        "speed",
        f"{IMAGES} --megapixels 0.1,0.4 --gaussians 1000,5000 --repeats 1 --steps 100 --rounds 10",
        IMAGES,
    ),
    Part("representation", "representation", f"{IMAGES} --most 1 --gaussians 500 --steps 300", IMAGES),
    Part("ablation", "ablation", f"{IMAGES} {FEW} --seeds 1 --steps 100 --fit-steps 200 --tune-steps 100", IMAGES),
    Part("load", "service/load", f"{IMAGES} --seconds 5", IMAGES),
    Part("attacks", "service/attacks", "--seconds 5 --only none,decode,idle", ""),
    Part("chaos", "service/chaos-sqlite", "", "--jobs 200 --seed 7"),
    Part("chaos", "service/chaos-postgresql", "", "--jobs 200 --seed 7 --database-url postgresql"),
    Part("soak", "service/soak", "", ""),
)


def run(part: Part, options: argparse.Namespace) -> float:
    """Seconds that the command took. Its failure does not keep others from running."""
    line = (part.full if options.full else part.small).format(images=shlex.quote(str(options.images)))
    words = shlex.split(line)
    if options.weights and part.module in ("rd", "convergence", "representation"):
        words += ["--weights", str(options.weights)]
    if part.module == "convergence":
        words += [] if has_rivals() else ["--methods", "rd,rd visual,paper,baseline,plain Adam,siren,hash grid"]
    elif has_rivals():
        words += part.rivals.split()
    out = (RESULTS if options.full else RUNS) / f"{part.result}.json"
    print(f"--- {part.module}: {' '.join(words)}", flush=True)
    began = time.monotonic()
    command = [sys.executable, "-m", f"benchmarks.{part.module}", *words, "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, check=False)
    if done.returncode != 0:
        print(f"{part.module} failed with status {done.returncode}", file=sys.stderr)
    return time.monotonic() - began


def has_rivals() -> bool:
    """Whether other codecs can be measured."""
    from benchmarks.rd.rivals import versions

    return bool(versions())


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--images", type=Path, default=PHOTOGRAPHS)
    modules = list(dict.fromkeys(part.module for part in PARTS))
    parser.add_argument("--only", type=some_of(modules, "command"), default=",".join(modules), help="commands")
    parser.add_argument("--weights", type=Path, help="folder as benchmarks.perceptual takes it, for LPIPS and its like")
    options = parser.parse_args()
    if options.full and options.images == PHOTOGRAPHS:
        parser.error("--full needs --images: a folder with the 24 pictures of Kodak")
    if options.full and not options.weights:
        parser.error("--full needs --weights: python -m benchmarks.perceptual.weights FOLDER fetches them")
    if options.full and not has_rivals():
        parser.error("--full needs the other codecs: pip install -e '.[benchmark]'")
    wanted = [part for part in PARTS if part.module in options.only and (options.full or part.small)]
    taken = [(part.result, run(part, options)) for part in wanted]
    print("\n".join(f"{name}: {seconds:.0f} s" for name, seconds in taken))


if __name__ == "__main__":
    main()
