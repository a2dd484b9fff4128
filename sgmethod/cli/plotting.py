"""The command plot: the trace of an encode, drawn by Matplotlib."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from io import BytesIO
from itertools import cycle, groupby
from typing import Any

from sgmethod.cli import paths
from sgmethod.cli.naming import Conversion, kind_of
from sgmethod.cli.paths import CommandError
from sgmethod.cli.several import convert_one
from sgmethod.errors import extra

KINDS = {".svg": "svg", ".png": "png", ".pdf": "pdf"}
SIZE_IN, DPI = (7.2, 5.0), 120
DASHES = ("-", "--", "-.")
Point = dict[str, Any]


def run_plot(arguments: argparse.Namespace) -> int:
    """Run sgmethod plot."""
    conversion = Conversion.from_paths(arguments.input, paths.output(arguments.output))
    paths.check_outputs([conversion.input], [conversion.target])
    kind_of(conversion.target, KINDS, "svg")  # fail before the work
    return convert_one(conversion, _plot, arguments)


def _plot(conversion: Conversion, _: argparse.Namespace) -> Conversion:
    points = _points(paths.read(conversion.input), paths.name_of(conversion.input))
    paths.write(conversion.target, _drawn(points, kind_of(conversion.target, KINDS, "svg")))
    return replace(conversion, summary=f"{len(points)} points, {points[-1]['seconds']:.1f} s")


def _points(data: bytes, name: str) -> list[Point]:
    """Parse a trace written by encode --trace. Raises CommandError."""
    try:
        points: list[Point] = json.loads(data)["trace"]
        for point in points:
            numbers = [point[field] for field in ("seconds", "psnr", "bytes", "gaussians")]
            if not (all(math.isfinite(number) for number in numbers) and isinstance(point["phase"], str)):
                raise ValueError
        if not points:
            raise ValueError
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise CommandError(f"{name} is not a trace: write one with encode --trace") from error
    return points


def _drawn(points: list[Point], kind: str) -> bytes:
    """Draw PSNR above, size and Gaussians below, against time; dashes distinguish phases without colour."""
    try:
        with extra("plot"):
            import matplotlib as mpl
            from matplotlib.figure import Figure
    except ValueError as error:
        raise CommandError(f"MPLBACKEND is not a backend of Matplotlib: {error}") from error
    style = {"svg.hashsalt": "sgmethod", "axes.grid": True, "grid.color": "0.9", "font.size": 9}
    with mpl.rc_context(style):
        figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="constrained")
        errors, sizes = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        _draw_errors(errors, points)
        seconds = [point["seconds"] for point in points]
        known = [(point["seconds"], point["bytes"]) for point in points if point["bytes"] > 0]
        if known:
            sizes.plot(*zip(*known, strict=True), color="0", label="bytes")
        sizes.set(xlabel="seconds", ylabel="bytes, estimated")
        numbers = sizes.twinx()
        numbers.grid(False)
        numbers.plot(seconds, [point["gaussians"] for point in points], ":", color="0.4", label="Gaussians")
        numbers.set_ylabel("Gaussians (dotted)")
        out = BytesIO()
        figure.savefig(out, format=kind, metadata={"Date": None} if kind == "svg" else None)
    return out.getvalue()


def _draw_errors(axes: Any, points: list[Point]) -> None:
    """Draw a line per phase, and a mark for the file at the end."""
    dashes = cycle(DASHES)
    before: list[Point] = []
    for phase, group in groupby(points[:-1], key=lambda point: point["phase"]):
        shown = [*before, *group]
        axes.plot([p["seconds"] for p in shown], [p["psnr"] for p in shown], next(dashes), color="0", label=phase)
        before = shown[-1:]
    end = points[-1]
    axes.plot(
        end["seconds"], end["psnr"], "o", color="0", label=f"the file: {end['psnr']:.2f} dB, {end['bytes']:,} bytes"
    )
    axes.set_ylabel("PSNR, dB")
    axes.legend(loc="lower right", frameon=False)
