"""Parsing of the command line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any, NoReturn

from sgmethod.errors import SgError
from sgmethod.io.formats import EXTRA, PLAIN, WRITTEN, listed

BAD_INPUT = 2
BUDGET_HELP = {
    "bpp": ("F", "maximum size in bits per pixel"),
    "bytes": ("N", "maximum size in bytes: 20000, 20k, 1.5MB"),
    "quality": (
        "Q",
        "target SSIMULACRA 2, up to 100 and not on JPEG's scale, or preview (40), web (60), archive (80) "
        "(default: {quality:g}, in at most {bpp:g} bits per pixel)",
    ),
    "psnr": ("DB", "target PSNR in dB, in as few bytes as possible"),
    "gaussians": ("N", "number of Gaussians; with profile rd, at most this many"),
}
SUGGESTION_CUTOFF = 0.7  # similarity of words, from which one may have been meant

# argparse's own usage would not show inputs and outputs as separate names.
USAGES = {
    "encode": "%(prog)s [OPTIONS] IN [OUT.sg]\n       %(prog)s [OPTIONS] IN... --output-dir DIR",
    "decode": "%(prog)s [OPTIONS] IN.sg OUT\n       %(prog)s [OPTIONS] IN.sg... --output-dir DIR",
}

EXAMPLES = """examples:
  sgmethod encode photo.jpg                        writes photo.sg
  sgmethod decode photo.sg photo.png
  sgmethod compare photo.jpg photo.sg
each command has its own examples: sgmethod encode --help"""
ENCODE = (
    "Encode pictures as .sg files.",
    f"""Reads {listed(PLAIN)}; {listed(EXTRA)} need an extra package. Colours are
converted to sRGB. Give at most one of --bpp, --bytes, --quality, --psnr and --gaussians.

examples:
  sgmethod encode photo.jpg                        writes photo.sg, of medium quality
  sgmethod encode photo.jpg -o small.sg --bytes 20k
  sgmethod encode - - --quality web <photo.jpg >photo.sg
  sgmethod encode *.jpg --output-dir out           writes out/NAME.sg for each
  sgmethod encode photos --output-dir out --resume
                                                   every picture in the folder, except those done before""",
)
DECODE = (
    "Decode .sg files, whole or in part, at any size.",
    f"""The extension of OUT sets the format: {listed((one.suffixes[0] for one in WRITTEN.values()), "or")}.

examples:
  sgmethod decode photo.sg photo.png
  sgmethod decode photo.sg small.jpg --width 320
  sgmethod decode photo.sg part.png --region 100,50,320,240 --scale 2
  sgmethod decode - - <photo.sg >photo.png
  sgmethod decode *.sg --output-dir out            writes out/NAME.png for each""",
)
PREVIEW = (
    "Print each picture as a short text, from which a page draws a preview until the picture has loaded.",
    """Prints the text alone, or NAME, a tab and the text for each of several pictures. The text is an .sg file without
its first byte, in base64url: 4 characters for 3 bytes. decode and info read it too, in a file or from stdin.

examples:
  sgmethod preview photo.jpg
  sgmethod preview photo.jpg --bytes 400 --json    with width, height, average colour, and whether that is dark
  sgmethod preview photo.jpg --html                an <img> with the preview as its background
  sgmethod preview photo.jpg --element --alt "A red door"
                                                   an <sg-img>, and what the picture shows
  sgmethod preview photos --json >previews.jsonl
  sgmethod preview photos --output-dir out --resume
                                                   out/NAME.sg, and all texts in out/manifest.jsonl""",
)
INFO = (
    "Show the header of an .sg file and where its bits go.",
    """examples:
  sgmethod info photo.sg
  sgmethod info photo.sg --json""",
)
COMPARE = (
    "Measure how close B is to the original A. Either may be a picture or an .sg file.",
    """Prints PSNR and SSIMULACRA 2; higher is better.

examples:
  sgmethod compare photo.jpg photo.sg
  sgmethod compare a.png b.png --json""",
)


def one_line(message: str) -> str:
    """Join a message into one line, in which a file's name cannot control the terminal."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f]", lambda found: f"\\x{ord(found[0]):02x}", " ".join(message.split()))


class _Parser(argparse.ArgumentParser):
    """A parser that reports wrong usage as one line on stderr, like every other error."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        named |= {"allow_abbrev": False, "formatter_class": argparse.RawDescriptionHelpFormatter}
        super().__init__(*arguments, **named)
        self.commands: dict[str, argparse.ArgumentParser] = {}

    def error(self, message: str) -> NoReturn:
        if choice := re.search(r"invalid choice: '(.*)' \(choose from (.*)\)", message):
            message += suggestion(choice[1], re.findall(r"[\w-]+", choice[2]))
        self.exit(BAD_INPUT, f"sgmethod: {one_line(message)} (see: {self.prog} --help)\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help like other output: argparse would hide that nobody reads it."""
        file.write(message)


class _Version(argparse.Action):
    """The action of --version, which looks up the version only on request: that takes longer than parsing."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"sgmethod {version('sgmethod')}")
        parser.exit()


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Parse arguments; the result names the command as `run`. Wrong usage ends the process.

    File names may appear anywhere, although argparse only accepts those before the next option.
    """
    whole = parser(argv)
    arguments, more = whole.parse_known_args(argv)
    options = [one for one in more if one.startswith("-") and one != "-"]
    if more and (options or not hasattr(arguments, "names")):
        command = whole.commands[arguments.run]
        known = [text for action in command._actions for text in action.option_strings]
        command.error(f"unrecognized arguments: {' '.join(more)}{suggestion((options or more)[0], known)}")
    if more:
        arguments.names += [_path(one) for one in more]
    return arguments


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return the known word that was probably meant, as a question; empty if none is close."""
    from difflib import get_close_matches

    close = get_close_matches(word.partition("=")[0], known, 1, SUGGESTION_CUTOFF)
    return f"; did you mean {close[0]}?" if close else ""


def parser(argv: Sequence[str]) -> _Parser:
    """Build the parser; its result names the command as `run`.

    Only commands named in argv get arguments: a decode need not import every profile for the arguments of encode.
    """
    whole = _Parser(prog="sgmethod", description="Store photographs as 2D Gaussians.", epilog=EXAMPLES)
    whole.add_argument("--version", action=_Version, nargs=0, help="show the version")
    commands = whole.add_subparsers(metavar="COMMAND", required=True)

    for name, (texts, add) in {
        "encode": (ENCODE, _add_encode_arguments),
        "preview": (PREVIEW, _add_preview_arguments),
        "decode": (DECODE, _add_decode_arguments),
        "info": (INFO, _add_info_arguments),
        "compare": (COMPARE, _add_compare_arguments),
    }.items():
        command = commands.add_parser(
            name, help=texts[0], description=texts[0], epilog=texts[1], usage=USAGES.get(name)
        )
        command.set_defaults(run=name)
        whole.commands[name] = command
        if name in argv:
            add(command)
    return whole


def _add_encode_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names",
        nargs="+",
        type=_path,
        metavar="IN [OUT.sg]",
        help="input and output, - for stdin and stdout (default output: IN with .sg)",
    )
    _add_output_arguments(parser, "encode every IN, a picture or a folder of them, to DIR/NAME.sg")
    _add_budget_arguments(parser)
    _add_run_arguments(parser)
    _add_options(parser)
    parser.add_argument("--server", metavar="URL", help="encode on this server, with the API key in SG_API_KEY")
    parser.add_argument("--trace", type=_path, metavar="FILE.json", help="write the error over time (one picture only)")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object per picture")
    _add_common_arguments(parser)


def _add_budget_arguments(parser: argparse.ArgumentParser) -> None:
    from sgmethod.budget import BUDGET_KINDS, DEFAULT_BUDGET

    default = {"quality": DEFAULT_BUDGET.value, "bpp": DEFAULT_BUDGET.max_bpp}
    budget = parser.add_mutually_exclusive_group()
    for kind in BUDGET_KINDS:
        metavar, text = BUDGET_HELP[kind]
        # Whole numbers are read as floats too, so that Budget reports what is wrong with 1.5 bytes.
        read = {"bytes": _size, "quality": _quality}.get(kind, float)
        budget.add_argument(f"--{kind}", type=read, metavar=metavar, help=text.format(**default))


def _add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of an encode: those with a list of choices, whole numbers within limits, and numbers."""
    from sgmethod.encode_arguments import EncodeOptions

    for one in fields(EncodeOptions):
        text, schema = one.metadata["description"], one.metadata["json_schema_extra"]
        if "enum" in schema:
            reading: dict[str, Any] = {"choices": schema["enum"]}
        elif "minimum" in schema:
            read = _whole_number(f"an {one.name}", schema["minimum"], schema["maximum"])
            reading = {"type": read, "metavar": "N"}
        else:
            reading = {"type": float, "metavar": "SECONDS"}
        flag = f"--{one.name.removesuffix('_s').replace('_', '-')}"
        parser.add_argument(flag, dest=one.name, default=one.default, help=text, **reading)


def _add_preview_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="+", type=_path, metavar="IN", help="pictures, and folders of them; - for stdin")
    parser.add_argument(
        "--output-dir", type=_path, metavar="DIR", help="write DIR/NAME.sg for every IN, and DIR/manifest.jsonl"
    )
    parser.add_argument("--bytes", type=_size, metavar="N", default=200, help="maximum .sg file size (default: 200)")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print one JSON object per picture")
    form.add_argument("--html", action="store_true", help="print an <img> that needs no JavaScript")
    form.add_argument("--element", action="store_true", help="print an <sg-img>, which draws the preview itself")
    parser.add_argument("--alt", metavar="TEXT", help="with --html or --element: what the picture shows")
    _add_run_arguments(parser)
    _add_common_arguments(parser)
    parser.set_defaults(output=None)


def _add_run_arguments(parser: argparse.ArgumentParser) -> None:
    from sgmethod.many.processes import MAX_JOBS

    parser.add_argument(
        "--jobs",
        type=_whole_number("a number of jobs", 1, MAX_JOBS),
        metavar="N",
        help="encode N pictures at a time (default: one for each core, if there are many and memory allows)",
    )
    parser.add_argument("--resume", action="store_true", help="skip pictures that DIR/manifest.jsonl lists as encoded")


def _add_decode_arguments(parser: argparse.ArgumentParser) -> None:
    from sgmethod.view import MAX_COORDINATE, MAX_SCALE, MIN_SCALE

    parser.add_argument(
        "names", nargs="+", type=_path, metavar="IN.sg OUT", help="input and output, - for stdin and stdout (as PNG)"
    )
    _add_output_arguments(parser, "decode every IN.sg, a file or a folder of them, to DIR/NAME.png")
    scales = f"{MIN_SCALE} to {MAX_SCALE:g} (default: 1)"
    parser.add_argument("--scale", type=float, metavar="S", help=f"output pixels per pixel of the picture, {scales}")
    for side in ("width", "height"):
        parser.add_argument(
            f"--{side}",
            type=_whole_number(f"a {side}", 1, MAX_COORDINATE),
            metavar="N",
            help=f"output {side} in pixels; the aspect ratio is kept",
        )
    parser.add_argument("--region", type=_region, metavar="X,Y,W,H", help="only this part, in pixels of the picture")
    parser.add_argument(
        "--prefix", type=float, default=1.0, metavar="P", help="only this fraction of the file (profile rd only)"
    )
    parser.add_argument("--no-texture", action="store_true", help="do not draw synthesised texture")
    _add_common_arguments(parser)


def _add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("input", type=_path, metavar="IN.sg", help="an .sg file, - for stdin")
    parser.add_argument("--json", action="store_true", help="print every field as one JSON object")


def _add_compare_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("first", type=_path, metavar="A", help="the original")
    parser.add_argument("second", type=_path, metavar="B", help="what to measure")
    parser.add_argument("--json", action="store_true", help="print the figures as one JSON object")


def _add_output_arguments(parser: argparse.ArgumentParser, several: str) -> None:
    parser.add_argument("-o", "--output", type=_path, metavar="OUT", help="output file, instead of a second name")
    parser.add_argument("--output-dir", type=_path, metavar="DIR", help=several)


def _add_common_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-clobber", action="store_true", help="skip outputs that already exist")
    parser.add_argument("--quiet", action="store_true", help="print errors only")


def _path(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("a file name must not be empty")
    return text


def _size(text: str) -> float:
    from sgmethod.budget import bytes_value

    try:
        return bytes_value(text)
    except SgError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _quality(text: str) -> float:
    from sgmethod.budget import QUALITIES

    with suppress(ValueError):
        return QUALITIES[text] if text in QUALITIES else float(text)
    raise argparse.ArgumentTypeError(f"quality is a number, or one of {', '.join(QUALITIES)}, not {text!r}")


def _region(text: str) -> tuple[int, int, int, int]:
    with suppress(ValueError):
        x, y, width, height = (int(number) for number in text.split(","))
        return x, y, width, height
    raise argparse.ArgumentTypeError(f"a region is four whole numbers X,Y,W,H, not {text!r}")


def _whole_number(name: str, minimum: int, maximum: int) -> Callable[[str], int]:
    def read(text: str) -> int:
        with suppress(ValueError):
            if minimum <= int(text) <= maximum:
                return int(text)
        raise argparse.ArgumentTypeError(f"{name} is a whole number from {minimum} to {maximum}, not {text!r}")

    return read
