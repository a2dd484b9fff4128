"""What the command line takes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NoReturn

BAD_INPUT = 2
BUDGET_HELP = {
    "bpp": ("F", "at most so many bits per pixel ({default} if no budget is given)"),
    "bytes": ("N", "at most so many bytes"),
    "psnr": ("DB", "this quality in as few bytes as can be found"),
    "quality": ("Q", "a fineness, above 0 to 100, of profile rd alone"),
    "gaussians": ("N", "this number of Gaussians"),
}
MAX_SEED = 2**32 - 1
MAX_JOBS = 256

EXAMPLES = """examples:
  sgmethod encode photo.jpg                        writes photo.sg
  sgmethod decode photo.sg photo.png
  sgmethod compare photo.jpg photo.sg
each command has examples of its own: sgmethod encode --help"""
ENCODE = (
    "Encode pictures as .sg files.",
    """PNG, JPEG, WebP, AVIF, TIFF, BMP, GIF, PPM, QOI, and with their packages HEIC and JPEG XL are read, and converted
to sRGB.

examples:
  sgmethod encode photo.jpg                        writes photo.sg, of at most 0.3 bits per pixel
  sgmethod encode photo.jpg small.sg --bytes 20000
  sgmethod encode - - --psnr 35 <photo.jpg >photo.sg
  sgmethod encode *.jpg --output-dir out --jobs 4  writes out/NAME.sg for each""",
)
DECODE = (
    "Decode an .sg file, or a view of it.",
    """The suffix of OUT decides the format: .png, .jpg, .webp, .avif or .ppm.

examples:
  sgmethod decode photo.sg photo.png
  sgmethod decode photo.sg small.jpg --scale 0.25
  sgmethod decode photo.sg part.png --region 100,50,320,240 --scale 2
  sgmethod decode - - <photo.sg >photo.png""",
)
INFO = (
    "Print what an .sg file says of itself, and the bits spent on each part.",
    """examples:
  sgmethod info photo.sg
  sgmethod info photo.sg --json""",
)
COMPARE = (
    "Print how close two pictures are, or a picture and an .sg file.",
    """PSNR, MS-SSIM and SSIMULACRA 2 are higher for closer pictures, LPIPS and DISTS lower. What cannot be
measured says why. A is the one that B is compared with.

examples:
  sgmethod compare photo.jpg photo.sg
  sgmethod compare photo.jpg photo.sg --weights DIR
  sgmethod compare a.png b.png --json""",
)
PLOT = (
    "Draw the trace of an encode: error against time.",
    """The suffix of OUT decides the format: .svg, .png or .pdf. It takes matplotlib: pip install 'sgmethod[plot]'.

examples:
  sgmethod encode photo.jpg --trace fit.json
  sgmethod plot fit.json fit.svg""",
)


def one_line(message: str) -> str:
    """The message without its line breaks."""
    return " ".join(message.split())


class _Parser(argparse.ArgumentParser):
    """Wrong usage is one line on stderr, like every other error."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        named |= {"allow_abbrev": False, "formatter_class": argparse.RawDescriptionHelpFormatter}
        super().__init__(*arguments, **named)

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"sgmethod: {one_line(message)} (see: {self.prog} --help)\n")


class _Version(argparse.Action):
    """The version, looked for when it is asked for: that takes longer than all of the parser."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"sgmethod {version('sgmethod')}")
        parser.exit()


def parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """What it returns has the name of the command to carry out as `run`.

    Commands that argv does not name have no arguments: those of encode import every profile, and a decode has no use
    for them.
    """
    whole = _Parser(prog="sgmethod", description="Photographs as small sets of 2D Gaussians.", epilog=EXAMPLES)
    whole.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = whole.add_subparsers(metavar="COMMAND", required=True)

    for name, (texts, add) in {
        "encode": (ENCODE, _add_encode_arguments),
        "decode": (DECODE, _add_decode_arguments),
        "info": (INFO, _add_info_arguments),
        "compare": (COMPARE, _add_compare_arguments),
        "plot": (PLOT, _add_plot_arguments),
    }.items():
        command = commands.add_parser(name, help=texts[0], description=texts[0], epilog=texts[1])
        command.set_defaults(run=name)
        if name in argv:
            add(command)
    return whole


def _add_encode_arguments(parser: argparse.ArgumentParser) -> None:
    from sgmethod.budget import BUDGET_KINDS, DEFAULT_BUDGET
    from sgmethod.profiles import DEFAULT_EFFORT, DEFAULT_PROFILE, DEFAULT_TUNE, EFFORTS, PROFILE_NAMES, TUNES

    parser.add_argument(
        "names", nargs="+", metavar="IN [OUT.sg]", help="- for standard input and output; OUT.sg is IN's name otherwise"
    )
    budget = parser.add_mutually_exclusive_group()
    for kind in BUDGET_KINDS:
        metavar, text = BUDGET_HELP[kind]
        # Whole numbers are read as floats too: Budget says what is wrong with 1.5 bytes.
        budget.add_argument(f"--{kind}", type=float, metavar=metavar, help=text.format(default=DEFAULT_BUDGET.value))
    parser.add_argument("--output-dir", metavar="DIR", help="all names are of pictures; write DIR/NAME.sg for each")
    parser.add_argument(
        "--jobs",
        type=_whole_number("a number of jobs", 1, MAX_JOBS),
        default=1,
        metavar="N",
        help="so many pictures at a time (default: 1)",
    )
    parser.add_argument(
        "--profile", choices=PROFILE_NAMES, default=DEFAULT_PROFILE, help=f"method (default: {DEFAULT_PROFILE})"
    )
    parser.add_argument(
        "--tune", choices=TUNES, help=f"for squared error, or for the eye (default: {DEFAULT_TUNE}; with --psnr: psnr)"
    )
    parser.add_argument(
        "--effort",
        type=_whole_number("an effort", min(EFFORTS), max(EFFORTS)),
        default=DEFAULT_EFFORT,
        metavar="N",
        help=f"from {min(EFFORTS)}, the fastest, to {max(EFFORTS)}, the best (default: {DEFAULT_EFFORT})",
    )
    parser.add_argument("--time-limit", type=float, metavar="SECONDS", help="be done after so long, for each picture")
    parser.add_argument("--server", metavar="URL", help="have a service encode it; its API key from SG_API_KEY")
    parser.add_argument(
        "--seed",
        type=_whole_number("a seed", 0, MAX_SEED),
        default=0,
        metavar="N",
        help="of everything random (default: 0)",
    )
    parser.add_argument("--trace", metavar="FILE.json", help="write error against time of the fit, of one picture")
    parser.add_argument("--json", action="store_true", help="print the figures as a JSON object for each picture")
    _add_common_arguments(parser)


def _add_decode_arguments(parser: argparse.ArgumentParser) -> None:
    from sgmethod.view import MAX_SCALE, MIN_SCALE

    parser.add_argument("input", metavar="IN.sg", help="- for standard input")
    parser.add_argument("output", metavar="OUT", help="- for standard output, as PNG")
    scales = f"{MIN_SCALE} to {MAX_SCALE:g} (default: 1)"
    parser.add_argument("--scale", type=float, default=1.0, metavar="S", help=f"pixels drawn for a pixel, {scales}")
    parser.add_argument("--region", type=_region, metavar="X,Y,W,H", help="this part of the picture, in its own pixels")
    parser.add_argument(
        "--prefix", type=float, default=1.0, metavar="P", help="from this part of the file, of profile rd alone"
    )
    parser.add_argument("--no-texture", action="store_true", help="leave out the texture that a file may ask for")
    _add_common_arguments(parser)


def _add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", metavar="IN.sg", help="- for standard input")
    parser.add_argument("--json", action="store_true", help="print one JSON object, with every field")


def _add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first", metavar="A")
    parser.add_argument("second", metavar="B")
    parser.add_argument("--weights", metavar="DIR", help="weights of the networks that LPIPS and DISTS need")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def _add_plot_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", metavar="TRACE.json", help="- for standard input")
    parser.add_argument("output", metavar="OUT", help="- for standard output, as SVG")
    _add_common_arguments(parser)


def _add_common_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-clobber", action="store_true", help="skip what would replace a file")
    parser.add_argument("--quiet", action="store_true", help="print errors alone")


def _region(text: str) -> tuple[int, int, int, int]:
    with suppress(ValueError):
        x, y, width, height = (int(number) for number in text.split(","))
        return x, y, width, height
    raise argparse.ArgumentTypeError(f"a region is four whole numbers X,Y,W,H, not {text!r}")


def _whole_number(name: str, least: int, most: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        with suppress(ValueError):
            if least <= int(text) <= most:
                return int(text)
        raise argparse.ArgumentTypeError(f"{name} is a whole number from {least} to {most}, not {text!r}")

    return read
