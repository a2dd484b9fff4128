"""Makes the documents' pictures of previews from the page's wall: python -m benchmarks.page_previews [--out FOLDER]

previews.webp shows photographs and placeholders of at most 200 bytes each, busy.webp the last photograph at more bytes.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

from benchmarks.machine import ROOT
from sgmethod import decode, preview
from tests.support.data import STATIC

SHOWN = ("An astronaut", "Two parrots", "Motorcycles")
MORE_BYTES = (200, 500, 1000)
WIDTH, HEIGHT, GAP, LINE = 190, 127, 13, 38  # pixels; LINE: of the words below a tile

Tile = tuple[str, Image.Image]  # its words, and its picture


def opened(file: str) -> Image.Image:
    """The picture of a file in base64."""
    return Image.open(io.BytesIO(base64.b64decode(file)))


def drawn(photograph: Image.Image, size: int) -> Image.Image:
    """A photograph's preview of so many bytes, as wide as a tile."""
    return Image.fromarray(decode(preview(photograph, bytes=size).data, width=WIDTH))


def rows_of(pictures: list[dict[str, Any]], at: int) -> dict[str, list[list[Tile]]]:
    """The rows of both sheets from pictures of the wall; at: the place of the size among the wall's."""
    beside_others, more_bytes = [], []
    for one in pictures:
        with Image.open(STATIC / one["src"]) as file:
            photograph = file.convert("RGB")
        others = ("WebP", opened(one["webp"][at])), ("BlurHash", opened(one["blurhash"][at]["webp"]))
        beside_others.append([("photograph", photograph), ("sgmethod", drawn(photograph, MORE_BYTES[0])), *others])
        sizes = [(f"{size:,} bytes", drawn(photograph, size)) for size in MORE_BYTES]
        more_bytes.append([("photograph", photograph), *sizes])
    return {"previews": beside_others, "busy": more_bytes[-1:]}


def sheet(rows: list[list[Tile]]) -> Image.Image:
    """Rows of tiles, each with its words below."""
    tall = HEIGHT + LINE + GAP
    columns = len(rows[0])
    made = Image.new("RGB", (columns * (WIDTH + GAP) - GAP, len(rows) * tall - GAP), "white")
    for row, tiles in enumerate(rows):
        for column, (words, picture) in enumerate(tiles):
            x, y = column * (WIDTH + GAP), row * tall
            made.paste(picture.convert("RGB").resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC), (x, y))
            ImageDraw.Draw(made).text((x, y + HEIGHT + 6), words, "black", ImageFont.load_default(22))
    return made


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "page", help="folder of the pictures")
    out = parser.parse_args().out
    wall = json.loads((STATIC / "wall" / "wall.json").read_text())
    shown = [next(one for one in wall["pictures"] if one["alt"] == alt) for alt in SHOWN]
    at = wall["bytes"].index(MORE_BYTES[0])
    for name, rows in rows_of(shown, at).items():
        sheet(rows).save(out / f"{name}.webp", quality=80, method=6)


if __name__ == "__main__":
    main()
