"""sgmethod encode: which files become which, and their encodes, one after the other or several at a time."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sgmethod.budget import BUDGET_KINDS, DEFAULT_BUDGET, Budget
from sgmethod.cli import files
from sgmethod.cli.arguments import one_line
from sgmethod.cli.files import STREAM, CommandError
from sgmethod.cli.terminal import progress_line, redraw, remaining
from sgmethod.errors import SgError
from sgmethod.io.pictures import SUFFIXES
from sgmethod.trace import TracePoint

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

    from sgmethod.codec import Encoded

SUFFIX = ".sg"
SOME_FAILED = 1
Figures = dict[str, Any]


@dataclass(frozen=True)
class Conversion:
    """One picture and the file that it becomes."""

    source: str
    target: str


@dataclass(frozen=True)
class Outcome:
    """Of one conversion: its figures, or why there are none; and what was left out of the picture."""

    conversion: Conversion
    figures: Figures | None = None
    error: str = ""
    notes: list[str] = field(default_factory=list)


def run_encode(arguments: argparse.Namespace) -> int:
    """sgmethod encode"""
    conversions = _conversions(arguments)
    traces = [] if arguments.trace is None else [arguments.trace]
    files.check_outputs([one.source for one in conversions], [*(one.target for one in conversions), *traces])
    _only_budget(arguments)
    several = arguments.output_dir is not None
    out = sys.stderr if conversions[0].target == STREAM else sys.stdout
    wanted = []
    for conversion in conversions:
        if arguments.no_clobber and Path(conversion.target).is_file():
            if not arguments.quiet:
                print(f"{one_line(conversion.target)} is there already: skipped", file=out)
        else:
            wanted.append(conversion)
    if not several:
        for conversion in wanted:
            outcome = _encode(conversion, arguments, shown=not arguments.quiet and os.isatty(2))
            _say_notes(outcome, arguments)
            assert outcome.figures is not None
            if arguments.json:
                print(json.dumps(outcome.figures, allow_nan=False), file=out)
            elif not arguments.quiet:
                print(_summary(outcome.figures), file=out)
        return 0
    return _encode_all(wanted, len(conversions) - len(wanted), arguments)


def _conversions(arguments: argparse.Namespace) -> list[Conversion]:
    """What is to become what, by the names that were given. Raises CommandError."""
    names = arguments.names
    for name in names:
        if not Path(name).name:
            raise CommandError(f"{name!r} is no name of a file")
    if arguments.output_dir is None:
        if len(names) == 1 and names[0].lower().endswith(SUFFIX):
            raise CommandError(f"{names[0]} is an .sg file by its name; if it is a picture, name the output too")
        if len(names) > 2 or (len(names) == 2 and not _takes_sg(names[1])):
            raise CommandError(
                f"{names[1]} is no name of an .sg file; to encode several pictures, name a folder: --output-dir out"
            )
        target = names[1] if len(names) == 2 else STREAM if names[0] == STREAM else _named(names[0])
        return [Conversion(names[0], target)]
    if arguments.trace is not None or STREAM in names:
        raise CommandError("--output-dir goes with neither --trace nor standard input")
    files.make_folder(arguments.output_dir)
    made: dict[str, Conversion] = {}
    for name in names:
        target = str(Path(arguments.output_dir) / Path(_named(name)).name)
        if target in made:
            raise CommandError(f"{made[target].source} and {name} would both become {target}")
        made[target] = Conversion(name, target)
    return list(made.values())


def _takes_sg(path: str) -> bool:
    return path.lower().endswith(SUFFIX) or files.is_device(path)


def _named(source: str) -> str:
    """photo.jpg -> photo.sg, beside it; what is no suffix of a picture stays."""
    path = Path(source)
    known = {*SUFFIXES, ".tif", ".tiff", ".bmp", ".gif", ".heic", ".heif", ".hif", ".jxl", ".jpe", ".jfif", ".apng"}
    known |= {".pbm", ".pgm", ".pnm", ".qoi", ".avifs", ".dib", SUFFIX}
    return str(path.with_suffix(SUFFIX) if path.suffix.lower() in known else path.with_name(path.name + SUFFIX))


def _only_budget(arguments: argparse.Namespace) -> Budget:
    given = [Budget(kind, value) for kind in BUDGET_KINDS if (value := getattr(arguments, kind)) is not None]
    return given[0] if given else DEFAULT_BUDGET


def _say_notes(outcome: Outcome, arguments: argparse.Namespace) -> None:
    if not arguments.quiet:
        files.print_notes(outcome.conversion.source, outcome.notes)


def _summary(figures: Figures) -> str:
    psnr = "no error" if figures["psnr"] is None else f"{figures['psnr']:.2f} dB"
    ssim = "" if figures["ms_ssim"] is None else f", MS-SSIM {figures['ms_ssim']:.4f}"
    size = "{width} x {height}: {bytes:,} bytes, {bpp:.4f} bpp".format(**figures)
    return f"{size}, {psnr}{ssim}, " + "{gaussians:,} Gaussians, {steps:,} steps, {seconds:.1f} s".format(**figures)


# --- one picture


def _encode(conversion: Conversion, arguments: argparse.Namespace, shown: bool) -> Outcome:
    """Read, encode, write. Raises whatever keeps it from that."""
    image = files.read(conversion.source)
    encode = _encode_here if arguments.server is None else _encode_there
    data, figures, trace, notes = encode(arguments, _only_budget(arguments), image, shown)
    if arguments.trace is not None:
        points = {"stats": figures, "trace": [point.to_dict() for point in trace]}
        files.write(arguments.trace, (json.dumps(points, allow_nan=False) + "\n").encode())
    files.write(conversion.target, data)
    return Outcome(conversion, figures, notes=notes)


Result = tuple[bytes, Figures, list[TracePoint], list[str]]  # the file, its figures, the trace, what was left out


def _choices(arguments: argparse.Namespace) -> dict[str, Any]:
    """What an encode takes beside budget and profile, here and by a service alike."""
    return {"tune": arguments.tune, "effort": arguments.effort, "time_limit_s": arguments.time_limit}


def _encode_here(arguments: argparse.Namespace, budget: Budget, image: bytes, shown: bool) -> Result:
    encode = _load_encoder()
    pixels, notes = files.read_pixels(image, keep_alpha=arguments.profile == "rd")
    del image  # the file: a photograph of some megabytes
    with progress_line(shown) as show:
        encoded = encode(
            pixels,
            budget,
            arguments.profile,
            **_choices(arguments),
            seed=arguments.seed,
            on_progress=show,
        )
    return encoded.data, encoded.stats.to_dict(), encoded.trace, notes


def _encode_there(arguments: argparse.Namespace, budget: Budget, image: bytes, shown: bool) -> Result:
    try:
        from sgmethod.client import Client
    except ImportError as error:
        raise CommandError(f"--server needs another package ({error}): pip install 'sgmethod[client]'") from error
    if arguments.seed != 0:
        raise CommandError("a server takes no --seed")
    with Client(arguments.server, os.environ.get("SG_API_KEY")) as client, progress_line(shown) as show:
        encoded = client.encode(image, budget, arguments.profile, **_choices(arguments), on_progress=show)
    return encoded.data, encoded.figures, encoded.trace, encoded.notes


def _load_encoder() -> Callable[..., Encoded]:
    try:
        from sgmethod.codec import encode
    except ImportError as error:
        raise CommandError(
            f"encoding needs packages that decoding does not ({error}); install them: pip install 'sgmethod[encode]'"
        ) from error
    return encode


# --- several


def _encode_all(conversions: list[Conversion], skipped: int, arguments: argparse.Namespace) -> int:
    """One line for each as it is done, a summary, and at the end those that failed, with exit status 1."""
    if arguments.server is None:
        _load_encoder()  # or none would succeed
    began = time.monotonic()
    failed, sizes = [], []
    shown = not arguments.quiet and os.isatty(2)
    for outcome in _outcomes(conversions, arguments):
        _say_notes(outcome, arguments)
        if outcome.figures is None:
            failed.append(outcome)
        else:
            sizes.append(outcome.figures["bytes"])
            names = {"input": outcome.conversion.source, "output": outcome.conversion.target}
            if arguments.json:
                print(json.dumps({**names, **outcome.figures}, allow_nan=False), flush=True)
            elif not arguments.quiet:
                print(f"{one_line(' -> '.join(names.values()))}: {_summary(outcome.figures)}", flush=True)
        if shown:
            done, seconds = len(failed) + len(sizes), time.monotonic() - began
            left = remaining(seconds, done / len(conversions))
            redraw(sys.stderr, f"{done} of {len(conversions)}{left}" if done < len(conversions) else "")
    if not arguments.quiet:
        counts = f"{len(sizes)} encoded, {skipped} skipped, {len(failed)} failed"
        print(
            f"{counts}: {sum(sizes):,} bytes, {time.monotonic() - began:.1f} s",
            file=sys.stderr if arguments.json else sys.stdout,
            flush=True,
        )
    for outcome in failed:
        print(f"sgmethod: {one_line(outcome.conversion.source)}: {one_line(outcome.error)}", file=sys.stderr)
    return SOME_FAILED if failed else 0


def _outcomes(conversions: list[Conversion], arguments: argparse.Namespace) -> Iterator[Outcome]:
    """As they come."""
    jobs = min(arguments.jobs, len(conversions))
    if jobs <= 1:
        yield from (_attempt(conversion, arguments) for conversion in conversions)
        return
    import signal
    from multiprocessing import get_context

    from sgmethod.native import native

    threads = max(native.thread_count() // jobs, 1)
    context = get_context("spawn")  # a copy of this process would have its threads' locks and not its threads
    plain = argparse.Namespace(**{name: value for name, value in vars(arguments).items() if name != "run"})
    with ProcessPoolExecutor(jobs, context, _begin_worker, (threads,)) as pool:
        # Ctrl-C is for this process alone. The others inherit that they ignore it: they may not even have begun Python.
        interrupted = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            running = {pool.submit(_attempt, conversion, plain): conversion for conversion in conversions}
        finally:
            signal.signal(signal.SIGINT, interrupted)
        try:
            for future in as_completed(running):
                try:
                    yield future.result()
                except BrokenProcessPool:
                    yield Outcome(running[future], error="the process that encoded it, or one beside it, was killed")
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            from multiprocessing import active_children

            for child in active_children():
                child.terminate()
            raise


def _begin_worker(threads: int) -> None:
    """In a process of its own: end with the one that started it, and never by Ctrl-C."""
    import signal
    from multiprocessing import parent_process
    from threading import Thread

    from sgmethod.native import native

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Windows lets nothing be inherited
    parent = parent_process()
    if parent is not None:
        Thread(target=_end_with, args=(parent,), daemon=True).start()
    native.set_thread_count(threads)


def _end_with(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def _attempt(conversion: Conversion, arguments: argparse.Namespace) -> Outcome:
    try:
        return _encode(conversion, arguments, shown=False)
    except MemoryError:
        return Outcome(conversion, error="there is not enough memory")
    except (SgError, CommandError) as error:
        return Outcome(conversion, error=str(error))
