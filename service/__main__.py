"""The command line: python -m service serve | web | worker."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import socket
import sys

from pydantic import ValidationError

from service import lifeline
from service.backends import open_backend, open_storage
from service.jobs import BackendError
from service.listening import is_loopback, listen, url
from service.settings import Settings
from service.stopping import StopSignal

BAD_SETTING = 2
CANNOT_START = 1


def main() -> int:
    """Run one command. Exit status: 0 after a wished end, 2 for a bad setting, 1 for trouble at start."""
    arguments = _parser().parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    try:
        settings = Settings()
    except ValidationError as error:
        for fault in error.errors():
            name = f"SG_{fault['loc'][0]}: ".upper() if fault["loc"] else ""
            print(f"{name}{fault['msg']}", file=sys.stderr)
        return BAD_SETTING
    try:
        _COMMANDS[arguments.command](settings, arguments)
    except (OSError, BackendError) as error:
        print(f"cannot start: {error}", file=sys.stderr)
        return CANNOT_START
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m service", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("serve", help="run web process and workers, and replace those that die")
    web = commands.add_parser("web", help="run the web process alone")
    worker = commands.add_parser("worker", help="run one worker alone")
    web.add_argument("--socket", type=int, help=argparse.SUPPRESS)
    for command in (web, worker):  # both are how "serve" starts its processes
        command.add_argument("--lifeline", type=int, help=argparse.SUPPRESS)
    return parser


def _serve(settings: Settings, _arguments: argparse.Namespace) -> None:
    from service.supervisor import supervise

    stop = StopSignal()
    stop.on_signals()
    open_backend(settings).close()  # trouble with the folder shows here, not as processes that keep dying
    supervise(settings, _announce(settings), stop)


def _web(settings: Settings, arguments: argparse.Namespace) -> None:
    from service.web import run_web

    if arguments.lifeline is not None:
        lifeline.watch(arguments.lifeline, lambda: os.kill(os.getpid(), signal.SIGTERM))
    given = arguments.socket
    run_web(settings, _announce(settings) if given is None else socket.socket(fileno=given))


def _worker(settings: Settings, arguments: argparse.Namespace) -> None:
    from service.worker import Worker

    stop = StopSignal()
    stop.on_signals()
    if arguments.lifeline is not None:
        lifeline.watch(arguments.lifeline, stop.request)
    backend = open_backend(settings)
    Worker(settings, backend, open_storage(settings), stop).run()
    backend.close()


def _announce(settings: Settings) -> socket.socket:
    """Listen, and say where."""
    listener = listen(settings)
    print(f"sgmethod service on {url(listener)}, data in {settings.data_dir.resolve()}", flush=True)
    if not is_loopback(listener) and not settings.key_names:
        warning = "anyone who reaches this address can post, list and delete jobs: set SG_API_KEYS"
        print(warning, file=sys.stderr, flush=True)
    return listener


_COMMANDS = {"serve": _serve, "web": _web, "worker": _worker}

if __name__ == "__main__":
    sys.exit(main())
