"""The interface of a storage, the keys of its files, and the storage in a local folder.

Keys are made from a job's id and an attempt. No name from a client ever becomes a path.
"""

from __future__ import annotations

import errno
import logging
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Protocol

from sgmethod.io.files import sync_folder, write_atomically

log = logging.getLogger(__name__)

UNFINISHED = "unfinished"  # files that are being written, and probes
FOLDERS = ("sources", "bitstreams", UNFINISHED)
LATEST = 10  # attempts whose files go with their job
_KEY = re.compile(rf"(sources|{UNFINISHED})/[0-9a-f]{{32}}|bitstreams/[0-9a-f]{{32}}\.[0-9]{{1,9}}\.sg")


def source_key(job_id: str) -> str:
    """Return the key of a job's source image."""
    return f"sources/{job_id}"


def bitstream_key(job_id: str, attempt: int) -> str:
    """Return the key of an attempt's bitstream. Two attempts at one job never share a file."""
    return f"bitstreams/{job_id}.{attempt}.sg"


def keys_of(job_id: str, attempts: int) -> list[str]:
    """Return the keys of the files that a job with so many attempts may have: a killed worker leaves its own behind.

    Only of the LATEST attempts, as a storage that was away for hours leaves thousands: the sweep finds older files.
    """
    latest = range(max(0, attempts - LATEST) + 1, attempts + 1)
    return [source_key(job_id), *(bitstream_key(job_id, attempt) for attempt in latest)]


def job_of_key(key: str) -> str:
    """Return the id of the job that a file belongs to."""
    return key.partition("/")[2].partition(".")[0]


def is_key(text: str) -> bool:
    """Whether the service created files of this name. Other files in a folder or bucket are left alone."""
    return _KEY.fullmatch(text) is not None


def check_key(key: str) -> str:
    """Return the key. Raises ValueError if is_key() is False."""
    if not is_key(key):
        raise ValueError(f"not a storage key: {key!r}")
    return key


def discard(storage: Storage, key: str) -> bool:
    """Remove a file that no job needs. False if that fails: a later sweep removes it."""
    try:
        storage.delete(key)
    except OSError as error:
        log.warning("%s cannot be removed: %s", key, error)
        return False
    return True


class Storage(Protocol):
    """Files under keys. Methods raise OSError."""

    def put(self, key: str, data: bytes | memoryview) -> None:
        """Store data. When this returns, it survives a power cut. Raises OSError."""

    def open(self, key: str) -> BinaryIO:
        """Open the stored bytes as a file. Raises FileNotFoundError."""

    def delete(self, key: str) -> None:
        """Remove the file if it exists."""

    def check(self) -> None:
        """Raise OSError if the storage cannot be reached, or is known to take no files."""

    def free_bytes(self) -> int | None:
        """Return the free space; None if it cannot be known. Raises OSError."""

    def old(self, age_s: float, since: float = 0) -> Iterator[str]:
        """Yield the keys of files stored more than age_s seconds ago, and of incomplete files of that age.

        since: seconds since the epoch; files stored before are left out.
        """


class DiskStorage:
    """Storage in a local folder, which is created if need be, readable by its owner alone.

    A file appears under its key only when all its bytes are on disk, which write_atomically() guarantees.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        for folder in FOLDERS:
            (root / folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        sync_folder(root)

    def _path(self, key: str) -> Path:
        return self._root / check_key(key)

    def put(self, key: str, data: bytes | memoryview) -> None:
        write_atomically(self._path(key), data, unfinished=self._root / UNFINISHED)

    def open(self, key: str) -> BinaryIO:
        return self._path(key).open("rb")

    def delete(self, key: str) -> None:
        self._path(key).unlink(missing_ok=True)

    def check(self) -> None:
        for folder in FOLDERS:
            (self._root / folder).stat()
        probe = self._path(f"{UNFINISHED}/{secrets.token_hex(16)}")
        try:
            probe.touch(mode=0o600)  # fails on a disk that has become read-only
        except OSError as error:
            if error.errno != errno.ENOSPC:  # a full disk, which free_bytes() reports
                raise
        probe.unlink(missing_ok=True)

    def free_bytes(self) -> int | None:
        return shutil.disk_usage(self._root).free

    def old(self, age_s: float, since: float = 0) -> Iterator[str]:
        until = time.time() - age_s
        for folder in FOLDERS:
            for path in (self._root / folder).iterdir():
                key = f"{folder}/{path.name}"
                try:
                    if is_key(key) and since <= path.stat().st_mtime < until:
                        yield key
                except FileNotFoundError:  # another process removed it meanwhile
                    continue
                except OSError as error:
                    log.warning("%s cannot be looked at: %s", key, error)
