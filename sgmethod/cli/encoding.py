"""The command encode: pictures to .sg files, here or on a server."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgmethod.budget import BUDGET_KINDS, Budget
from sgmethod.cli import naming, paths
from sgmethod.cli.arguments import one_line
from sgmethod.cli.naming import Conversion
from sgmethod.cli.paths import CommandError
from sgmethod.cli.several import Figures, convert_all, convert_one
from sgmethod.cli.terminal import progress_line, redraw
from sgmethod.encode_arguments import EncodeOptions
from sgmethod.many.manifest import Manifest
from sgmethod.profiles import DEFAULT_PROFILE, encoder_of, method_of
from sgmethod.trace import TracePoint

if TYPE_CHECKING:
    from sgmethod.client import Client

PATIENCE_S, MANY_PATIENCE_S = 60.0, 3600.0  # time to wait for a server that is busy or restarts
SHORTEST_LIMIT_S = 1e-3  # what a time limit leaves at least


def run_encode(arguments: argparse.Namespace) -> int:
    """Run sgmethod encode."""
    if arguments.output_dir is not None:
        return _encode_all(arguments)
    conversion = naming.encode(arguments)
    traces = [] if arguments.trace is None else [paths.output(arguments.trace)]
    paths.check_outputs([conversion.input], [conversion.target, *traces])
    _only_budget(arguments)  # fail before the picture is read
    _check_method(arguments)
    encode = partial(_encode, began=arguments.began, shown=not arguments.quiet and os.isatty(2))
    return convert_one(conversion, encode, arguments, traces)


def _encode_all(arguments: argparse.Namespace) -> int:
    """Encode into a folder that has a manifest."""
    if arguments.trace is not None:
        raise CommandError("--trace cannot be combined with --output-dir")
    options = {"budget": _only_budget(arguments), **_choices(arguments), "server": arguments.server}
    manifest = Manifest(arguments.output_dir, options)
    conversions = naming.into_folder(arguments, naming.PICTURES, naming.sg_beside, manifest.sources)
    paths.check_outputs([one.input for one in conversions], [one.target for one in conversions])
    _check_method(arguments)
    with manifest:
        return convert_all(conversions, _encode, "encoded", arguments, manifest)


def _check_method(arguments: argparse.Namespace) -> None:
    """Fail once, not for each picture, if a server or a profile cannot be used. Raises SgError."""
    if arguments.server is not None:
        _client_for(arguments)
    elif arguments.profile != DEFAULT_PROFILE:
        encoder_of(arguments.profile)


def _only_budget(arguments: argparse.Namespace) -> Budget | None:
    given = [Budget(kind, value) for kind in BUDGET_KINDS if (value := getattr(arguments, kind)) is not None]
    return given[0] if given else None


def _summary(figures: Figures) -> str:
    from sgmethod.metrics.visual import quality_word

    psnr = "no error" if figures["psnr"] is None else f"{figures['psnr']:.2f} dB"
    score = figures["ssimulacra2"]
    looks = "" if score is None else f"SSIMULACRA 2 {score:.1f} ({quality_word(score)}), "
    size = "{width} x {height}: {bytes:,} bytes, {bpp:.4f} bpp".format(**figures)
    return f"{size}, {looks}{psnr}, " + "{gaussians:,} Gaussians, {seconds:.1f} s".format(**figures)


def _encode(
    conversion: Conversion, arguments: argparse.Namespace, began: float | None = None, shown: bool = False
) -> Conversion:
    """Read, encode and write one picture. began: value of perf_counter when the user's wait began, if before now."""
    began = time.perf_counter() if began is None else began
    before = time.perf_counter()
    image = paths.read(conversion.input)
    read_s = time.perf_counter() - before  # of a pipe, perhaps minutes
    encode = partial(_encode_here, began + read_s) if arguments.server is None else _encode_there
    with progress_line(shown, began) as show:
        try:
            listener = show or getattr(arguments, "on_progress", None)  # for a folder, its report
            data, figures, trace, notes = encode(conversion, arguments, image, listener)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{paths.name_of(conversion.target)} was not written") from None
    figures["seconds"] = round(time.perf_counter() - began, 4)  # including imports and transfers
    if arguments.trace is not None:
        points = {"stats": figures, "trace": [point.to_dict() for point in trace]}
        paths.write(paths.output(arguments.trace), (json.dumps(points, allow_nan=False) + "\n").encode())
    paths.write(conversion.target, data)
    summary = "" if arguments.json else _summary(figures)
    return replace(conversion, bytes=len(data), summary=summary, figures=figures, notes=notes)


Result = tuple[bytes, Figures, list[TracePoint], list[str]]  # file, figures, trace, notes on anything dropped
Show = Callable[[TracePoint], None] | None


def _choices(arguments: argparse.Namespace) -> dict[str, Any]:
    """Options other than the budget, the same here and on a server."""
    return {one.name: getattr(arguments, one.name) for one in fields(EncodeOptions)}


def _encode_here(began: float, _: Conversion, arguments: argparse.Namespace, image: bytes, show: Show) -> Result:
    """Encode in this process. began: value of perf_counter from which a time limit counts, imports included."""
    from sgmethod.codec import encode
    from sgmethod.metrics.advice import advice, better_file

    pixels, notes = paths.read_pixels(image, keep_alpha=method_of(arguments.profile).keeps_alpha)
    choices = _choices(arguments)
    if (limit_s := arguments.time_limit_s) is not None and limit_s > 0:
        choices["time_limit_s"] = max(limit_s - (time.perf_counter() - began), SHORTEST_LIMIT_S)
    measure = arguments.json or limit_s is None  # it takes time, of which a limit has none to spare
    encoded = encode(pixels, _only_budget(arguments), **choices, on_progress=show, measure=measure)
    stats = replace(encoded.stats, source_bytes=len(image))
    advised = advice(better_file(pixels, stats.bytes, stats.psnr), stats.bytes, stats.psnr)
    return encoded.data, stats.to_dict() | advised, encoded.trace, notes


def _encode_there(conversion: Conversion, arguments: argparse.Namespace, image: bytes, show: Show) -> Result:
    from sgmethod.client.many import key_of

    budget, choices = _only_budget(arguments), _choices(arguments)
    more: dict[str, Any] = {"on_progress": show}
    if arguments.output_dir is not None:  # a run that was killed is resumed: its jobs are found again
        asked = {"budget": budget, **choices}
        more |= {"priority": "bulk", "idempotency_key": key_of(Path(conversion.target).resolve(), asked, image)}
    encoded = _client_for(arguments).encode(image, budget, **choices, **more)
    return encoded.data, encoded.figures, encoded.trace, encoded.notes


def _client_for(arguments: argparse.Namespace) -> Client:
    """Return the client for --server. Raises SgError."""
    patience_s = PATIENCE_S if arguments.output_dir is None else MANY_PATIENCE_S
    return _client(arguments.server, arguments.quiet, patience_s)


@cache
def _client(server: str, quiet: bool, patience_s: float) -> Client:
    """Create one client for all pictures: after a first answer, it can tell a restart from a wrong address."""
    from sgmethod.client import Client

    def say(message: str) -> None:
        if not quiet:
            if os.isatty(2):
                redraw(sys.stderr, "")  # the line of progress
            print(f"sgmethod: {one_line(message)}", file=sys.stderr, flush=True)

    return Client(server, os.environ.get("SG_API_KEY"), patience_s=patience_s, on_retry=say)
