"""Whether a worker of this host is alive: each touches a file every few seconds, whose age tells.

Container engines ask every few seconds for each worker, so this imports next to nothing. And it asks no database, since
a worker that waits for one is alive. The file is a temporary one: with a database and a bucket, a worker needs no data
folder. As others may put anything beside it, it is in a folder that proves to be this user's.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import stat
import sys
import tempfile
import time
import zlib
from pathlib import Path

TOUCH_S = 2.0
SILENT_S = 15.0  # after which a worker counts as dead


def touch(data_dir: Path) -> None:
    """Note that a worker of this host is alive. Raises OSError."""
    folder = _own_folder() or Path(tempfile.mkdtemp(prefix=_prefix()))
    (folder / _name(data_dir)).touch()


def is_alive(data_dir: Path) -> bool:
    """Whether a worker of this host has touched its file lately."""
    folder = _own_folder()
    try:
        age_s = math.inf if folder is None else time.time() - (folder / _name(data_dir)).stat().st_mtime
    except OSError:
        return False
    return -SILENT_S < age_s < SILENT_S  # a file from the future proves nothing


def main() -> int:
    """Answer with the exit status: 0 if a worker is alive, otherwise 1."""
    if is_alive(Path(os.environ.get("SG_DATA_DIR", "").strip() or "data")):
        return 0
    print(f"no worker of {socket.gethostname()} has reported in the last {SILENT_S:g} s", file=sys.stderr)
    return 1


def _prefix() -> str:
    return f"sgmethod-{os.geteuid()}-"


def _own_folder() -> Path | None:
    """Return the first folder of this name that belongs to this user and to nobody else."""
    for folder in sorted(Path(tempfile.gettempdir()).glob(f"{_prefix()}*")):
        with contextlib.suppress(FileNotFoundError):
            found = folder.lstat()
            if stat.S_ISDIR(found.st_mode) and (found.st_uid, found.st_mode & 0o077) == (os.geteuid(), 0):
                return folder
    return None


def _name(data_dir: Path) -> str:
    service = zlib.crc32(os.fsencode(data_dir.absolute()))  # there may be several on this machine
    return f"{service:08x}-{socket.gethostname()}"
