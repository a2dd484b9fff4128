"""A run over many pictures: it resumes, records each file or its error, and counts.

Callers supply the tasks, and the function that makes a file of each.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from sgmethod.errors import SgError
from sgmethod.many.manifest import Manifest, Row
from sgmethod.many.processes import ENDED, in_processes


@dataclass(frozen=True)
class Tally:
    """Progress of a run. files: how many there will be, one for each picture or shard; None if unknown.

    seconds: wall time.
    """

    encoded: int = 0
    skipped: int = 0
    failed: int = 0
    bytes: int = 0
    seconds: float = 0.0
    files: int | None = None

    @property
    def per_second(self) -> float:
        """Finished files a second, without those skipped."""
        return (self.encoded + self.failed) / self.seconds if self.seconds else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Estimated time left; None if unknown."""
        if self.files is None or not self.per_second:
            return None
        return (self.files - self.encoded - self.skipped - self.failed) / self.per_second

    def with_row(self, row: Row, seconds: float) -> Tally:
        """Return the tally with one more row."""
        failed = row.error is not None
        encoded, bytes = self.encoded + (not failed), self.bytes + row.bytes
        return replace(self, encoded=encoded, failed=self.failed + failed, bytes=bytes, seconds=seconds)


AnyRow = TypeVar("AnyRow", bound=Row)
Made = TypeVar("Made")
OnRow = Callable[[AnyRow, Tally], None]


@dataclass(frozen=True)
class Task(Generic[AnyRow]):
    """A picture to make a file of, and its row so far."""

    picture: Any
    row: AnyRow


Make = Callable[[Task[AnyRow]], AnyRow]
Finished = Generator[AnyRow, None, None]


class Run(Generic[AnyRow]):
    """A run that notes its rows in a manifest, if it has one. files: how many there will be, if known."""

    def __init__(self, manifest: Manifest | None = None, resume: bool = False, files: int | None = None) -> None:
        self._manifest, self._resume = manifest, resume
        self._began, self._tally = time.perf_counter(), Tally(files=files)

    def rest(self, tasks: Iterable[Task[AnyRow]]) -> Iterator[Task[AnyRow]]:
        """Yield tasks with their keys. If the run resumes another, skip those that are done, and take failed ones last.

        One may have ended the other run, and would end each that meets it first.
        """
        failed = list[Task[AnyRow]]()
        for task in tasks:
            if self._manifest is None:
                yield task
                continue
            row = replace(task.row, key=self._manifest.key(task.row.input))
            if self._resume and self._manifest.has(row.name, row.key):
                self._tally = replace(self._tally, skipped=self._tally.skipped + 1)
            elif self._resume and row.name in self._manifest.failed:
                failed.append(replace(task, row=row))
            else:
                yield replace(task, row=row)
        yield from failed

    def finish(self, finished: Finished[AnyRow], on_row: OnRow[AnyRow] | None = None) -> Tally:
        """Note each row as it comes, and return the totals. Raises SgError if the manifest cannot be written."""
        with closing(finished):
            for row in finished:
                if self._manifest is not None:
                    self._manifest.add(row)
                self._tally = self._tally.with_row(row, time.perf_counter() - self._began)
                if on_row is not None:
                    on_row(row, self._tally)
        return replace(self._tally, seconds=time.perf_counter() - self._began)


def finish_locally(make: Make[AnyRow], tasks: Iterable[Task[AnyRow]], jobs: int) -> Finished[AnyRow]:
    """Finish tasks on this machine: one after the other, or several at a time in processes of their own."""
    if jobs <= 1:
        yield from map(make, tasks)
        return
    for task, row in in_processes(make, tasks, jobs):
        yield replace(task.row, error=ENDED) if row is None else row


def caught(make: Make[AnyRow], task: Task[AnyRow]) -> AnyRow:
    """Finish a task; a file that cannot be made is a row with its error."""
    made = made_or_error(make, task)
    if isinstance(made, SgError):
        return replace(task.row, error=str(made))
    if isinstance(made, Exception):
        raise made
    return made


def made_or_error(make: Callable[[Any], Made], picture: Any) -> Made | Exception:
    """Return what is made of a picture, or an error: an SgError if the picture alone fails by it."""
    try:
        return make(picture)
    except MemoryError:
        return SgError("out of memory")
    except Exception as error:
        return SgError(str(error)) if isinstance(error, SgError | OSError) else error
