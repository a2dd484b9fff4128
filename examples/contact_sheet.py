"""Draw a folder of photographs as one sheet: python contact_sheet.py PHOTOS SHEET.png

Each photograph becomes an .sg file of at most 6 kB in the folder SHEET, and the sheet is drawn from these files alone.
When you run it again with more photographs, only the new ones are encoded.
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageOps

import sgmethod

CELL, GAP, COLUMNS = 240, 12, 4  # pixels, pixels, cells


def contact_sheet(photos: Path, sheet: Path) -> None:
    """Encode every photograph of a folder, and write a picture of them all."""
    files = sheet.with_suffix("")
    sgmethod.encode_many(sorted(photos.iterdir()), files, bytes=6000, resume=True, on_row=report)
    names = sorted(files.glob("*.sg"))
    rows = -(-len(names) // COLUMNS)
    page = Image.new("RGB", (GAP + COLUMNS * (CELL + GAP), GAP + rows * (CELL + 3 * GAP)), "white")
    draw = ImageDraw.Draw(page)
    for place, name in enumerate(names):
        row, column = divmod(place, COLUMNS)
        x, y = GAP + column * (CELL + GAP), GAP + row * (CELL + 3 * GAP)
        photo = sgmethod.open(name)
        thumbnail = Image.fromarray(photo.pixels(width=CELL, height=CELL))  # as large as fits
        page.paste(ImageOps.pad(thumbnail.convert("RGB"), (CELL, CELL), color="white", centering=(0.5, 1)), (x, y))
        draw.text((x, y + CELL + 2), f"{name.stem}, {name.stat().st_size:,} bytes", fill="black")
    page.save(sheet)


def report(row, tally) -> None:
    print(row.name, row.error or f"{row.bytes:,} bytes")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python contact_sheet.py PHOTOS SHEET.png")
    contact_sheet(Path(sys.argv[1]), Path(sys.argv[2]))
