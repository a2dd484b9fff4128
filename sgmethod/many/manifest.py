"""The manifest of a folder: one line of JSON for each finished picture.

    {"name": "a.sg", "input": "photos/a.png", "bytes": 1210, "figures": {...}, "notes": [], "error": null, "key": "..."}

Lines are only appended; the last line of a name counts. A line is written after its file, so a file without a line is
made again, with the same bytes.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from sgmethod.errors import SgError

FILE = "manifest.jsonl"
CALLBACK = "on_progress"  # the option that does not change the bytes
BEGINNING = b'{"name": '  # of every line


@dataclass(frozen=True)
class Row:
    """A line of the manifest.

    name: file name in the folder; input: path of the picture, None for one in memory; figures: as in Stats.to_dict();
    notes: on anything dropped from the picture; key: see Manifest.key().
    """

    name: str
    input: str | None
    bytes: int = 0
    figures: Mapping[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    error: str | None = None
    key: str = ""


def text_of(options: Mapping[str, object]) -> str:
    """Return the options that decide the bytes, as text."""
    return repr(sorted(option for option in options.items() if option[0] != CALLBACK))


class Manifest:
    """The manifest of a folder, for a run with these options: read at once, and open for writing as a context.

    sources: by name, the file name of the picture that a file was made from; empty for one in memory; failed: names.
    Raises SgError if it cannot be written, or is another file of that name.
    """

    def __init__(self, folder: str | os.PathLike[str], options: Mapping[str, object]) -> None:
        self._folder, self._path = Path(folder), Path(folder) / FILE
        self._asked = f"{version('sgmethod')} {text_of(options)}"
        self._made: dict[str, tuple[str, int]] = {}  # keys and sizes by name
        self.sources: dict[str, str] = {}
        self.failed: set[str] = set()
        self._torn_at: int | None = None
        self._read()

    def __enter__(self) -> Manifest:
        # Each line is one write: if that is killed in the middle, no other line is touched.
        with self._errors_named():
            self._file = self._path.open("ab", buffering=0)
            if self._torn_at is not None:
                self._file.truncate(self._torn_at)
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _read(self) -> None:
        end = 0
        with self._errors_named(), self._lines() as lines:
            for number, line in enumerate(lines, 1):
                written = line.rstrip(b"\0")  # left by a power cut if the line has not reached the disk
                if not written.startswith(BEGINNING[: len(written)]):
                    raise SgError(f"{self._path} is not a manifest of sgmethod (line {number}): move it away")
                if not line.endswith(b"\n"):
                    self._torn_at = end  # its writer was killed
                    return
                end += len(line)
                try:
                    row = json.loads(line)
                    name, made, source = row["name"], (row["key"], row["bytes"]), row["input"] or ""
                    if row["error"] is None:
                        self._made[name], self.sources[name] = made, Path(source).name
                        self.failed.discard(name)
                    else:
                        self._made.pop(name, None)  # the file of an earlier run stays, and so does whose it is
                        self.failed.add(name)
                except (ValueError, KeyError, TypeError) as error:
                    raise SgError(f"{self._path} is damaged in line {number}: remove that line") from error

    def _lines(self) -> BinaryIO:
        try:
            return self._path.open("rb")
        except (FileNotFoundError, NotADirectoryError):  # which the folder's creation reports
            return BytesIO()

    def key(self, source: str | None) -> str:
        """Hash what decides the bytes: version, options, the picture's size and time. Empty for a missing picture."""
        try:
            seen = None if source is None else Path(source).stat()
        except (OSError, ValueError):
            return ""
        identity = "" if seen is None else f"{seen.st_size} {seen.st_mtime_ns}"
        return hashlib.sha256(f"{self._asked} {identity}".encode()).hexdigest()[:16]

    def has(self, name: str, key: str) -> bool:
        """Whether the file was made with this key and is there."""
        made = self._made.get(name)
        try:
            return made is not None and made == (key, (self._folder / name).stat().st_size)
        except OSError:
            return False

    def add(self, row: Row) -> None:
        """Append a line. Raises SgError."""
        values = {field.name: getattr(row, field.name) for field in fields(Row)}
        line = json.dumps(values, allow_nan=False).encode() + b"\n"
        with self._errors_named():
            if self._file.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise SgError(f"cannot write {self._path}: {error.strerror or error}") from error
