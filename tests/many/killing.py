"""What other processes do in these tests, without imports that take long."""

from __future__ import annotations

import os
import signal


def doubled(item: int) -> int:
    """Twice the item; a negative one is killed."""
    if item < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * item


class Killer:
    """A picture whose arrival kills a process, as one may for which memory runs out."""

    def __reduce__(self) -> tuple[object, ...]:
        return doubled, (-1,)
