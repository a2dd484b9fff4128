"""What the command line takes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from typing import NoReturn

from sgmethod.budget import BUDGET_KINDS, Budget, BudgetKind
from sgmethod.profiles import DEFAULT_PROFILE, PROFILE_NAMES
from sgmethod.view import MAX_SCALE, MIN_SCALE

Command = Callable[[argparse.Namespace], None]

BAD_INPUT = 2
DEFAULT_BUDGET = Budget("bpp", 0.3)
BUDGET_HELP: dict[BudgetKind, tuple[str, str]] = {
    "bpp": ("F", f"at most so many bits per pixel ({DEFAULT_BUDGET.value} if no budget is given)"),
    "bytes": ("N", "at most so many bytes"),
    "psnr": ("DB", "this quality in as few bytes as can be found"),
    "quality": ("Q", "a fineness, above 0 to 100, of profile rd alone"),
    "gaussians": ("N", "this number of Gaussians"),
}
MAX_SEED = 2**32 - 1


def one_line(message: str) -> str:
    """The message without its line breaks."""
    return " ".join(message.split())


class _Parser(argparse.ArgumentParser):
    """Wrong usage is one line on stderr, like every other error."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"sgmethod: {one_line(message)} (see: {self.prog} --help)\n")


def parser_of(encode: Command, decode: Command, info: Command) -> argparse.ArgumentParser:
    """The parser; what it returns has the command to carry out as `run`."""
    parser = _Parser(prog="sgmethod", description="Photographs as small sets of 2D Gaussians.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"sgmethod {version('sgmethod')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, run: Command, summary: str) -> argparse.ArgumentParser:
        found = commands.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        found.set_defaults(run=run)
        return found

    _add_encode_arguments(command("encode", encode, "Encode an image (PNG, JPEG, WebP, TIFF, BMP) as an .sg file."))
    _add_decode_arguments(command("decode", decode, "Decode an .sg file, or a view of it, to PNG."))
    fields = command("info", info, "Print the header fields of an .sg file and the bits spent on each part.")
    fields.add_argument("input", metavar="IN.sg")
    fields.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _add_encode_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", metavar="IN")
    parser.add_argument("output", metavar="OUT.sg")
    budget = parser.add_mutually_exclusive_group()
    for kind in BUDGET_KINDS:
        metavar, text = BUDGET_HELP[kind]
        # Whole numbers are read as floats too: Budget says what is wrong with 1.5 bytes.
        budget.add_argument(f"--{kind}", type=float, metavar=metavar, help=text)
    parser.add_argument(
        "--profile", choices=PROFILE_NAMES, default=DEFAULT_PROFILE, help=f"method (default: {DEFAULT_PROFILE})"
    )
    parser.add_argument("--time-limit", type=float, metavar="SECONDS", help="be done after so long")
    parser.add_argument("--server", metavar="URL", help="have a service encode it; its API key from SG_API_KEY")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="of everything random (default: 0)")
    parser.add_argument("--trace", metavar="FILE.json", help="write error against time of the fit")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress bar and no summary")


def _add_decode_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", metavar="IN.sg")
    parser.add_argument("output", metavar="OUT.png")
    scales = f"{MIN_SCALE} to {MAX_SCALE:g} (default: 1)"
    parser.add_argument("--scale", type=float, default=1.0, metavar="S", help=f"pixels drawn for a pixel, {scales}")
    parser.add_argument("--region", type=_region, metavar="X,Y,W,H", help="this part of the picture, in its own pixels")
    parser.add_argument(
        "--prefix", type=float, default=1.0, metavar="P", help="from this part of the file, of profile rd alone"
    )


def _region(text: str) -> tuple[int, int, int, int]:
    with suppress(ValueError):
        x, y, width, height = (int(number) for number in text.split(","))
        return x, y, width, height
    raise argparse.ArgumentTypeError(f"a region is four whole numbers X,Y,W,H, not {text!r}")


def _seed(text: str) -> int:
    with suppress(ValueError):
        if 0 <= int(text) <= MAX_SEED:
            return int(text)
    raise argparse.ArgumentTypeError(f"a seed is a whole number from 0 to {MAX_SEED}, not {text!r}")
