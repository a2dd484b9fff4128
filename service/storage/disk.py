"""Source images and bitstreams under keys, on disk unless told otherwise: whole or absent.

A file appears under its key only when every byte is safe: temporary file, fsync, rename, fsync of the
folder. Keys are ours (job id and attempt); nothing a client names ever becomes a path.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Protocol

from sgmethod.io.files import sync_folder, write_atomically

_UNFINISHED = "unfinished"
_KEY = re.compile(rf"(sources|{_UNFINISHED})/[0-9a-f]{{32}}|bitstreams/[0-9a-f]{{32}}\.[0-9]{{1,9}}\.sg")
_FOLDERS = ("sources", "bitstreams")
PROBE_FOLDER = _UNFINISHED  # where a file may be put to see whether it can be


def source_key(job_id: str) -> str:
    """Where a job's source image lies."""
    return f"sources/{job_id}"


def bitstream_key(job_id: str, attempt: int) -> str:
    """Where an attempt puts its bitstream; two attempts at one job never share a file."""
    return f"bitstreams/{job_id}.{attempt}.sg"


def check_key(key: str) -> str:
    """The key itself. Raises ValueError if it is none of ours."""
    if _KEY.fullmatch(key) is None:
        raise ValueError(f"not a storage key: {key!r}")
    return key


class Storage(Protocol):
    """Files under keys. Trouble raises OSError."""

    def put(self, key: str, data: bytes) -> None:
        """Store data; when this returns it survives a power cut. Raises OSError."""
        ...

    def get(self, key: str) -> bytes:
        """The stored bytes. Raises FileNotFoundError."""
        ...

    def open(self, key: str) -> BinaryIO:
        """The stored bytes as an open file. Raises FileNotFoundError."""
        ...

    def delete(self, key: str) -> None:
        """Remove the file; one that is not there is no error."""
        ...

    def check(self) -> None:
        """Whether the storage can be reached at all. Raises OSError if not."""
        ...

    def old(self, age_s: float) -> Iterator[str]:
        """The keys of what was stored longer ago than that (seconds), and of what was never stored whole."""
        ...


class DiskStorage:
    """Storage in a local folder, which is created if need be, readable by its owner alone."""

    def __init__(self, root: Path) -> None:
        self._root = root
        for folder in (*_FOLDERS, _UNFINISHED):
            (root / folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        sync_folder(root)

    def _path(self, key: str) -> Path:
        return self._root / check_key(key)

    def put(self, key: str, data: bytes) -> None:
        write_atomically(self._path(key), data, unfinished=self._root / _UNFINISHED)

    def get(self, key: str) -> bytes:
        return self._path(key).read_bytes()

    def open(self, key: str) -> BinaryIO:
        return self._path(key).open("rb")

    def delete(self, key: str) -> None:
        self._path(key).unlink(missing_ok=True)

    def check(self) -> None:
        for folder in (*_FOLDERS, _UNFINISHED):
            (self._root / folder).stat()

    def old(self, age_s: float) -> Iterator[str]:
        oldest = time.time() - age_s
        for folder in (*_FOLDERS, _UNFINISHED):
            for path in (self._root / folder).iterdir():
                with contextlib.suppress(FileNotFoundError):  # another process finished with it meanwhile
                    if path.stat().st_mtime < oldest:
                        yield f"{folder}/{path.name}"
