"""The command line: sgmethod encode, decode and info.

Exit status: 0 when all is done; 2 when it cannot be done as asked, with one line on stderr that says why; 130
after Ctrl-C; 141 when nobody reads stdout any more. A file is written whole or not at all, and whether it can
be written is known before the work begins. Only `encode` imports torch, and with --server not even that.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import signal
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from sgmethod.budget import BUDGET_KINDS, Budget, BudgetKind
from sgmethod.cli.terminal import progress_line, silent_stderr
from sgmethod.decode import decode, info
from sgmethod.errors import SgError
from sgmethod.io.files import encode_png, write_atomically
from sgmethod.io.image import read_image
from sgmethod.profiles import DEFAULT_PROFILE, PROFILE_NAMES
from sgmethod.trace import TracePoint
from sgmethod.view import MAX_SCALE, MIN_SCALE, View

if TYPE_CHECKING:
    from sgmethod.codec import Encoded

Result = tuple[bytes, dict[str, Any], list[TracePoint]]  # the file, its figures, the trace
BAD_INPUT, INTERRUPTED, NO_READER = 2, 128 + signal.SIGINT, 128 + signal.SIGPIPE
DEFAULT_BUDGET = Budget("bpp", 0.3)
BUDGET_HELP: dict[BudgetKind, tuple[str, str]] = {
    "bpp": ("F", f"at most so many bits per pixel ({DEFAULT_BUDGET.value} if no budget is given)"),
    "bytes": ("N", "at most so many bytes"),
    "psnr": ("DB", "this quality in as few bytes as can be found"),
    "quality": ("Q", "a fineness, above 0 to 100, of profile rd alone"),
    "gaussians": ("N", "this number of Gaussians"),
}
MAX_INPUT_BYTES = 1 << 30  # the largest picture that is read takes 800 MB uncompressed; a device never ends
MAX_SEED = 2**32 - 1


class CommandError(Exception):
    """What keeps a command from being carried out, in one sentence."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status, except for --help, --version and wrong usage, which exit."""
    arguments = _parser().parse_args(argv)
    try:
        arguments.run(arguments)
        print(end="", flush=True)
    except BrokenPipeError:
        _abandon_stdout()
        return NO_READER
    except KeyboardInterrupt:
        return INTERRUPTED
    except MemoryError:
        return _fail("there is not enough memory")
    except (SgError, CommandError) as error:
        return _fail(str(error))
    except OSError as error:
        _abandon_stdout()
        return _fail(str(error))
    return 0


def _abandon_stdout() -> None:
    """What is left in stdout's buffer goes nowhere, or the interpreter would fail on it once more at its end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str) -> int:
    print(f"sgmethod: {_one_line(message)}", file=sys.stderr)
    return BAD_INPUT


def _one_line(message: str) -> str:
    return " ".join(message.split())


class _Parser(argparse.ArgumentParser):
    """Wrong usage is one line on stderr, like every other error."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"sgmethod: {_one_line(message)} (see: {self.prog} --help)\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="sgmethod", description="Photographs as small sets of 2D Gaussians.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"sgmethod {version('sgmethod')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def command(name: str, run: Callable[[argparse.Namespace], None], summary: str) -> argparse.ArgumentParser:
        found = commands.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        found.set_defaults(run=run)
        return found

    _add_encode_arguments(command("encode", _encode, "Encode an image (PNG, JPEG, WebP, TIFF, BMP) as an .sg file."))
    _add_decode_arguments(command("decode", _decode, "Decode an .sg file, or a view of it, to PNG."))
    fields = command("info", _info, "Print the header fields of an .sg file and the bits spent on each part.")
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


def _encode(arguments: argparse.Namespace) -> None:
    given = [Budget(kind, value) for kind in BUDGET_KINDS if (value := getattr(arguments, kind)) is not None]
    _check_outputs(arguments.input, [path for path in (arguments.output, arguments.trace) if path is not None])
    encode = _encode_here if arguments.server is None else _encode_there
    data, figures, trace = encode(arguments, given[0] if given else DEFAULT_BUDGET, _read(arguments.input))
    if arguments.trace is not None:
        points = {"stats": figures, "trace": [point.to_dict() for point in trace]}
        _write(arguments.trace, (json.dumps(points, allow_nan=False) + "\n").encode())
    _write(arguments.output, data)
    if arguments.json:
        print(json.dumps(figures, allow_nan=False))
    elif not arguments.quiet:
        print(_summary(figures))


def _encode_here(arguments: argparse.Namespace, budget: Budget, image: bytes) -> Result:
    with silent_stderr():  # libtiff prints its own lines about a damaged file
        pixels = read_image(image)
    encode = _load_encoder()
    with progress_line(not arguments.quiet and os.isatty(2)) as show:
        encoded = encode(
            pixels,
            budget,
            arguments.profile,
            seed=arguments.seed,
            time_limit_s=arguments.time_limit,
            on_progress=show,
        )
    return encoded.data, encoded.stats.to_dict(), encoded.trace


def _encode_there(arguments: argparse.Namespace, budget: Budget, image: bytes) -> Result:
    try:
        from sgmethod.client import Client
    except ImportError as error:
        raise CommandError(f"--server needs another package ({error}): pip install 'sgmethod[client]'") from error
    if arguments.seed != 0:
        raise CommandError("a server takes no --seed")
    with (
        Client(arguments.server, os.environ.get("SG_API_KEY")) as client,
        progress_line(not arguments.quiet and os.isatty(2)) as show,
    ):
        limit = arguments.time_limit
        encoded = client.encode(image, budget, arguments.profile, time_limit_s=limit, on_progress=show)
    return encoded.data, encoded.figures, encoded.trace


def _load_encoder() -> Callable[..., Encoded]:
    try:
        from sgmethod.codec import encode
    except ImportError as error:
        raise CommandError(
            f"encoding needs packages that decoding does not ({error}); install them: pip install 'sgmethod[encode]'"
        ) from error
    return encode


def _summary(figures: dict[str, Any]) -> str:
    psnr = "no error" if figures["psnr"] is None else f"{figures['psnr']:.2f} dB"
    ssim = "" if figures["ms_ssim"] is None else f", MS-SSIM {figures['ms_ssim']:.4f}"
    size = "{width} x {height}: {bytes:,} bytes, {bpp:.4f} bpp".format(**figures)
    return f"{size}, {psnr}{ssim}, " + "{gaussians:,} Gaussians, {steps:,} steps, {seconds:.1f} s".format(**figures)


def _decode(arguments: argparse.Namespace) -> None:
    view = View(arguments.scale, arguments.region, arguments.prefix)
    _check_outputs(arguments.input, [arguments.output])
    _write(arguments.output, encode_png(decode(_read(arguments.input), view=view)))


def _info(arguments: argparse.Namespace) -> None:
    fields = info(_read(arguments.input)).to_dict()
    if arguments.json:
        print(json.dumps(fields, allow_nan=False))
        return
    for name, value in fields.items():
        for label, text in _lines(name, value):
            print(f"{label:<22}{text}")


def _lines(name: str, value: object) -> Iterator[tuple[str, str]]:
    """A field of info() as (label, value) lines: a nested field has a line for each of its parts."""
    if isinstance(value, dict):
        for part, inner in value.items():
            yield from _lines(f"{name}.{part}", inner)
    elif isinstance(value, list) and value and isinstance(value[0], list | dict):
        for index, inner in enumerate(value):
            yield from _lines(f"{name}[{index}]", inner)
    elif isinstance(value, list):
        yield name, " ".join(f"{v:.7g}" for v in value)
    else:
        yield name, f"{value:.4f}" if isinstance(value, float) else str(value)


def _read(path: str) -> bytes:
    """The bytes of a file, of at most MAX_INPUT_BYTES."""
    data = bytearray()
    with _saying("read", path), Path(path).open("rb") as file:
        while block := file.read(1 << 20):
            data += block
            if len(data) > MAX_INPUT_BYTES:
                raise CommandError(f"cannot read {path}: it has more than {MAX_INPUT_BYTES:,} bytes")
    return bytes(data)


def _write(path: str, data: bytes) -> None:
    with _saying("write", path):
        write_atomically(path, data)


@contextmanager
def _saying(verb: str, path: str) -> Iterator[None]:
    """What the system refuses becomes one sentence with the path as it was given."""
    try:
        yield
    except OSError as error:
        raise CommandError(f"cannot {verb} {path}: {error.strerror or error}") from error


def _check_outputs(source: str, outputs: list[str]) -> None:
    """Raise CommandError if one of the files cannot be written, or would replace the input or each other."""
    for path in outputs:
        with _saying("write", path):
            _check_writable(Path(os.path.realpath(path)))
    files = [os.path.realpath(path) for path in (source, *outputs) if not _is_device(path)]
    if len(set(files)) < len(files):
        raise CommandError("the input and what is written must be different files")


def _is_device(path: str) -> bool:
    return Path(path).exists() and not Path(path).is_file()


def _check_writable(target: Path) -> None:
    """Raise OSError as writing would."""
    mode = None
    with suppress(FileNotFoundError):
        mode = target.stat().st_mode
    if mode is not None and stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if mode is not None and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    if mode is None or stat.S_ISREG(mode):
        with tempfile.TemporaryFile(dir=target.parent):
            pass
