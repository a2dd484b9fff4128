"""Background work that goes on whatever happens to one of its rounds."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

log = logging.getLogger(__name__)

failures: Counter[str] = Counter()  # of this process, by what has failed; /metrics shows their sum


@contextmanager
def survived(what: str) -> Iterator[None]:
    """Log and count an exception that nobody foresaw, so that the thread or task goes on with its next round.

    Wrap one round of a loop in it. A thread or task that ends by an exception otherwise ends in silence.
    """
    try:
        yield
    except Exception:
        failures[what] += 1
        log.exception("%s failed unexpectedly and will be tried again", what)
