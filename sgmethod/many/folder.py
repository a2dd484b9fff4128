"""Files of a caller's pictures in a folder that has a manifest."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from concurrent.futures import BrokenExecutor, Future
from dataclasses import replace
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

from sgmethod.errors import SgError
from sgmethod.io.files import checked_path, write_atomically
from sgmethod.io.image import Input
from sgmethod.many.manifest import Manifest, Row
from sgmethod.many.names import Names
from sgmethod.many.processes import as_they_finish
from sgmethod.many.run import Finished, OnRow, Run, Tally, Task, caught

Item = str | os.PathLike[str] | tuple[str, Input]
Made = tuple[bytes, Mapping[str, Any], list[str]]  # a file, its figures, what was dropped from the picture


def into_folder(
    items: Iterable[Item],
    output_dir: str | os.PathLike[str],
    options: Mapping[str, object],
    finish: Callable[[Path, Iterator[Task[Row]]], Finished[Row]],
    resume: bool,
    on_row: OnRow[Row] | None,
) -> Tally:
    """Make files of pictures in a folder that has a manifest.

    options: everything besides the pictures that decides the files; finish: writes the files of tasks into a folder.
    Raises SgError and OSError, as encode_many() does.
    """
    if isinstance(items, str | bytes | os.PathLike):  # a text would be taken for paths of one character each
        raise SgError(f"pictures are given as a list, such as [{items!r}]")
    folder = checked_path(output_dir)
    folder.mkdir(parents=True, exist_ok=True)
    with Manifest(folder, options) as manifest:
        run = Run[Row](manifest, resume, len(items) if isinstance(items, Sized) else None)
        return run.finish(finish(folder, run.rest(_tasks(items, folder, manifest.sources))), on_row)


def _tasks(items: Iterable[Item], folder: Path, before: Mapping[str, str]) -> Iterator[Task[Row]]:
    """Yield a task for each picture. Raises SgError for a name that is invalid or used twice."""
    names = Names(folder, before)
    for item in items:
        name, picture = item if isinstance(item, tuple) else (checked_path(item).stem, item)
        if not isinstance(name, str) or not name or checked_path(name).name != name:
            raise SgError(f"the name of a picture must be a file name without folders, got {name!r}")
        path = os.fsdecode(picture) if isinstance(picture, str | os.PathLike) else None
        try:
            if isinstance(item, tuple):
                file_name = names.take(f"the picture {name!r}", f"{name}.sg")
            else:
                file_name = names.take(os.fsdecode(item), f"{name}.sg", f"{checked_path(item).name}.sg")
        except SgError as error:
            raise SgError(f"{error}: give other names, as pairs (name, picture)") from None
        yield Task(picture, Row(file_name, path))


def finish_elsewhere(
    begin: Callable[[Task[Row]], Future[Made | Exception]], folder: Path, tasks: Iterable[Task[Row]], limit: int
) -> Finished[Row]:
    """Write files into a folder as they are made elsewhere, at most `limit` at a time.

    They are written here: what outlives the run must not replace the files of the next one. Errors of making a file are
    results of futures, and what a future raises is the executor's. A lost connection ends the run at once. If the
    executor breaks, all pictures that it has are recorded first, as it does not say which one broke it. Any other error
    is recorded with its picture, such as that of a cancelled task.
    """
    broken: BrokenExecutor | None = None
    made: Made | Exception
    until_then = takewhile(lambda _: broken is None, tasks)
    for task, future in as_they_finish(partial(_begun, begin), until_then, limit):
        try:
            made = future.result()
        except OSError as error:
            raise SgError(f"the executor has failed: {error}; run again, and resume") from error
        except BrokenExecutor as error:
            broken, made = error, SgError(f"the executor broke while it had the picture: {error}")
        except Exception as error:
            made = SgError(f"the executor gave no result: {error!r}")
        yield caught(partial(written, partial(_given, made), folder), task)
    if broken is not None:
        raise SgError(f"the executor has broken: {broken}; run again with another one, and resume") from broken


def _begun(begin: Callable[[Task[Row]], Future[Made | Exception]], task: Task[Row]) -> Future[Made | Exception]:
    try:
        return begin(task)
    except (BrokenExecutor, OSError) as error:
        future = Future[Made | Exception]()
        future.set_exception(error)
        return future


def _given(made: Made | Exception, _: Any) -> Made:
    if isinstance(made, Exception):
        raise made
    return made


def written(make: Callable[[Any], Made], folder: Path, task: Task[Row]) -> Row:
    """Make a picture's file and write it into the folder."""
    data, figures, notes = make(task.picture)
    write_atomically(folder / task.row.name, data)
    return replace(task.row, bytes=len(data), figures=figures, notes=notes)
