"""Background work that goes on whatever happens to one of its rounds."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from service.logs import log_seldom

log = logging.getLogger(__name__)

failures: Counter[str] = Counter()  # of this process, by what has failed; /metrics shows their sum


@contextmanager
def survived(what: str, *foreseen: type[Exception]) -> Iterator[None]:
    """Log an exception, so that the thread or task goes on with its next round; one that nobody foresaw is counted.

    Wrap one round of a loop in it. A thread or task that ends by an exception otherwise ends in silence.
    """
    try:
        yield
    except foreseen as error:
        log_seldom(log, f"{what} has to wait: %s", error)
    except Exception:
        failures[what] += 1
        log.exception("%s failed unexpectedly and will be tried again", what)
