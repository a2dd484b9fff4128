"""The three commands. Only `encode` imports torch, and with --server not even that."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from sgmethod.budget import BUDGET_KINDS, Budget
from sgmethod.cli import files
from sgmethod.cli.arguments import DEFAULT_BUDGET
from sgmethod.cli.terminal import progress_line, silent_stderr
from sgmethod.decode import decode, info
from sgmethod.io.image import read_image_8_bit
from sgmethod.io.png import encode_png
from sgmethod.trace import TracePoint
from sgmethod.view import View

if TYPE_CHECKING:
    from sgmethod.codec import Encoded

Result = tuple[bytes, dict[str, Any], list[TracePoint]]  # the file, its figures, the trace


def run_encode(arguments: argparse.Namespace) -> None:
    """sgmethod encode"""
    given = [Budget(kind, value) for kind in BUDGET_KINDS if (value := getattr(arguments, kind)) is not None]
    files.check_outputs(arguments.input, [path for path in (arguments.output, arguments.trace) if path is not None])
    encode = _encode_here if arguments.server is None else _encode_there
    data, figures, trace = encode(arguments, given[0] if given else DEFAULT_BUDGET, files.read(arguments.input))
    if arguments.trace is not None:
        points = {"stats": figures, "trace": [point.to_dict() for point in trace]}
        files.write(arguments.trace, (json.dumps(points, allow_nan=False) + "\n").encode())
    files.write(arguments.output, data)
    if arguments.json:
        print(json.dumps(figures, allow_nan=False))
    elif not arguments.quiet:
        print(_summary(figures))


def _encode_here(arguments: argparse.Namespace, budget: Budget, image: bytes) -> Result:
    with silent_stderr():  # libtiff prints its own lines about a damaged file
        pixels = read_image_8_bit(image)
    del image  # the file: a photograph of some megabytes
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
        raise files.CommandError(f"--server needs another package ({error}): pip install 'sgmethod[client]'") from error
    if arguments.seed != 0:
        raise files.CommandError("a server takes no --seed")
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
        raise files.CommandError(
            f"encoding needs packages that decoding does not ({error}); install them: pip install 'sgmethod[encode]'"
        ) from error
    return encode


def _summary(figures: dict[str, Any]) -> str:
    psnr = "no error" if figures["psnr"] is None else f"{figures['psnr']:.2f} dB"
    ssim = "" if figures["ms_ssim"] is None else f", MS-SSIM {figures['ms_ssim']:.4f}"
    size = "{width} x {height}: {bytes:,} bytes, {bpp:.4f} bpp".format(**figures)
    return f"{size}, {psnr}{ssim}, " + "{gaussians:,} Gaussians, {steps:,} steps, {seconds:.1f} s".format(**figures)


def run_decode(arguments: argparse.Namespace) -> None:
    """sgmethod decode"""
    view = View(arguments.scale, arguments.region, arguments.prefix)
    files.check_outputs(arguments.input, [arguments.output])
    files.write(arguments.output, encode_png(decode(files.read(arguments.input), view=view)))


def run_info(arguments: argparse.Namespace) -> None:
    """sgmethod info"""
    fields = info(files.read(arguments.input)).to_dict()
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
