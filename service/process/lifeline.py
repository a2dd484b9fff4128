"""A pipe that tells a child process when its parent is gone, however the parent ended.

The parent alone holds the writing end and never writes; when it dies, even by kill -9, the system closes
that end and the child reads the end of the file.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable


class Lifeline:
    """The parent's side. Hand read_end to children through pass_fds."""

    def __init__(self) -> None:
        self.read_end, self._write_end = os.pipe()

    def close(self) -> None:
        """Let go of both ends: children see their parent as gone."""
        os.close(self._write_end)
        os.close(self.read_end)


def watch(read_end: int, on_parent_gone: Callable[[], None]) -> None:
    """The child's side: call on_parent_gone, in a thread of its own, once the parent is gone."""

    def wait() -> None:
        try:
            os.read(read_end, 1)
        finally:  # also if the pipe cannot be read: a process that nobody watches must not stay
            on_parent_gone()

    threading.Thread(target=wait, name="lifeline", daemon=True).start()
