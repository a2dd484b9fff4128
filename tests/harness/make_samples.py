"""Makes the page's samples again from their originals, NAME.webp: python -m tests.harness.make_samples

For each an .sg file, and an AVIF that is as large. Not needed unless another version is to be shown.
"""

from __future__ import annotations

import io
from functools import partial

from PIL import Image

import sgmethod
from service.sandbox.picture_files import as_large
from tests.harness.data import ROOT

FOLDER = ROOT / "service" / "page" / "samples"
BPP = {"astronaut": 0.3, "cat": 0.35, "coffee": 0.3}
AVIF_SPEED = 4


def avif(picture: Image.Image, quality: int) -> bytes:
    """The file of that quality."""
    file = io.BytesIO()
    picture.save(file, "AVIF", quality=quality, speed=AVIF_SPEED)
    return file.getvalue()


def main() -> None:
    """The command."""
    for name, bpp in BPP.items():
        with Image.open(FOLDER / f"{name}.webp") as file:
            picture = file.convert("RGB")
        encoded = sgmethod.encode(picture, bpp=bpp)
        encoded.save(FOLDER / f"{name}.sg")
        rival = as_large(partial(avif, picture), encoded.stats.bytes)
        (FOLDER / f"{name}.avif").write_bytes(rival)
        print(f"{name}: {encoded.stats.bytes:,} bytes, {encoded.stats.psnr:.2f} dB; AVIF {len(rival):,} bytes")


if __name__ == "__main__":
    main()
