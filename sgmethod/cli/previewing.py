"""The command preview: pictures as short texts, printed or in a folder's manifest."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from sgmethod.budget import Budget
from sgmethod.cli import naming, paths
from sgmethod.cli.arguments import one_line
from sgmethod.cli.naming import PICTURES, Conversion
from sgmethod.cli.paths import STREAM, CommandError
from sgmethod.cli.several import SOME_FAILED, convert_all, outcomes, say_notes, tasks_of
from sgmethod.cli.terminal import silent_stderr
from sgmethod.errors import noted
from sgmethod.many.manifest import Manifest
from sgmethod.many.run import Run, Tally

if TYPE_CHECKING:
    from sgmethod.previews.preview import Preview


def run_preview(arguments: argparse.Namespace) -> int:
    """Run sgmethod preview."""
    _check(arguments)
    if arguments.output_dir is not None:
        manifest = Manifest(arguments.output_dir, {"preview": True, "bytes": arguments.bytes})
        conversions = naming.into_folder(arguments, PICTURES, naming.sg_beside, manifest.sources)
        paths.check_outputs([one.input for one in conversions], [one.target for one in conversions])
        with manifest:
            return convert_all(conversions, _preview, "made", arguments, manifest)
    listed = ([name] if name == STREAM else naming.files_of(name, PICTURES) for name in arguments.names)
    wanted = [Conversion.from_paths(source, STREAM) for names in listed for source in names]
    if len(wanted) > 1:
        if arguments.alt is not None:
            raise CommandError(f"--alt describes one picture, and {len(wanted)} were given")
        print_in_turn = partial(_print_in_turn, arguments, [one.input for one in wanted], {})
        tally = Run[Conversion]().finish(outcomes(tasks_of(wanted), _preview, arguments), print_in_turn)
        return SOME_FAILED if tally.failed else 0
    with paths.contents_of(wanted[0].input):
        outcome = _preview(wanted[0], arguments)
    say_notes(outcome, arguments)
    print(json.dumps(outcome.figures) if arguments.json else outcome.summary)
    return 0


def _check(arguments: argparse.Namespace) -> None:
    """Raise CommandError for options that do not go together, and BudgetError for a wrong size."""
    from sgmethod.previews.preview import checked_bytes

    checked_bytes(int(Budget("bytes", arguments.bytes).value))  # fail once, not for each picture
    into_page = arguments.html or arguments.element
    if into_page and (STREAM in arguments.names or arguments.output_dir is not None):
        raise CommandError("--html and --element cannot be combined with - or --output-dir")
    if arguments.alt is not None and not into_page:
        raise CommandError("--alt needs --html or --element")
    if arguments.resume and arguments.output_dir is None:
        raise CommandError("--resume needs --output-dir")


def _print_in_turn(
    arguments: argparse.Namespace,
    names: list[str],
    done: dict[str, list[Conversion]],
    outcome: Conversion,
    _tally: Tally,
) -> None:
    """Print the outcomes whose turn it is, in the order of `names`. names, done: still to be printed, emptied here."""
    done.setdefault(outcome.input, []).append(outcome)
    while names and done.get(names[0]):
        _print(arguments, done[names.pop(0)].pop())


def _print(arguments: argparse.Namespace, outcome: Conversion) -> None:
    """Print a line for one of several pictures, with its name; a failure on stderr."""
    say_notes(outcome, arguments)
    if outcome.error:
        print(f"sgmethod: {one_line(outcome.input)}: {one_line(outcome.error)}", file=sys.stderr)
    elif arguments.json:
        print(json.dumps({"input": outcome.input, **outcome.figures}), flush=True)
    elif arguments.html or arguments.element:
        print(outcome.summary, flush=True)
    else:
        print(f"{one_line(outcome.input)}\t{outcome.summary}", flush=True)


def _preview(conversion: Conversion, arguments: argparse.Namespace) -> Conversion:
    """Read and encode one picture; write the file if there is an output folder."""
    from sgmethod.previews.preview import preview

    image = paths.read(conversion.input)
    with silent_stderr(), noted() as notes:  # libtiff prints lines of its own
        made = preview(image, int(arguments.bytes))
    if conversion.target != STREAM:
        paths.write(conversion.target, made.data)
    summary = _summary(made, conversion, arguments)
    return replace(conversion, bytes=len(made.data), summary=summary, figures=made.to_dict(), notes=notes)


def _summary(made: Preview, conversion: Conversion, arguments: argparse.Namespace) -> str:
    from sgmethod.previews.preview import quoted

    if arguments.html:
        return made.html(quoted(conversion.input), arguments.alt or "")
    if arguments.element:
        return made.element(quoted(conversion.input), arguments.alt or "")
    if conversion.target == STREAM:
        return made.text
    return f"{made.width} x {made.height} pixels, {len(made.data):,} bytes"
