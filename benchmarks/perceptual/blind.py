"""A page on which anyone can choose between this codec and AVIF without knowing which is which.

    python -m benchmarks.perceptual.blind --images FOLDER [--pairs 20] [--bpp 0.2] [--seed 0] [--out build/blind]
    python -m benchmarks.perceptual.blind --score build/blind/key.json ANSWERS.json ...

The first command writes OUT/site, static files for a server or for a browser alone, and OUT/key.json, which stays home.
Each pair is a part of a photograph, drawn by lot: our file tuned for the eye, and the largest of AVIF (8 bits, 4:4:4,
speed 4, tune=iq) that is no larger than --bpp; ours is no larger than AVIF's. The page draws the order of pairs and
sides anew for each visitor, shows the source between them, and hands out the answers as JSON. The second command counts
votes; its standard error is over pairs, as the votes on one pair are not independent.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.machine import ROOT
from benchmarks.pictures import Pixels, chosen_from
from benchmarks.rd.baselines import AvifOf8BitsForEyes
from benchmarks.tables import mean, number, standard_error, table
from sgmethod import decode, encode
from sgmethod.io.image import read_image_8_bit

PART = (360, 270)  # width and height in pixels
PAGE = Path(__file__).with_name("blind.html")
NEITHER = "neither"


def made(path: Path, bpp: float, lot: np.random.Generator) -> dict[str, Pixels]:
    """The same part of the source, of our file and of AVIF's."""
    source = read_image_8_bit(path.read_bytes())
    codec = AvifOf8BitsForEyes()
    avif = codec.best(source, bpp).data
    ours = encode(source, bytes=len(avif)).data
    y, x = (lot.integers(0, max(side - part, 0) + 1) for side, part in zip(source.shape, PART[::-1], strict=False))
    whole = {"source": source, "ours": decode(ours), "avif": codec.decode(avif)}
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
    key, pairs = {}, []
    for path in paths:
        names = {name: saved(pixels, site) for name, pixels in made(path, bpp, lot).items()}
        key[names["source"]] = {"photograph": path.stem, "ours": names["ours"], "avif": names["avif"]}
        pairs.append([names["source"], *sorted([names["ours"], names["avif"]])])
    (out / "key.json").write_text(json.dumps({"bpp": bpp, "seed": seed, "pairs": key}, indent=1) + "\n")
    (site / "pairs.js").write_text(f"const PAIRS = {json.dumps(pairs)};\n")
    shutil.copy(PAGE, site / "index.html")


def score(key: dict[str, Any], answers: Sequence[dict[str, Any]]) -> str:
    """Count votes: a line for each pair, and the share of ours among those that chose."""
    votes: dict[str, dict[str, int]] = {}
    for answer in (one for visitor in answers for one in visitor["answers"]):
        pair = key["pairs"].get(answer["source"])
        if pair is None:
            raise SystemExit(f"{answer['source']} is not in the key: it is another page's")
        name = next((name for name in ("ours", "avif") if pair[name] == answer["chosen"]), NEITHER)
        of_pair = votes.setdefault(pair["photograph"], {"ours": 0, "avif": 0, NEITHER: 0})
        of_pair[name] += 1
    lines = [[name, *of_pair.values()] for name, of_pair in sorted(votes.items())]
    shares = [of["ours"] / (of["ours"] + of["avif"]) for of in votes.values() if of["ours"] + of["avif"]]
    whole = f"visitors: {len(answers)}, pairs: {len(votes)}; ours is preferred in {number(mean(shares), '.1%')}"
    return f"{table('photograph | ours | AVIF | neither', lines)}\n\n{whole} ± {number(standard_error(shares), '.1%')}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--images", type=Path, help="a folder of photographs")
    which.add_argument("--score", type=Path, metavar="KEY.json")
    parser.add_argument("answers", type=Path, nargs="*")
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--bpp", type=float, default=0.2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "blind")
    options = parser.parse_args()
    if options.score:
        print(score(json.loads(options.score.read_text()), [json.loads(path.read_text()) for path in options.answers]))
    else:
        make(chosen_from(options.images, options.pairs), options.bpp, options.seed, options.out)
        print(f"open {options.out / 'site' / 'index.html'}; {options.out / 'key.json'} stays at home")


if __name__ == "__main__":
    main()
