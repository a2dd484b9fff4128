"""Source images and bitstreams in a local folder.

A file appears under its key only when all of its bytes are on the disk: write_atomically holds that.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from service.storage.files import FOLDERS, UNFINISHED, check_key, is_key
from sgmethod.io.files import sync_folder, write_atomically


class DiskStorage:
    """Storage in a local folder, which is created if need be, readable by its owner alone."""

    def __init__(self, root: Path) -> None:
        self._root = root
        for folder in (*FOLDERS, UNFINISHED):
            (root / folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        sync_folder(root)

    def _path(self, key: str) -> Path:
        return self._root / check_key(key)

    def put(self, key: str, data: bytes) -> None:
        write_atomically(self._path(key), data, unfinished=self._root / UNFINISHED)

    def get(self, key: str) -> bytes:
        return self._path(key).read_bytes()

    def open(self, key: str) -> BinaryIO:
        return self._path(key).open("rb")

    def delete(self, key: str) -> None:
        self._path(key).unlink(missing_ok=True)

    def check(self) -> None:
        for folder in (*FOLDERS, UNFINISHED):
            (self._root / folder).stat()

    def free_bytes(self) -> int | None:
        return shutil.disk_usage(self._root).free

    def old(self, age_s: float) -> Iterator[str]:
        oldest = time.time() - age_s
        for folder in (*FOLDERS, UNFINISHED):
            for path in (self._root / folder).iterdir():
                key = f"{folder}/{path.name}"
                with contextlib.suppress(FileNotFoundError):  # another process finished with it meanwhile
                    if is_key(key) and path.stat().st_mtime < oldest:
                        yield key
