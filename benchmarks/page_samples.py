"""Makes the page's samples again from their originals, NAME.webp: python -m benchmarks.page_samples

For each an .sg file, and an AVIF that is as large. Not needed unless another version is to be shown. The originals are
of skimage.data: coffee whole, as WebP of quality 90 and method 6; astronaut and cat (chelsea) cut and reduced.
"""

from __future__ import annotations

from PIL import Image

import sgmethod
from service.pictures import as_large
from tests.support.data import STATIC
from tests.support.pictures import saved

FOLDER = STATIC / "samples"
BPP = {"astronaut": 0.3, "cat": 0.35, "coffee": 0.3}
AVIF_SPEED = 4


def make(name: str, bpp: float) -> None:
    """Write both files of a sample."""
    with Image.open(FOLDER / f"{name}.webp") as file:
        picture = file.convert("RGB")
    encoded = sgmethod.encode(picture, bpp=bpp)
    encoded.save(FOLDER / f"{name}.sg")
    avif = as_large(lambda quality: saved(picture, "AVIF", quality=quality, speed=AVIF_SPEED), encoded.stats.bytes)
    (FOLDER / f"{name}.avif").write_bytes(avif)
    print(f"{name}: {encoded.stats.bytes:,} bytes, {encoded.stats.psnr:.2f} dB; AVIF {len(avif):,} bytes")


if __name__ == "__main__":
    for name, bpp in BPP.items():
        make(name, bpp)
