"""What figures do not tell: parts of textured pictures at twice their size, side by side, as one picture.

    python -m benchmarks.perceptual.sheet --images KODAK [--bpp 0.25] [--out FILE]
    python -m benchmarks.perceptual.sheet --images KODAK --of source,visual,avif,jpeg \\
        --parts kodim08:230:150,kodim15:390:150,kodim13:120:300 --out docs/crop.webp

For each part: the picture, ours tuned for the eye, AVIF (imagecodecs, speed 4, 4:2:0, tune=iq, which is libavif's own)
and JPEG XL; or what --of names. AVIF's is the largest file within --bpp, and ours has no more bytes than that; others
have no fewer than ours.
"""

from __future__ import annotations

import argparse
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.arguments import some_of
from benchmarks.pictures import Pixels
from benchmarks.rd.rivals import Avif, Jpeg, JpegXl, Rival
from sgmethod import decode, encode
from sgmethod.io.image import read_image_8_bit
from tests.harness.data import ROOT

# Of Kodak, by where they begin, x and y: roofs, hair, bark and foliage, cloth, wood, rigging, stone, grass, feathers.
PARTS = (
    "kodim01:60:250,kodim04:190:330,kodim05:430:120,kodim08:150:150,kodim13:60:380,"
    "kodim14:330:250,kodim15:230:110,kodim18:130:330,kodim19:180:560,kodim22:500:350"
)
OF = "source,visual,avif,jpegxl"
LABELS = {"visual": "sgmethod", "avif": "AVIF", "jpegxl": "JPEG XL", "jpeg": "JPEG"}
RIVALS = {rival.name: rival for rival in (Avif, JpegXl, Jpeg)}
COLUMNS = ("source", "visual", *RIVALS)
WIDTH, HEIGHT, ZOOM = 150, 110, 2  # pixels of the picture
MARGIN = 22  # pixels of the sheet, for words


def made_by(wanted: list[str], path: Path, bpp: float) -> Iterator[tuple[str, Pixels]]:
    """For each that is wanted, its label and its pixels."""
    source = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
    avif = Avif().run(source, bpp)
    ours = encode(source, bytes=len(avif.data), tune="visual").data
    for name in wanted:
        if name == "source":
            yield f"{path.stem}, source", source
            continue
        if name == "visual":
            data, pixels = ours, decode(ours)
        elif name == "avif":
            data, pixels = avif.data, avif.decode(avif.data)
        else:
            rival = RIVALS[name]()
            data = no_fewer(rival, source, len(ours))
            pixels = rival.decode(data)
        yield f"{LABELS.get(name, name)}, {len(data):,} bytes", pixels


def no_fewer(rival: Rival, source: Pixels, least: int) -> bytes:
    """Its smallest file of at least that many bytes, or its largest."""
    qualities = rival.qualities
    first = bisect_left(range(len(qualities) - 1), least, key=lambda k: len(rival.encode(source, qualities[k])))
    return rival.encode(source, qualities[first])


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="folder of the Kodak pictures")
    parser.add_argument("--parts", default=PARTS, help="NAME:X:Y of each, separated by commas")
    parser.add_argument("--of", type=some_of(COLUMNS, "column"), default=OF, help=f"of {', '.join(COLUMNS)}")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "seen.webp")
    options = parser.parse_args()
    chosen = [part.split(":") for part in options.parts.split(",")]
    sheet = Image.new("RGB", (len(options.of) * ZOOM * WIDTH, len(chosen) * (ZOOM * HEIGHT + MARGIN)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(13)
    for row, (name, *corner) in enumerate(chosen):
        x, y = map(int, corner)
        path = options.images / f"{name}.png"
        for column, (label, pixels) in enumerate(made_by(options.of, path, options.bpp)):
            at = column * ZOOM * WIDTH, row * (ZOOM * HEIGHT + MARGIN)
            draw.text((at[0] + 4, at[1] + 3), label, "black", font)
            part = Image.fromarray(np.ascontiguousarray(pixels[y : y + HEIGHT, x : x + WIDTH]))
            large = part.resize((ZOOM * WIDTH, ZOOM * HEIGHT), Image.Resampling.LANCZOS)
            sheet.paste(large, (at[0], at[1] + MARGIN))
    sheet.save(options.out, quality=80, method=6)


if __name__ == "__main__":
    main()
