"""What figures do not tell: parts of textured pictures, side by side.

    python -m benchmarks.perceptual.sheet --images KODAK [--bpp 0.25] [--out FILE]
    python -m benchmarks.perceptual.sheet --images KODAK --of source,visual,avif,jpeg \\
        --parts kodim08:230:150,kodim15:390:150,kodim13:120:300 --out docs/crop.webp
    python -m benchmarks.perceptual.sheet --images KODAK PHOTOGRAPHS/measured --blind 7 --bpp 0.2 --out BLIND

For each part, at twice its size: the picture, ours tuned for the eye, AVIF (imagecodecs, speed 4, 4:2:0, tune=iq,
libavif's default) and JPEG XL; or what --of names. AVIF's is the largest file within --bpp, and ours has no more bytes
than that; others have no fewer than ours.

--blind: for readers who are told neither what is whose nor what to look for. Of each part, twelve grainy ones if not
told, a sheet BLIND/NUMBER.png: the source, then ours and AVIF's, or what --of names, in an order that is drawn anew for
each; above as they are shown, below their middle at twice the size. Which is which goes into BLIND.txt.
"""

from __future__ import annotations

import argparse
import random
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.arguments import some_of
from benchmarks.harness.data import ROOT
from benchmarks.pictures import Pixels
from benchmarks.rd.baselines import Avif, Baseline, Jpeg, JpegXl
from sgmethod import decode, encode
from sgmethod.io.image import read_image_8_bit

# Of Kodak, by where they begin, x and y: roofs, hair, bark and foliage, cloth, wood, rigging, stone, grass, feathers.
PARTS = (
    "kodim01:60:250,kodim04:190:330,kodim05:430:120,kodim08:150:150,kodim13:60:380,"
    "kodim14:330:250,kodim15:230:110,kodim18:130:330,kodim19:180:560,kodim22:500:350"
)
# Water, lawn, foliage; then of benchmarks.perceptual.photographs trees, water, meadow, rock, moss, heath, lake, stone.
GRAINY = (
    "kodim13:60:380,kodim14:330:250,kodim19:180:560,kodim22:500:350,"
    "life_by_aitzol_berasategi:40:60,life_by_aitzol_berasategi:340:340,"
    "picosdeeuropa_by_aitzol_berasategi:500:300,picosdeeuropa_by_aitzol_berasategi:400:120,"
    "onestandsout:400:330,sunset_by_aitzol_berasategi:120:370,bythewater:400:110,picture_0b_by_freespace:20:400"
)
OF, BLIND = "source,visual,avif,jpegxl", "visual,avif"
LABELS = {"visual": "sgmethod", "avif": "AVIF", "jpegxl": "JPEG XL", "jpeg": "JPEG"}
BASELINES = {baseline.name: baseline for baseline in (Avif, JpegXl, Jpeg)}
COLUMNS = ("source", "visual", *BASELINES)
WIDTH, HEIGHT, ZOOM = 150, 110, 2  # pixels of the picture
MARGIN = 22  # pixels of the sheet, for words
SHOWN = 512, 384  # most pixels of the picture on a blind sheet, from a part's corner on
GAP = 6  # pixels between them

Column = tuple[str, str, Pixels]  # its name, what stands over it, and the whole picture
Part = tuple[str, int, int]  # a picture's name, and where the part begins


def made_by(wanted: list[str], path: Path, bpp: float) -> Iterator[Column]:
    """The columns that are wanted."""
    source = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
    avif = Avif().run(source, bpp)
    ours = encode(source, bytes=len(avif.data), tune="visual").data
    for name in wanted:
        if name == "source":
            yield name, f"{path.stem}, source", source
            continue
        if name == "visual":
            data, pixels = ours, decode(ours)
        elif name == "avif":
            data, pixels = avif.data, avif.decode(avif.data)
        else:
            baseline = BASELINES[name]()
            data = no_fewer(baseline, source, len(ours))
            pixels = baseline.decode(data)
        yield name, f"{LABELS[name]}, {len(data):,} bytes", pixels


def no_fewer(baseline: Baseline, source: Pixels, least: int) -> bytes:
    """The smallest file of at least that many bytes, or the largest there is."""
    qualities = baseline.qualities
    first = bisect_left(range(len(qualities) - 1), least, key=lambda k: len(baseline.encode(source, qualities[k])))
    return baseline.encode(source, qualities[first])


def hidden(columns: list[Column], order: random.Random) -> list[Column]:
    """The source, then the others under letters."""
    others = [column for column in columns if column[0] != "source"]
    order.shuffle(others)
    named = [(name, letter, pixels) for (name, _, pixels), letter in zip(others, "ABCD", strict=False)]
    return [*(column for column in columns if column[0] == "source"), *named]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, nargs="+", required=True, help="folders of the pictures, PNG")
    parser.add_argument("--parts", help="NAME:X:Y of each, separated by commas")
    parser.add_argument("--of", type=some_of(COLUMNS, "column"), help=f"of {', '.join(COLUMNS)}")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--blind", type=int, metavar="SEED", help="of the order in which names are hidden")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "seen.webp")
    options = parser.parse_args()
    is_blind = options.blind is not None
    wanted = options.of or (f"source,{BLIND}" if is_blind else OF).split(",")
    parts = [part_of(text) for text in (options.parts or (GRAINY if is_blind else PARTS)).split(",")]
    paths = {path.stem: path for folder in options.images for path in folder.glob("*.png")}
    names = {name for name, _, _ in parts}
    made = {name: [*made_by(wanted, paths[name], options.bpp)] for name in names}
    if is_blind:
        write_blind(parts, made, options.blind, options.out)
    else:
        named_sheet(parts, made).save(options.out, quality=80, method=6)


def part_of(text: str) -> Part:
    """Read NAME:X:Y."""
    name, x, y = text.split(":")
    return name, int(x), int(y)


def named_sheet(parts: Sequence[Part], made: Mapping[str, list[Column]]) -> Image.Image:
    """A row for each part, at twice its size."""
    width = max(len(columns) for columns in made.values()) * ZOOM * WIDTH
    sheet = Image.new("RGB", (width, len(parts) * (ZOOM * HEIGHT + MARGIN)), "white")
    for row, (name, x, y) in enumerate(parts):
        for at, (_, label, pixels) in enumerate(made[name]):
            place(sheet, (at * ZOOM * WIDTH, row * (ZOOM * HEIGHT + MARGIN)), label, pixels[y:, x:], (WIDTH, HEIGHT))
    return sheet


def write_blind(parts: Sequence[Part], made: Mapping[str, list[Column]], seed: int, folder: Path) -> None:
    """A sheet for each part, and the key."""
    order, key = random.Random(seed), []
    folder.mkdir(parents=True, exist_ok=True)
    for number, (name, x, y) in enumerate(parts, 1):
        columns = hidden(made[name], order)
        key.append(f"{number:02} {name}: {', '.join(f'{label} {of}' for of, label, _ in columns if of != 'source')}")
        blind_sheet(columns, x, y).save(folder / f"{number:02}.png")
    folder.with_suffix(".txt").write_text("\n".join(key) + "\n")


def blind_sheet(columns: Sequence[Column], x: int, y: int) -> Image.Image:
    """What lies from a corner on in each column as it is shown, and the middle of that at twice the size."""
    height, width = columns[0][2].shape[:2]
    wide, high = min(SHOWN[0], width), min(SHOWN[1], height)
    left, top = max(min(x, width - wide), 0), max(min(y, height - high), 0)
    sheet = Image.new("RGB", (len(columns) * (wide + GAP), 2 * (high + MARGIN)), "white")
    for at, (name, label, pixels) in enumerate(columns):
        shown, size = pixels[top : top + high, left : left + wide], (wide // ZOOM, high // ZOOM)
        middle = shown[(high - size[1]) // 2 :, (wide - size[0]) // 2 :]
        label = name if name == "source" else label
        place(sheet, (at * (wide + GAP), 0), label, shown, (wide, high), zoom=1)
        place(sheet, (at * (wide + GAP), high + MARGIN), "", middle, size)
    return sheet


def place(
    sheet: Image.Image, corner: tuple[int, int], label: str, pixels: Pixels, size: tuple[int, int], zoom: int = ZOOM
) -> None:
    """The upper left part of a picture, (width, height), enlarged under its label."""
    (x, y), (width, height) = corner, size
    ImageDraw.Draw(sheet).text((x + 4, y + 3), label, "black", ImageFont.load_default(13))
    part = Image.fromarray(np.ascontiguousarray(pixels[:height, :width]))
    sheet.paste(part.resize((zoom * width, zoom * height), Image.Resampling.LANCZOS), (x, y + MARGIN))


if __name__ == "__main__":
    main()
