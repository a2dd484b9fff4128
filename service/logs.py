"""What the processes of the service write to standard error."""

from __future__ import annotations

import logging
import time
from contextvars import ContextVar

FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
SELDOM_S = 60.0

# The id of the current request, inherited by the tasks and threads that it starts.
request_id: ContextVar[str] = ContextVar("request_id", default="")
_last_logged: dict[str, float] = {}  # monotonic seconds by message


def set_up_logging() -> None:
    """Log to standard error from now on."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Lines(FORMAT))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def log_seldom(log: logging.Logger, message: str, *values: object) -> None:
    """Log an error that may repeat, such as a full disk: the same message at most once a minute."""
    now = time.monotonic()
    if now - _last_logged.get(message, -SELDOM_S) >= SELDOM_S:
        _last_logged[message] = now
        log.error(message, *values)


class _Lines(logging.Formatter):
    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        """Format a record as one line, whatever a client or a task put into it. Tracebacks stay as they are."""
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in super().formatMessage(record))

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return f"{text} [{request_id.get()}]" if request_id.get() else text
