"""Whether a worker of this host is alive: each touches a file every few seconds, whose age tells.

Container engines ask every few seconds for each worker, so this imports next to nothing. And it asks no database, since
a worker that waits for one is alive. The file is a temporary one: with a database and a bucket, a worker needs no data
folder.
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
import time
import zlib
from pathlib import Path

TOUCH_S = 2.0
SILENT_S = 15.0  # after which a worker counts as dead


def touch(data_dir: Path) -> None:
    """Note that a worker of this host is alive. Raises OSError."""
    file = _file(data_dir)
    try:
        os.utime(file)
    except FileNotFoundError:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        file.touch()


def is_alive(data_dir: Path) -> bool:
    """Whether a worker of this host has touched its file lately."""
    return -SILENT_S < _age_s(_file(data_dir)) < SILENT_S  # a file from the future proves nothing


def main() -> int:
    """Answer with the exit status: 0 if a worker is alive, otherwise 1."""
    if is_alive(Path(os.environ.get("SG_DATA_DIR", "").strip() or "data")):
        return 0
    print(f"no worker of {socket.gethostname()} has reported in the last {SILENT_S:g} s", file=sys.stderr)
    return 1


def _file(data_dir: Path) -> Path:
    service = zlib.crc32(os.fsencode(data_dir.absolute()))  # there may be several on this machine
    return Path(tempfile.gettempdir()) / f"sgmethod-{os.geteuid()}" / f"{service:08x}-{socket.gethostname()}"


def _age_s(file: Path) -> float:
    try:
        return time.time() - file.stat().st_mtime
    except OSError:
        return float("inf")
