"""Encode again what published rows say of our files: does today's encoder make the same ones?

    python -m benchmarks.again rd/kodak convergence/4-megapixels --images KODAK --photographs PHOTOGRAPHS [--most 24]

Of each JSON of rd or convergence, at most --most rows of ours without a time limit, drawn by chance. A row is alike if
bytes and PSNR are. Files differ between processors, by the last bits of each step; at least the instruction set is the
one that a JSON names. Pages say how many are alike or, if not all are, the mean difference in PSNR.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import re
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.convergence import OURS, TUNED
from benchmarks.machine import ISA_NAMES, RESULTS, RUNS, Record, alone, rows_of
from benchmarks.pictures import Pixels, pictures_in, sized
from benchmarks.rd.codecs import Sg
from sgmethod import decode
from sgmethod.io.image import read_image_8_bit
from sgmethod.metrics import psnr
from sgmethod.native import ISAS
from sgmethod.profiles import DEFAULT_EFFORT, TUNES

SAME_DB = 1e-6
SG_ISA = dict(zip(ISA_NAMES, ISAS, strict=True))  # its value for the name in a JSON
Row = dict[str, Any]


class Made(NamedTuple):
    """How a row's file was made, and of which picture."""

    codec: Sg
    aim: float
    picture: str
    megapixels: float | None  # of a middle or mosaic; None for the whole picture


def made(row: Row, bpp: float | None) -> Made | None:
    """How a row's file was made; None if another codec, a time limit or a search for a goal made it.

    bpp: of all rows, where they do not say it.
    """
    if "codec" in row:
        set_as = row["effort"], row["quality"] is not None
        ours = [Sg("rd", tune, *set_as) for tune in TUNES if row["effort"]]
        found = [Made(one, row["max_bpp"] or row["quality"], row["image"], None) for one in ours]
        return next((one for one in found if one.codec.name == row["codec"]), None)
    effort = re.fullmatch(r"(?:effort (\d))?", row["setting"])
    tune = TUNED.get(row["method"], "psnr" if row["method"] == OURS[0] else None)
    if bpp is None or effort is None or tune is None:
        return None
    codec = Sg("rd", tune, effort=int(effort[1] or DEFAULT_EFFORT))
    return Made(codec, bpp, row["picture"], row["megapixels"])


def pixels_of(one: Made, folder: Path) -> Pixels:
    """The picture [H, W, 3] that a file was made of."""
    if one.megapixels is None:
        return read_image_8_bit((folder / one.picture).read_bytes())
    every = pictures_in(folder)
    return sized(every, [path.stem for path in every].index(one.picture), one.megapixels)


def again(one: Made, folder: Path, row: Row) -> Row:
    """Make a row's file once more; return what it is, and whether that is what the row says."""
    pixels = pixels_of(one, folder)
    data = one.codec.best(pixels, one.aim).data
    db = psnr(decode(data), pixels)
    alike = len(data) == row["bytes"] and math.isclose(db, row["psnr"], rel_tol=0, abs_tol=SAME_DB)
    return {"alike": alike, "bytes": len(data), "psnr": db, "published": {"bytes": row["bytes"], "psnr": row["psnr"]}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("results", nargs="+", metavar="RESULT", help="such as rd/kodak")
    parser.add_argument("--images", type=Path, required=True, help="folder with the 24 pictures of Kodak")
    parser.add_argument("--photographs", type=Path, required=True, help="that benchmarks.perceptual.photographs fills")
    parser.add_argument("--most", type=int, default=24, help="rows of each")
    parser.add_argument("--out", type=Path, default=RUNS / "again.json")
    options = parser.parse_args()
    record = Record(options.out, "benchmarks.again", {})
    for name in options.results:
        published = json.loads((RESULTS / f"{name}.json").read_text())
        os.environ["SG_ISA"] = SG_ISA[published["machine"]["instruction_set"]]  # of the processes that alone() starts
        folder = re.search(r"--images (\S+)", published["command"])
        assert folder
        images = options.images if folder[1] == "KODAK" else options.photographs / folder[1].lower()
        how = partial(made, bpp=published["settings"].get("bpp"))
        every = [(one, row) for row in rows_of(published) if (one := how(row))]
        # Every second or twelfth row would all be of one codec or rate.
        for one, row in random.Random(0).sample(every, min(options.most, len(every))):
            key = {"result": name, "commit": published["commit"], "codec": one.codec.name, "picture": one.picture}
            key |= {"quality" if one.codec.one_quality else "bpp": one.aim}
            if not record.has(**key):
                record.add({**key, **alone(again, one, images, row)})
    for name in dict.fromkeys(row["result"] for row in record.rows):
        alike = [row["alike"] for row in record.rows if row["result"] == name]
        print(f"{name}: {sum(alike)} of {len(alike)} alike")


if __name__ == "__main__":
    main()
