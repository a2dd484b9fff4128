"""What the processes of the service write to standard error."""

from __future__ import annotations

import json
import logging
import time
from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Any, Literal

LogFormat = Literal["text", "json"]
LogLevel = Literal["debug", "info", "warning", "error"]
OURS = ("service", "access")  # whose lines have the chosen level; libraries tell of every byte at level debug
FIELDS = "fields"  # attribute of a record: a dictionary, whose entries are members of its JSON
FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
SELDOM_S = 60.0

# The id of the current request, inherited by the tasks and threads that it starts.
request_id: ContextVar[str] = ContextVar("request_id", default="")
_last_logged: dict[str, float] = {}  # monotonic seconds by message


def set_up_logging(kind: LogFormat = "text", level: LogLevel = "info") -> None:
    """Log to standard error from now on."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Json() if kind == "json" else _Lines(FORMAT))
    number = logging.getLevelNamesMapping()[level.upper()]
    logging.basicConfig(level=max(number, logging.INFO), handlers=[handler], force=True)
    for name in OURS:
        logging.getLogger(name).setLevel(number)


def log_seldom(log: logging.Logger, message: str, *values: object) -> None:
    """Log an error that may repeat, such as a full disk: the same message at most once a minute."""
    now = time.monotonic()
    if now - _last_logged.get(message, -SELDOM_S) >= SELDOM_S:
        _last_logged[message] = now
        log.error(message, *values)


def _time_of(record: logging.LogRecord) -> str:
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")


class _Json(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        head = {"time": _time_of(record), "level": record.levelname, "logger": record.name}
        members: dict[str, Any] = {**head, "message": record.getMessage(), **getattr(record, FIELDS, {})}
        if request_id.get():
            members["request_id"] = request_id.get()
        if record.exc_info:
            members["exception"] = self.formatException(record.exc_info)
        return json.dumps(members)


class _Lines(logging.Formatter):
    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:  # noqa: N802
        """Format the time in UTC, with its zone."""
        return _time_of(record)

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        """Format a record as one line, whatever a client or a task put into it. Tracebacks stay as they are."""
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return f"{text} [{request_id.get()}]" if request_id.get() else text
