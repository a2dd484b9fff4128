"""The command line: sgmethod encode, preview, decode, info and compare.

Exit status: 0 for success; 1 when some of several files failed; 2 when the command failed, with one line on stderr that
says why; 130 after Ctrl-C; 141 when the reader of stdout has gone. A file is written completely or not at all, and
outputs are checked before the work begins.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module

from sgmethod.errors import SgError

INTERRUPTED, NO_READER = 130, 141  # 128 + SIGINT, 128 + SIGPIPE (not defined on every system)
# Modules of commands; of info and compare, commands.py. Only one is imported: imports take most of a command's time.
MODULES = {"encode": "encoding", "preview": "previewing", "decode": "decoding"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit status. --help, --version and wrong usage exit instead."""
    began = time.perf_counter()  # before the slow imports
    ends_here = argv is None  # the process ends after this command
    if sys.stderr is None:  # print() would write to stdout, and the first file that is opened become descriptor 2
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    argv = sys.argv[1:] if argv is None else argv
    # Starting threads for numpy's linear algebra, which only encodes need, takes a third of a short command's time.
    threads = os.environ.get("SG_THREADS") if {"encode", "preview"}.intersection(argv[:1]) else "1"
    if threads:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", threads)
    try:
        arguments = _parse(argv)
        arguments.began = began
        _check_threads()
        module = import_module(f"sgmethod.cli.{MODULES.get(arguments.run, 'commands')}")
        run: Callable[[argparse.Namespace], int] = getattr(module, f"run_{arguments.run}")
        status = run(arguments)
        print(end="", flush=True)
    except BrokenPipeError:
        _abandon_stdout()
        return NO_READER
    except KeyboardInterrupt as error:
        print(f"sgmethod: interrupted{''.join(f': {words}' for words in error.args)}", file=sys.stderr)
        return INTERRUPTED
    except MemoryError:
        return _fail("out of memory")
    except SgError as error:
        return _fail(str(error))
    except OSError as error:
        _abandon_stdout()
        return _fail(str(error) if error.filename else error.strerror or str(error))
    if ends_here:
        gc.freeze()  # saves a collection of all imported objects at exit, which takes longer than a decode
    return status


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    from sgmethod.cli.arguments import parse

    with suppress(AttributeError):  # file names need not be valid text; stderr already escapes those
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        return parse(argv)
    except SystemExit:
        print(end="", flush=True)  # the text of --help or --version, which nobody may read
        raise


def _check_threads() -> None:
    """Raise CommandError for an invalid SG_THREADS, which the kernels would silently ignore."""
    if text := os.environ.get("SG_THREADS"):
        from sgmethod.cli.paths import CommandError
        from sgmethod.threads import MAX_THREADS

        # float() takes any number of digits; int() refuses more than 4,300.
        if not (text.isascii() and text.isdecimal() and 1 <= float(text) <= MAX_THREADS):
            raise CommandError(f"SG_THREADS must be a whole number from 1 to {MAX_THREADS}, not {text[:40]!r}")


def _abandon_stdout() -> None:
    """Discard the rest of stdout's buffer, on which the interpreter would fail again at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fail(message: str) -> int:
    from sgmethod.cli.arguments import BAD_INPUT, one_line

    with suppress(OSError):  # nobody can be told
        print(f"sgmethod: {one_line(message)}", file=sys.stderr)
    return BAD_INPUT
