"""Makes the page's samples again from their originals, NAME.webp: python -m tests.harness.make_samples

For each an .sg file, and an AVIF of at most as many bytes. Not needed unless another version is to be shown.
"""

from __future__ import annotations

import io

from PIL import Image

import sgmethod
from tests.harness.data import ROOT

FOLDER = ROOT / "service" / "web" / "static" / "samples"
BPP = {"astronaut": 0.3, "cat": 0.35, "coffee": 0.3}
AVIF_SPEED = 4


def avif_within(picture: Image.Image, most_bytes: int) -> bytes:
    """The AVIF of the best quality that takes no more bytes."""
    for quality in range(90, 0, -1):
        file = io.BytesIO()
        picture.save(file, "AVIF", quality=quality, speed=AVIF_SPEED)
        if file.tell() <= most_bytes:
            return file.getvalue()
    raise ValueError(f"no AVIF takes at most {most_bytes} bytes")


def main() -> None:
    """The command."""
    for name, bpp in BPP.items():
        with Image.open(FOLDER / f"{name}.webp") as file:
            picture = file.convert("RGB")
        encoded = sgmethod.encode(picture, bpp=bpp)
        encoded.save(FOLDER / f"{name}.sg")
        avif = avif_within(picture, encoded.stats.bytes)
        (FOLDER / f"{name}.avif").write_bytes(avif)
        print(f"{name}: {encoded.stats.bytes:,} bytes, {encoded.stats.psnr:.2f} dB; AVIF {len(avif):,} bytes")


if __name__ == "__main__":
    main()
