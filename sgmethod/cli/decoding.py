"""The command decode: .sg files to pictures, without importing PyTorch."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

from sgmethod.cli import files, naming
from sgmethod.cli.files import STREAM, CommandError
from sgmethod.cli.naming import Conversion
from sgmethod.cli.several import Outcome, convert_all, say_done, say_notes, without_existing
from sgmethod.decoder import SgFile
from sgmethod.io.pictures import OPAQUE, SUFFIXES, encode_picture
from sgmethod.view import View


def run_decode(arguments: argparse.Namespace) -> int:
    """Run sgmethod decode."""
    if arguments.scale is not None and (arguments.width, arguments.height) != (None, None):
        raise CommandError("--scale cannot be combined with --width or --height")
    _view(arguments)  # fail once, not for each picture
    conversions = naming.decodes(arguments)
    files.check_outputs([one.source for one in conversions], [one.target for one in conversions])
    if arguments.output_dir is not None:
        return convert_all(conversions, _decode, "decoded", arguments)
    (conversion,) = conversions
    _kind(conversion.target)
    out = sys.stderr if conversion.target == STREAM else sys.stdout
    for wanted in without_existing(conversions, arguments, out):
        outcome = _decode(wanted, arguments)
        say_notes(outcome, arguments)
        if not arguments.quiet:
            say_done(outcome, out)
    return 0


def _decode(conversion: Conversion, arguments: argparse.Namespace) -> Outcome:
    file = SgFile(files.read(conversion.source))
    sides = {"width": arguments.width, "height": arguments.height}
    pixels = file.pixels(**asdict(_view(arguments)), **sides)
    kind = _kind(conversion.target)
    notes = []
    if pixels.shape[2] == 4 and kind in OPAQUE:
        notes.append(f"{kind} has no alpha channel: transparency is composited over white")
    data = encode_picture(pixels, kind)
    files.write(conversion.target, data)
    height, width = pixels.shape[:2]
    summary = f"{width} x {height} pixels, {kind}, {len(data):,} bytes"
    return Outcome.from_conversion(conversion, bytes=len(data), summary=summary, notes=notes)


def _kind(target: str) -> str:
    """Format for a file name. Raises CommandError for an unknown extension."""
    kind = "PNG" if files.is_device(target) else SUFFIXES.get(Path(target).suffix.lower())
    if kind is None:
        raise CommandError(f"cannot write {target}: its name must end in one of {', '.join(SUFFIXES)}")
    return kind


def _view(arguments: argparse.Namespace) -> View:
    """View for the arguments, apart from --width and --height. Raises ViewError."""
    scale = 1.0 if arguments.scale is None else arguments.scale
    return View(scale, arguments.region, arguments.prefix, not arguments.no_texture)
