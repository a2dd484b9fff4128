"""What other processes do in these tests, without imports that take long."""

from __future__ import annotations

import os
import signal
from ctypes import c_byte
from pathlib import Path


def doubled(item: int) -> int:
    """Twice the item; a negative one is killed."""
    if item < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * item


def begun_and_killed(_threads: int, begun: c_byte, _watched: object) -> None:
    """Begin a process, and end it."""
    begun.value = 1
    os.abort()


def killed_once(folder: Path, item: int) -> int:
    """Twice the item; at the first call for 3 the process is killed."""
    if item == 3 and not (folder / "killed").exists():
        (folder / "killed").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * item
