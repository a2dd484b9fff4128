"""Make thumbnails with Pillow alone: python thumbnails.py PHOTOS THUMBNAILS

Importing sgmethod teaches Pillow the format, so code that saves WebP today needs little more than another suffix.
"""

import sys
from pathlib import Path

from PIL import Image, ImageOps

import sgmethod  # noqa: F401 (registers .sg with Pillow)

SUFFIXES = (".jpg", ".jpeg", ".png")


def make_thumbnails(photos: Path, thumbnails: Path) -> None:
    """Write a thumbnail of at most 320 x 320 pixels and 2,000 bytes of each photograph in a folder."""
    thumbnails.mkdir(exist_ok=True)
    for path in sorted(path for path in photos.iterdir() if path.suffix.lower() in SUFFIXES):
        with Image.open(path) as photo:
            small = ImageOps.exif_transpose(photo).convert("RGB")
        small.thumbnail((320, 320))
        target = thumbnails / f"{path.name}.sg"  # a.jpg may lie beside a.png
        small.save(target, bytes=2000)
        with Image.open(target) as made:
            print(f"{target.name}: {made.size[0]} x {made.size[1]}, {target.stat().st_size} bytes")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python thumbnails.py PHOTOS THUMBNAILS")
    make_thumbnails(Path(sys.argv[1]), Path(sys.argv[2]))
