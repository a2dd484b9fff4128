"""Sheets of enlarged parts of textured pictures, side by side.

    python -m benchmarks.perceptual.sheet --images KODAK [--bpp 0.25] [--out FILE]
    python -m benchmarks.perceptual.sheet --images KODAK --of source,visual,avif \\
        --parts kodim08:230:150,kodim15:390:150,kodim13:120:300 --out docs/crop.webp

Each part is shown at twice its size: the source, our file tuned for the eye, AVIF (libvips, speed 4, 4:4:4, tune=iq,
its default) and JPEG XL, or the columns of --of. AVIF's file is the largest within --bpp, and ours is no
larger; other files are at least as large as ours.
"""

from __future__ import annotations

import argparse
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.arguments import some_of
from benchmarks.machine import ROOT
from benchmarks.pictures import Pixels
from benchmarks.rd.baselines import AvifOf8BitsForEyes, Baseline, Jpeg, JpegXl
from sgmethod import decode, encode
from sgmethod.io.image import read_image_8_bit

# Of Kodak, by where they begin, x and y: roofs, hair, bark and foliage, cloth, wood, rigging, stone, grass, feathers.
PARTS = (
    "kodim01:60:250,kodim04:190:330,kodim05:430:120,kodim08:150:150,kodim13:60:380,"
    "kodim14:330:250,kodim15:230:110,kodim18:130:330,kodim19:180:560,kodim22:500:350"
)
BASELINES = {"avif": AvifOf8BitsForEyes, "jpegxl": JpegXl, "jpeg": Jpeg}
COLUMNS = ("source", "visual", *BASELINES)
LABELS = {"visual": "sgmethod", "avif": "AVIF", "jpegxl": "JPEG XL", "jpeg": "JPEG"}
WIDTH, HEIGHT, ZOOM = 150, 110, 2  # pixels of the picture
MARGIN = 30  # pixels of the sheet, for words

Column = tuple[str, Pixels]  # its label, and the whole picture


def columns(names: list[str], path: Path, bpp: float) -> Iterator[Column]:
    """The columns of one picture."""
    source = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
    avif = AvifOf8BitsForEyes().best(source, bpp).data
    ours = encode(source, bytes=len(avif), tune="visual").data
    for name in names:
        if name == "source":
            yield f"{path.stem}, source", source
            continue
        codec = BASELINES[name]() if name in BASELINES else None
        data = avif if name == "avif" else no_smaller(codec, source, len(ours)) if codec else ours
        yield f"{LABELS[name]}, {len(data):,} bytes", codec.decode(data) if codec else decode(data)


def no_smaller(codec: Baseline, source: Pixels, size: int) -> bytes:
    """The smallest file of at least that many bytes, or the largest there is."""
    qualities = codec.qualities
    first = bisect_left(range(len(qualities) - 1), size, key=lambda k: len(codec.encode(source, qualities[k])))
    return codec.encode(source, qualities[first])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, nargs="+", required=True, help="folders of the pictures, PNG")
    parser.add_argument("--parts", default=PARTS, help="NAME:X:Y of each, separated by commas")
    parser.add_argument("--of", type=some_of(COLUMNS, "column"), help=f"of {', '.join(COLUMNS)}")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "seen.webp")
    options = parser.parse_args()
    names = options.of or ["source", "visual", "avif", "jpegxl"]
    parts = [text.split(":") for text in options.parts.split(",")]
    paths = {path.stem: path for folder in options.images for path in folder.glob("*.png")}
    made = {name: [*columns(names, paths[name], options.bpp)] for name in {name for name, _, _ in parts}}
    sheet = Image.new("RGB", (len(names) * ZOOM * WIDTH, len(parts) * (ZOOM * HEIGHT + MARGIN)), "white")
    for row, (name, x, y) in enumerate(parts):
        for at, (label, pixels) in enumerate(made[name]):
            corner = at * ZOOM * WIDTH, row * (ZOOM * HEIGHT + MARGIN)
            ImageDraw.Draw(sheet).text((corner[0] + 4, corner[1] + 3), label, "black", ImageFont.load_default(20))
            part = Image.fromarray(np.ascontiguousarray(pixels[int(y) :, int(x) :][:HEIGHT, :WIDTH]))
            large = part.resize((ZOOM * WIDTH, ZOOM * HEIGHT), Image.Resampling.LANCZOS)
            sheet.paste(large, (corner[0], corner[1] + MARGIN))
    sheet.save(options.out, quality=80, method=6)


if __name__ == "__main__":
    main()
