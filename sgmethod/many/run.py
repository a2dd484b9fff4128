"""A run over any number of pictures: which are skipped, a line of the manifest for each other, and how far it is."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sized
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sgmethod.errors import SgError
from sgmethod.io.files import checked_path, write_atomically
from sgmethod.io.inputs import Input
from sgmethod.many.manifest import Manifest, Row

Item = str | os.PathLike[str] | tuple[str, Input]
Made = tuple[bytes, Mapping[str, Any], list[str]]  # a file, its figures, what was dropped from the picture


@dataclass(frozen=True)
class Tally:
    """A run so far. pictures: how many there are in all, None if that is not known; seconds: wall time."""

    encoded: int = 0
    skipped: int = 0
    failed: int = 0
    bytes: int = 0
    seconds: float = 0.0
    pictures: int | None = None

    @property
    def per_second(self) -> float:
        """Finished pictures a second, without those skipped."""
        return (self.encoded + self.failed) / self.seconds if self.seconds else 0.0

    @property
    def seconds_left(self) -> float | None:
        """The estimated time left, None if it is not known."""
        if self.pictures is None or not self.per_second:
            return None
        return (self.pictures - self.encoded - self.skipped - self.failed) / self.per_second

    def with_row(self, row: Row, skipped: int, seconds: float) -> Tally:
        """One more line."""
        encoded, failed = (1, 0) if row.error is None else (0, 1)
        return Tally(
            self.encoded + encoded, skipped, self.failed + failed, self.bytes + row.bytes, seconds, self.pictures
        )


OnRow = Callable[[Row, Tally], None]


@dataclass(frozen=True)
class Picture:
    """A picture to encode. row: what its line has before that."""

    picture: Input
    row: Row


class _Rest:
    """Pictures without those that the manifest has, which are counted as skipped."""

    def __init__(self, manifest: Manifest, resume: bool) -> None:
        self.skipped = 0
        self._manifest, self._resume = manifest, resume
        self._names: set[str] = set()

    def of(self, items: Iterable[Item]) -> Iterator[Picture]:
        """Raises SgError for a name that is invalid or used twice."""
        for item in items:
            name, picture = item if isinstance(item, tuple) else (checked_path(item).stem, item)
            if not isinstance(name, str) or not name or checked_path(name).name != name:
                raise SgError(f"the name of a picture must be a file name without folders, got {name!r}")
            if name in self._names:
                raise SgError(f"two pictures are named {name!r}: give other names, as pairs (name, picture)")
            self._names.add(name)
            path = os.fsdecode(picture) if isinstance(picture, str | os.PathLike) else None
            row = Row(f"{name}.sg", path, key=self._manifest.key(path))
            if self._resume and self._manifest.has(row.name, row.key):
                self.skipped += 1
            else:
                yield Picture(picture, row)


def run(
    items: Iterable[Item],
    output_dir: str | os.PathLike[str],
    options: Mapping[str, object],
    finish: Callable[[Path, Iterator[Picture]], Generator[Row, None, None]],
    resume: bool,
    on_row: OnRow | None,
) -> Tally:
    """Skip, finish and note pictures. options: what decides the files, besides the pictures; finish: writes the files
    of pictures into a folder and yields their lines. Raises SgError, OSError, as encode_many()."""
    folder = checked_path(output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    tally = Tally(pictures=len(items) if isinstance(items, Sized) else None)
    with Manifest(folder, options) as manifest:
        rest = _Rest(manifest, resume)
        with closing(finish(folder, rest.of(items))) as rows:
            for row in rows:
                manifest.add(row)
                tally = tally.with_row(row, rest.skipped, time.perf_counter() - began)
                if on_row is not None:
                    on_row(row, tally)
    return replace(tally, skipped=rest.skipped, seconds=time.perf_counter() - began)


def made(make: Callable[[Any], Made], folder: Path, one: Picture) -> Row:
    """The line of a picture, after its file is written or its error is caught."""
    try:
        data, figures, notes = make(one.picture)
        write_atomically(folder / one.row.name, data)
    except MemoryError:
        return replace(one.row, error="out of memory")
    except (SgError, OSError) as error:
        return replace(one.row, error=str(error))
    return replace(one.row, bytes=len(data), figures=figures, notes=notes)
