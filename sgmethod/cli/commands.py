"""The commands info and compare, without importing PyTorch."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from sgmethod.cli import paths
from sgmethod.cli.paths import CommandError
from sgmethod.decoder import decode, info
from sgmethod.io.compositing import WHITE, composited

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def run_info(arguments: argparse.Namespace) -> int:
    """Run sgmethod info."""
    data = paths.read(arguments.input)
    with paths.contents_of(arguments.input):
        fields = info(data).to_dict()
    if arguments.json:
        print(json.dumps(fields, allow_nan=False))
    else:
        for label, text in _lines(fields):
            print(f"{label:<16}{text}")
    return 0


def _lines(fields: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield labels and texts: the main facts, then other fields that fit on a line.

    Only the JSON has what concerns the coding alone.
    """
    main = {"width", "height", "bytes", "bpp", "version", "checksum", "profile", "gaussians", "bits"}
    main |= {"quantum", "upright", "short"}
    bits = fields["bits"]
    whole = sum(bits.values())
    yield "picture", f"{fields['width']} x {fields['height']} pixels"
    yield "file", f"{fields['bytes']:,} bytes, {fields['bpp']:.4f} bits per pixel"
    yield "format", f"version {fields['version']}, profile {fields['profile']}, checksum {fields['checksum']}"
    yield "Gaussians", f"{fields['gaussians']:,}"
    yield "bits", ", ".join(f"{name} {part:,} ({part / whole:.1%})" for name, part in bits.items())
    for name, value in fields.items():
        if name in main or isinstance(value, dict):
            continue
        if isinstance(value, list):
            if all(isinstance(item, int | float) for item in value):
                yield name.replace("_", " "), " ".join(f"{item:.7g}" for item in value)
        elif isinstance(value, bool):
            yield name.replace("_", " "), "yes" if value else "no"
        else:
            yield name.replace("_", " "), f"{value:.4f}" if isinstance(value, float) else str(value)


def run_compare(arguments: argparse.Namespace) -> int:
    """Run sgmethod compare."""
    from sgmethod.metrics import psnr, ssimulacra2
    from sgmethod.metrics.visual import SMALLEST_SIDE

    first, second = _picture(arguments.first), _picture(arguments.second)
    sizes = [f"{pixels.shape[1]} x {pixels.shape[0]}" for pixels in (first, second)]
    if sizes[0] != sizes[1]:
        raise CommandError(f"the pictures differ in size: {sizes[0]} and {sizes[1]} pixels")
    db = psnr(first, second)
    score = ssimulacra2(second, first)
    if arguments.json:
        print(json.dumps({"psnr": None if db == float("inf") else db, "ssimulacra2": score}, allow_nan=False))
        return 0
    print(f"PSNR            {'no error' if db == float('inf') else f'{db:.2f} dB'}")
    undefined = f"undefined for sides below {SMALLEST_SIDE} pixels"
    print(f"SSIMULACRA 2    {undefined if score is None else f'{score:.4g}'}")
    return 0


def _picture(path: str) -> NDArray[np.uint8]:
    """Read the pixels of an image file or an .sg file."""
    from sgmethod.bitstream.stream import MAGICS

    data = paths.read(path)
    with paths.contents_of(path):
        if not data.startswith(MAGICS):
            pixels, notes = paths.read_pixels(data)
        elif (pixels := decode(data)).shape[2] == 3:
            notes = []
        else:
            pixels, notes = composited(pixels, WHITE), ["transparency is composited over white"]
    paths.print_lines("note", path, notes)
    return pixels
