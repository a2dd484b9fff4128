"""The command decode: .sg files to pictures, without importing PyTorch."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace

from sgmethod.cli import naming, paths
from sgmethod.cli.naming import Conversion
from sgmethod.cli.paths import CommandError
from sgmethod.cli.several import convert_all, convert_one
from sgmethod.decoder import SgFile
from sgmethod.io.formats import WRITTEN
from sgmethod.io.pictures import SUFFIXES, picture_file
from sgmethod.view import View


def run_decode(arguments: argparse.Namespace) -> int:
    """Run sgmethod decode."""
    if arguments.scale is not None and (arguments.width, arguments.height) != (None, None):
        raise CommandError("--scale cannot be combined with --width or --height")
    _view(arguments)  # fail once, not for each picture
    conversions = naming.decodes(arguments)
    paths.check_outputs([one.input for one in conversions], [one.target for one in conversions])
    if arguments.output_dir is not None:
        return convert_all(conversions, _decode, "decoded", arguments)
    (conversion,) = conversions
    naming.kind_of(conversion.target, SUFFIXES, "PNG")  # fail before the work
    return convert_one(conversion, _decode, arguments)


def _decode(conversion: Conversion, arguments: argparse.Namespace) -> Conversion:
    file = SgFile(paths.read(conversion.input))
    sides = {"width": arguments.width, "height": arguments.height}
    pixels = file.pixels(**asdict(_view(arguments)), **sides)
    kind = naming.kind_of(conversion.target, SUFFIXES, "PNG")
    notes = []
    if pixels.shape[2] == 4 and not WRITTEN[kind].has_alpha:
        notes.append(f"{kind} has no alpha channel: transparency is composited over white")
    data = picture_file(pixels, kind)
    paths.write(conversion.target, data)
    height, width = pixels.shape[:2]
    summary = f"{width} x {height} pixels, {kind}, {len(data):,} bytes"
    return replace(conversion, bytes=len(data), summary=summary, notes=notes)


def _view(arguments: argparse.Namespace) -> View:
    """View for the arguments, apart from --width and --height. Raises ViewError."""
    scale = 1.0 if arguments.scale is None else arguments.scale
    return View(scale, arguments.region, arguments.prefix, not arguments.no_texture)
