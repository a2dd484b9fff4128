"""A page on which anyone can choose between this codec and AVIF without knowing which is which.

    python -m benchmarks.perceptual.blind --images FOLDER [--pairs 24] [--bpp 0.2] [--seed 0] [--out build/study]
    python -m benchmarks.perceptual.blind --score build/study/key.json ANSWERS.json ...

The first command (make study IMAGES=FOLDER) writes OUT/site, static files for a server or for a browser alone, and
OUT/key.json, which you keep. Each pair is a random part of a photograph, by one of our settings and one of AVIF's:
OURS and THEIRS, each with each equally often. AVIF's file is the largest within --bpp, and ours is no larger.
The page shows the source between them, draws the order of pairs anew for each visitor, has ours on the left in half of
them, and exports the answers as JSON. The second command says who is preferred, with 95 % intervals (study.py).
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from io import BytesIO
from itertools import cycle, product
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.machine import ROOT
from benchmarks.perceptual.study import summary, votes
from benchmarks.pictures import Pixels, chosen_from
from benchmarks.rd.baselines import AvifForSsimulacra2, AvifWithGrain, Baseline
from sgmethod import decode, encode
from sgmethod.io.image import read_image_8_bit
from sgmethod.profiles import Tune

PART = (360, 270)  # width and height in pixels
PAGE = Path(__file__).with_name("blind.html")
# What each side has for fidelity and for texture.
OURS: dict[str, Tune] = {"sgmethod fidelity": "fidelity", "sgmethod visual": "visual"}
THEIRS: dict[str, Callable[[], Baseline]] = {
    baseline.name: baseline for baseline in (AvifForSsimulacra2, AvifWithGrain)
}


def made(path: Path, bpp: float, pair: tuple[str, str], lot: np.random.Generator) -> dict[str, Pixels]:
    """The same part of the source, of our file and of AVIF's, in a file of as many bytes."""
    source = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
    ours, theirs = pair
    codec = THEIRS[theirs]()
    avif = codec.best(source, bpp).data
    data = encode(source, bytes=len(avif), tune=OURS[ours]).data
    y, x = (lot.integers(0, max(side - part, 0) + 1) for side, part in zip(source.shape, PART[::-1], strict=False))
    whole = {"source": source, ours: decode(data), theirs: codec.decode(avif)}
    return {name: pixels[y : y + PART[1], x : x + PART[0]] for name, pixels in whole.items()}


def saved(pixels: Pixels, folder: Path) -> str:
    """Write a PNG, and return its name, which tells nothing."""
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, "PNG")
    name = f"{hashlib.sha256(file.getvalue()).hexdigest()[:12]}.png"
    (folder / name).write_bytes(file.getvalue())
    return name


def make(paths: Sequence[Path], bpp: float, seed: int, out: Path) -> None:
    """Write the page and its key."""
    site, lot = out / "site", np.random.default_rng(seed)
    site.mkdir(parents=True, exist_ok=True)
    every = [pair for pair, _ in zip(cycle(product(OURS, THEIRS)), paths, strict=False)]
    key, pairs = {}, []
    for path, k in zip(paths, lot.permutation(len(every)), strict=True):
        source, *versions = made(path, bpp, every[k], lot).items()
        name = saved(source[1], site)
        key[name] = {
            "photograph": path.stem,
            "versions": {saved(pixels, site): codec for codec, pixels in versions},
        }
        pairs.append([name, *key[name]["versions"]])
    (out / "key.json").write_text(json.dumps({"bpp": bpp, "seed": seed, "pairs": key}, indent=1) + "\n")
    (site / "pairs.js").write_text(f"const PAIRS = {json.dumps(in_twos(pairs, lot))};\n")
    shutil.copy(PAGE, site / "index.html")


def in_twos(pairs: Sequence[list[str]], lot: np.random.Generator) -> list[list[str]]:
    """Of each two pairs one, drawn by lot, with its versions turned: the page turns both or none, so that every visitor
    sees ours on the left as often as on the right, and nothing on the page says which is ours."""
    turned = [[source, second, first] for source, first, second in pairs]
    first_of_two = lot.integers(0, 2, len(pairs) // 2 + 1)
    return [(turned if k % 2 == first_of_two[k // 2] else pairs)[k] for k in range(len(pairs))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--images", type=Path, help="a folder of photographs")
    which.add_argument("--score", type=Path, metavar="KEY.json")
    parser.add_argument("answers", type=Path, nargs="*")
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--bpp", type=float, default=0.2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "study")
    options = parser.parse_args()
    if options.score:
        if not options.answers:
            parser.error("--score needs the visitors' answers")
        answers = [json.loads(path.read_text()) for path in options.answers]
        print(summary(votes(json.loads(options.score.read_text()), answers)))
    else:
        make(chosen_from(options.images, options.pairs), options.bpp, options.seed, options.out)
        key = options.out / "key.json"
        print(f"put {options.out / 'site'} on a server, or open its index.html; {key} is for you alone")
        print(f"count answers with: python -m benchmarks.perceptual.blind --score {key} ANSWERS.json ...")


if __name__ == "__main__":
    main()
