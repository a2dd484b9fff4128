"""The commands of `python -m service`: serve, web, worker, check and retry."""

from __future__ import annotations

import argparse
import functools
import logging
import os
import signal
import socket
import sys
import tempfile
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, closing

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from service.errors import JobTableError, MissingPackagesError
from service.jobs.job import Job
from service.logs import set_up_logging
from service.opening import open_job_table, open_storage
from service.processes import StopSignal, is_loopback, listen, supervise, url
from service.sandbox.client import Sandbox, SandboxProcess, own_sandbox
from service.sandbox.confinement import SandboxError, absent_layers, check_layers, end_with
from service.settings import Settings, add_secrets, unknown_settings
from service.storage.files import UNFINISHED
from sgmethod.errors import SgError
from sgmethod.native import native

log = logging.getLogger(__name__)

BAD_SETTING = 2
TROUBLE = 1
INTERRUPTED = 128 + signal.SIGINT


def main() -> int:
    """Run one command. Exit status: 0 after a requested end, 2 for a bad setting, 1 for trouble, 130 for Ctrl-C."""
    arguments = _parser().parse_args()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # inherited; if ignored, children leave no status
    signal.signal(signal.SIGTERM, lambda _number, _frame: sys.exit())  # until the command sets its own handler
    try:
        add_secrets(os.environ)
        settings = Settings()
        native.best_isa()  # raises an SgError if there are no kernels
        set_up_logging(settings.log_format, settings.log_level)
    except ValidationError as error:
        for fault in error.errors():
            print(_explain(fault), file=sys.stderr)
        return BAD_SETTING
    except (OSError, SgError) as error:  # a file of a secret, or the kernels
        print(f"cannot start: {error}", file=sys.stderr)
        return TROUBLE
    supervisor = getattr(arguments, "supervisor", None)
    if supervisor is not None:
        end_with(supervisor, signal.SIGTERM)
    else:  # "serve" has printed it already
        unknown = unknown_settings(os.environ)
        _warn(settings, (f"{name} is not a setting of this service and has no effect" for name in unknown))
    try:
        run: Callable[[Settings, argparse.Namespace], int | None] = arguments.run
        return run(settings, arguments) or 0
    except (OSError, JobTableError, MissingPackagesError, SandboxError, SgError) as error:
        _say(settings, logging.ERROR, f"cannot start: {' '.join(str(error).split())}")
        return TROUBLE
    except KeyboardInterrupt:
        return INTERRUPTED


def _explain(fault: ErrorDetails) -> str:
    field = str(fault["loc"][0]) if fault["loc"] else ""
    what = fault["msg"].removeprefix("Value error, ")
    if fault["type"] == "string_pattern_mismatch":  # whose message is a regular expression
        what = f"not a value of this setting, {Settings.model_fields[field].description}"
    return f"SG_{field.upper()}: {what}" if field else what


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m service", description="The HTTP service of sgmethod.")
    commands = parser.add_subparsers(dest="command", required=True)
    serve = commands.add_parser("serve", help="run the web process and workers, and restart any that die")
    web = commands.add_parser("web", help="run only the web process")
    worker = commands.add_parser("worker", help="run a single worker")
    check = commands.add_parser("check", help="check settings, database, storage, disk, kernels and sandbox")
    retry = commands.add_parser("retry", help="put failed jobs back into the queue, while their images are kept")
    retry.add_argument("jobs", nargs="+", metavar="ID")
    runs = (serve, _serve), (web, _web), (worker, _worker), (check, _check), (retry, _retry)
    for command, run in runs:
        command.set_defaults(run=run)
    web.add_argument("--socket", type=int, help=argparse.SUPPRESS)
    for command in (web, worker):  # both are how "serve" starts its processes
        command.add_argument("--supervisor", type=int, help=argparse.SUPPRESS)
        command.add_argument("--sandbox", type=int, help=argparse.SUPPRESS)
    return parser


def _serve(settings: Settings, _arguments: argparse.Namespace) -> None:
    stop = StopSignal()
    stop.on_signals()
    absent = _before_start(settings)
    listener = _announce(settings)
    _warn(settings, check_layers(absent, required=False))
    sandbox = SandboxProcess(settings, absent)
    supervise(settings, listener, sandbox, sandbox.requests, stop)


def _before_start(settings: Settings) -> list[str]:
    """Open what the settings name, so that errors show here; return the layers that the sandbox lacks."""
    absent = absent_layers()  # before there is a second thread
    check_layers(absent, required=settings.require_sandbox)
    open_job_table(settings).close()
    open_storage(settings).check()
    return absent


def _web(settings: Settings, arguments: argparse.Namespace) -> None:
    from service.api.app import run_web

    absent = absent_layers()  # before there is a second thread
    given = arguments.socket
    with _sandbox(settings, arguments) as requests:
        listen = functools.partial(_announce, settings) if given is None else lambda: socket.socket(fileno=given)
        if not settings.storage_url:  # temporary files of uploads go where they will be stored, since /tmp may be small
            tempfile.tempdir = str(settings.data_dir.resolve() / UNFINISHED)
        run_web(settings, Sandbox(requests), absent, listen)


def _worker(settings: Settings, arguments: argparse.Namespace) -> int:
    from service.worker.loop import Worker

    stop = StopSignal()
    stop.on_signals()
    with _sandbox(settings, arguments) as requests:
        table = open_job_table(settings)
        ended_well = Worker(settings, table, open_storage(settings), Sandbox(requests), stop).run()
        table.close()
    return 0 if ended_well else TROUBLE


def _sandbox(settings: Settings, arguments: argparse.Namespace) -> AbstractContextManager[socket.socket]:
    """Return the socket for requests to the supervisor's sandbox, or to a sandbox of this process."""
    if arguments.sandbox is not None:
        return socket.socket(fileno=arguments.sandbox)
    absent = _before_start(settings)
    _warn(settings, check_layers(absent, required=False))
    return own_sandbox(settings, absent)


def _check(settings: Settings, _arguments: argparse.Namespace) -> int:
    from service.checking import check

    failures = 0
    for name, passed, detail in check(settings):
        print(f"{'ok    ' if passed else 'FAILED'}  {name}: {detail}", flush=True)
        failures += not passed
    return TROUBLE if failures else 0


def _retry(settings: Settings, arguments: argparse.Namespace) -> int:
    refused = 0
    with closing(open_job_table(settings)) as table:
        for job_id in arguments.jobs:
            if table.retry(job_id):
                print(f"{job_id}: queued again")
                continue
            refused += 1
            print(f"{job_id}: {_why_refused(table.get(job_id))}", file=sys.stderr)
    return TROUBLE if refused else 0


def _why_refused(job: Job | None) -> str:
    """Return why a job cannot be put back into the queue."""
    if job is None:
        return "there is no such job in this job table"
    if job.state != "failed":
        return f"it is {job.state}, not failed"
    return "its image was kept no longer than SG_SOURCE_RETENTION_S"


def _announce(settings: Settings) -> socket.socket:
    """Listen, and print where. Raises OSError, also for an address that others can reach while no key is needed."""
    listener = listen(settings)
    if not (is_loopback(listener) or settings.key_names or settings.host_names):
        listener.close()
        raise OSError(
            f"SG_HOST={settings.host}: others could post, list and delete jobs without a key; set SG_API_KEYS_FILE, or "
            "SG_HOST_NAMES to the names under which everyone may"
        )
    where = f"sgmethod service on {url(listener)}, {_where(settings)}, {_for_whom(settings, listener)}"
    _say(settings, logging.INFO, where)
    return listener


def _warn(settings: Settings, sentences: Iterable[str]) -> None:
    for sentence in sentences:
        _say(settings, logging.WARNING, sentence)


def _say(settings: Settings, level: int, sentence: str) -> None:
    """Print a line of the start, or log it where programs read the log."""
    if settings.log_format == "json":
        log.log(level, "%s", sentence)
    else:
        print(sentence, file=sys.stdout if level == logging.INFO else sys.stderr, flush=True)


def _for_whom(settings: Settings, listener: socket.socket) -> str:
    if keys := len(settings.key_names):
        return f"for {keys} API key{'s' * (keys > 1)}"
    is_local = is_loopback(listener) and not settings.host_names  # with names, a proxy may pass others on
    return "for this machine alone, without API keys" if is_local else "open to everyone who can reach it"


def _where(settings: Settings) -> str:
    """Describe where data is kept, without the database's address, which may contain a password."""
    folder = str(settings.data_dir.resolve())
    jobs, files = "PostgreSQL" if settings.uses_postgres else folder, settings.storage_url or folder
    return f"data in {folder}" if jobs == files else f"jobs in {jobs}, images and bitstreams in {files}"
