"""Makes the page's wall of previews again from its photographs: python -m benchmarks.page_wall

Needs Node and npm. Each photograph gets previews of a few sizes, and placeholders of at most as many characters: WebP,
reduced first to the size that is best for its PSNR; ThumbHash; BlurHash with as many components as fit. The last two
are drawn by their own decoders.
"""

from __future__ import annotations

import base64
import json
import subprocess
import tempfile
from bisect import bisect_right
from pathlib import Path

import numpy as np
from PIL import Image

from sgmethod.previews.preview import preview
from tests.support.data import STATIC
from tests.support.pictures import pixels_of, saved

PHOTOGRAPHS = {
    "samples/astronaut.webp": "An astronaut",
    "wall/parrots.webp": "Two parrots",
    "samples/cat.webp": "A cat",
    "wall/hats.webp": "Hats on a wall",
    "wall/lighthouse.webp": "A lighthouse",
    "samples/coffee.webp": "A cup of coffee",
    "wall/girl.webp": "A girl with a painted face",
    "wall/bikes.webp": "Motorcycles",
    "wall/plane.webp": "A propeller plane",
}
BYTES = (100, 200, 500)
SHRINKS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
HASH_WIDTH = 96  # pixels in which hashes are made; 100 are the most that ThumbHash takes
DRAWN_WIDTH = 32
PACKAGES = ("blurhash@^2.0.5", "thumbhash@^0.1.1")
HASHES = """
import { encode, decode } from "blurhash";
import { rgbaToThumbHash, thumbHashToRGBA } from "thumbhash";
import { readFileSync } from "node:fs";
const { width, height, rgba, drawn, characters } = JSON.parse(readFileSync(0, "utf8"));
const pixels = new Uint8ClampedArray(Buffer.from(rgba, "base64"));
const found = {};
const thumb = rgbaToThumbHash(width, height, pixels);
const own = thumbHashToRGBA(thumb);
const text = Buffer.from(thumb).toString("base64").replaceAll("=", "");
found.thumbhash = [text.length, own.w, own.h, Buffer.from(own.rgba).toString("base64")];
found.blurhash = characters.map((maxCharacters) => {
  let best = [4, 3];
  for (let x = 1; x <= 9; x++) for (let y = 1; y <= 9; y++)
    if (4 + 2 * x * y <= maxCharacters && x >= y && x * y > best[0] * best[1]) best = [x, y];
  const text = encode(pixels, width, height, ...best);
  return [text.length, ...drawn, Buffer.from(decode(text, ...drawn)).toString("base64")];
});
console.log(JSON.stringify(found));
"""


def webp(picture: Image.Image, max_bytes: int) -> str | None:
    """The file of at most so many bytes that is nearest to the picture when enlarged bicubically, as base64."""
    best: tuple[float, bytes] | None = None
    source = np.asarray(picture, np.float64)
    for shrink in SHRINKS:
        small = picture.resize((picture.width // shrink, picture.height // shrink), Image.Resampling.BOX)
        files = [saved(small, "WEBP", quality=quality, method=6) for quality in range(101)]
        if fitting := bisect_right(files, max_bytes, key=len):
            found = files[fitting - 1]
            drawn = Image.fromarray(pixels_of(found)).resize(picture.size, Image.Resampling.BICUBIC)
            error = float(((np.asarray(drawn, np.float64) - source) ** 2).mean())
            if best is None or error < best[0]:
                best = error, found
    return base64.b64encode(best[1]).decode() if best else None


def drawn(found: tuple[int, int, int, str]) -> dict[str, object]:
    """A hash: its characters, and what its decoder makes of it, as a lossless WebP."""
    characters, width, height, rgba = found
    pixels = np.frombuffer(base64.b64decode(rgba), np.uint8).reshape(height, width, 4)
    file = saved(Image.fromarray(pixels[..., :3]), "WEBP", lossless=True, method=6)
    return {"characters": characters, "webp": base64.b64encode(file).decode()}


def hashes(picture: Image.Image, characters: list[int], folder: Path) -> dict[str, object]:
    """The ThumbHash, and a BlurHash for each number of characters."""
    small = picture.resize((HASH_WIDTH, HASH_WIDTH * picture.height // picture.width), Image.Resampling.BOX)
    rgba = base64.b64encode(small.convert("RGBA").tobytes()).decode()
    size = DRAWN_WIDTH, DRAWN_WIDTH * picture.height // picture.width
    asked = {"width": small.width, "height": small.height, "rgba": rgba, "drawn": size, "characters": characters}
    command = ["node", "--input-type=module", "--eval", HASHES]
    done = subprocess.run(command, cwd=folder, input=json.dumps(asked), capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    return {"thumbhash": drawn(found["thumbhash"]), "blurhash": [drawn(one) for one in found["blurhash"]]}


def main() -> None:
    """The command."""
    wall = []
    with tempfile.TemporaryDirectory() as name:
        subprocess.run(["npm", "install", "--silent", *PACKAGES], cwd=name, check=True)
        for path, alt in PHOTOGRAPHS.items():
            with Image.open(STATIC / path) as file:
                picture = file.convert("RGB")
            texts = [preview(picture, max_bytes).text for max_bytes in BYTES]
            placeholders = hashes(picture, [len(text) for text in texts], Path(name))
            files = [webp(picture, max_bytes) for max_bytes in BYTES]
            wall.append({"src": path, "alt": alt, "previews": texts, "webp": files, **placeholders})
    (STATIC / "wall" / "wall.json").write_text(json.dumps({"bytes": BYTES, "pictures": wall}, separators=(",", ":")))


if __name__ == "__main__":
    main()
