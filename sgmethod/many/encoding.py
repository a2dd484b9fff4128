"""Encoding any number of pictures into a folder."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from sgmethod.budget import whole
from sgmethod.codec import encode
from sgmethod.errors import ImageWarning, SgError
from sgmethod.io.files import own_path
from sgmethod.io.inputs import Input
from sgmethod.many.manifest import Manifest, Row
from sgmethod.many.processes import KILLED, in_processes

MAX_JOBS = 256
Item = str | os.PathLike[str] | tuple[str, Input]


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


OnRow = Callable[[Row, Tally], None]


def encode_many(
    items: Iterable[Item],
    output_dir: str | os.PathLike[str],
    *,
    jobs: int = 1,
    resume: bool = False,
    on_row: OnRow | None = None,
    **options: Any,
) -> Tally:
    """Encode any number of pictures to output_dir/NAME.sg, with a manifest, output_dir/manifest.jsonl.

    items: paths of pictures, NAME being the file's without its suffix, or pairs (NAME, picture) with a picture as
    encode() takes it. They are taken one by one, and may come from a generator.
    jobs: pictures encoded at a time, 1 to 256, each in a process with its share of the threads. A script that asks for
    more than one needs `if __name__ == "__main__":`, as for every use of multiprocessing.
    resume: skip pictures that the manifest has, if their files are there, options and version are the same and, for
    paths, the picture's size and time; pictures in memory are known by name alone.
    on_row: called with each finished picture's line of the manifest, and with the run so far.
    options: of encode().

    A picture that cannot be encoded is a line with its error, and the rest goes on. Raises SgError for a name that is
    invalid or used twice and for a manifest that cannot be written, and OSError if the folder cannot be created.
    """
    processes = whole(jobs, "the number of jobs", 1, MAX_JOBS)
    folder = own_path(output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    tally = Tally(pictures=len(items) if isinstance(items, Sized) else None)
    with Manifest(folder, options) as manifest, ExitStack() as stack:
        skipped = _Skipped(manifest, resume)
        rows = _rows(partial(_encode_one, folder, options), skipped.rest(items), processes)
        for row in stack.enter_context(closing(rows)):
            manifest.add(row)
            encoded, failed = (1, 0) if row.error is None else (0, 1)
            tally = replace(
                tally,
                encoded=tally.encoded + encoded,
                skipped=skipped.count,
                failed=tally.failed + failed,
                bytes=tally.bytes + row.bytes,
                seconds=time.perf_counter() - began,
            )
            if on_row is not None:
                on_row(row, tally)
    return replace(tally, skipped=skipped.count, seconds=time.perf_counter() - began)


@dataclass(frozen=True)
class _Picture:
    """A picture to encode. row: what its line has before that."""

    picture: Input
    row: Row


class _Skipped:
    """Pictures without those that the manifest has, which are counted."""

    def __init__(self, manifest: Manifest, resume: bool) -> None:
        self.count = 0
        self._manifest, self._resume = manifest, resume
        self._names: set[str] = set()

    def rest(self, items: Iterable[Item]) -> Iterator[_Picture]:
        """Raises SgError for a name that is invalid or used twice."""
        for item in items:
            name, picture = item if isinstance(item, tuple) else (own_path(item).stem, item)
            if not isinstance(name, str) or not name or own_path(name).name != name:
                raise SgError(f"the name of a picture must be a file name without folders, got {name!r}")
            if name in self._names:
                raise SgError(f"two pictures are named {name!r}: give other names, as pairs (name, picture)")
            self._names.add(name)
            path = os.fsdecode(picture) if isinstance(picture, str | os.PathLike) else None
            row = Row(f"{name}.sg", path, key=self._manifest.key(path))
            if self._resume and self._manifest.has(row.name, row.key):
                self.count += 1
            else:
                yield _Picture(picture, row)


def _rows(
    encode_one: Callable[[_Picture], Row], pictures: Iterable[_Picture], processes: int
) -> Generator[Row, None, None]:
    if processes == 1:
        yield from map(encode_one, pictures)
        return
    with closing(in_processes(encode_one, pictures, processes)) as finished:
        for one, row in finished:
            yield replace(one.row, error=KILLED) if row is None else row


def _encode_one(folder: Path, options: dict[str, Any], one: _Picture) -> Row:
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ImageWarning)
            encoded = encode(one.picture, **options)
        encoded.save(folder / one.row.name)
    except MemoryError:
        return replace(one.row, error="out of memory")
    except (SgError, OSError) as error:
        return replace(one.row, error=str(error))
    notes = [str(warning.message) for warning in caught]
    return replace(one.row, bytes=len(encoded.data), figures=encoded.stats.to_dict(), notes=notes)
