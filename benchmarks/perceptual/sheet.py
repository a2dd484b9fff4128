"""What figures do not tell: parts of textured pictures at twice their size, side by side, as one picture.

    python -m benchmarks.perceptual.sheet --images KODAK --other CHECKOUT [--bpp 0.25] [--out FILE]

For each part: the picture, a file of another checkout (one of version 3, with its own .venv), this one's tuned for the
eye, AVIF (imagecodecs, speed 4, 4:2:0, tune=iq, which is libavif's own) and JPEG XL, none with more bytes than ours.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from benchmarks.pictures import Pixels
from benchmarks.rd.rivals import Avif, JpegXl
from sgmethod import decode, encode
from sgmethod.io.image import read_image_8_bit
from tests.harness.data import ROOT

# Of Kodak, by where they begin, x and y: roofs, hair, bark and foliage, cloth, wood, rigging, stone, grass, feathers.
PARTS = (
    ("kodim01", 60, 250),
    ("kodim04", 190, 330),
    ("kodim05", 430, 120),
    ("kodim08", 150, 150),
    ("kodim13", 60, 380),
    ("kodim14", 330, 250),
    ("kodim15", 230, 110),
    ("kodim18", 130, 330),
    ("kodim19", 180, 560),
    ("kodim22", 500, 350),
)
WIDTH, HEIGHT, ZOOM = 150, 110, 2  # pixels of the picture
MARGIN = 22  # pixels of the sheet, for words


def parts(path: Path, bpp: float, other: Path) -> list[tuple[str, Pixels, int | None]]:
    """What made it, its pixels, and its bytes where there is a file."""
    source = np.ascontiguousarray(read_image_8_bit(path.read_bytes()))
    ours = encode(source, bpp=bpp, tune="visual").data
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before.sg"
        python = str(other.resolve() / ".venv" / "bin" / "python")
        command = [python, "-m", "sgmethod", "encode", str(path.resolve()), str(before), "--bpp", str(bpp), "--quiet"]
        subprocess.run(command, check=True, cwd=other)
        old = before.read_bytes()
    made = [("source", source, None), ("before", decode(old), len(old)), ("visual", decode(ours), len(ours))]
    for rival in (Avif(), JpegXl()):
        run = rival.run(source, 8 * len(ours) / (source.shape[0] * source.shape[1]))
        made.append((rival.name, run.decode(run.data), len(run.data)))
    return made


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, required=True, help="folder of the Kodak pictures")
    parser.add_argument("--other", type=Path, required=True, help="the other checkout")
    parser.add_argument("--bpp", type=float, default=0.25)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "seen.webp")
    options = parser.parse_args()
    font = ImageFont.load_default(13)
    sheet: Image.Image | None = None
    for row, (name, x, y) in enumerate(PARTS):
        made = parts(options.images / f"{name}.png", options.bpp, options.other)
        if sheet is None:
            size = (len(made) * ZOOM * WIDTH, len(PARTS) * (ZOOM * HEIGHT + MARGIN))
            sheet = Image.new("RGB", size, "white")
        draw = ImageDraw.Draw(sheet)
        for column, (what, pixels, size_in_bytes) in enumerate(made):
            at = column * ZOOM * WIDTH, row * (ZOOM * HEIGHT + MARGIN)
            label = f"{name}, {what}" if size_in_bytes is None else f"{what}, {size_in_bytes:,} bytes"
            draw.text((at[0] + 4, at[1] + 3), label, "black", font)
            part = Image.fromarray(np.ascontiguousarray(pixels[y : y + HEIGHT, x : x + WIDTH]))
            large = part.resize((ZOOM * WIDTH, ZOOM * HEIGHT), Image.Resampling.LANCZOS)
            sheet.paste(large, (at[0], at[1] + MARGIN))
    assert sheet is not None
    sheet.save(options.out, quality=80, method=6)


if __name__ == "__main__":
    main()
