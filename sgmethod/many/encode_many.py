"""Encoding any number of pictures into a folder."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from sgmethod.arguments import AnyInt, checked_integer
from sgmethod.budget import BUDGET_KINDS, Budget
from sgmethod.codec import encode
from sgmethod.errors import SgError, noted
from sgmethod.io.image import Input
from sgmethod.many.folder import Item, Made, finish_elsewhere, into_folder, written
from sgmethod.many.manifest import Row
from sgmethod.many.processes import MAX_JOBS
from sgmethod.many.run import Finished, OnRow, Tally, Task, caught, finish_locally, made_or_error

GIVEN, MAX_GIVEN = 1000, 100_000  # pictures that an executor is given at a time


def encode_many(
    items: Iterable[Item],
    output_dir: str | os.PathLike[str],
    *,
    jobs: AnyInt | None = None,
    executor: Executor | None = None,
    resume: bool = False,
    on_row: OnRow[Row] | None = None,
    **options: Any,
) -> Tally:
    """Encode any number of pictures to output_dir/NAME.sg, with a manifest, output_dir/manifest.jsonl.

    items: paths of pictures, NAME being the file's without its suffix, or with it if another file has that name, here
    or in the manifest, in capitals or not; or pairs (NAME, picture) with a picture as encode() takes it. They are taken
    one by one, and may come from a generator.
    jobs: pictures encoded at a time, 1 (the default) to 256, each in a process with its share of the threads. A script
    that asks for more than one needs `if __name__ == "__main__":`, as for every use of multiprocessing.
    executor: where pictures are encoded instead, such as a cluster; it is given `jobs` of them at a time (by default
    1,000, at most 100,000) and is not shut down. It reads pictures that are paths; files and manifest are written here.
    resume: skip pictures that the manifest has, if their files are there, options and version are the same and, for
    paths, the picture's size and time; pictures in memory are known by name alone.
    on_row: called with each finished picture's line of the manifest, and with the progress of the run.
    options: keyword arguments of encode().

    A picture that cannot be encoded, or that ends its process, is recorded with its error; the rest continues. Resume
    tries it again, last. Raises SgError for a name that is invalid or used twice, for a manifest that cannot be written
    and for an executor that has broken or raises an OSError, such as a lost connection; and OSError if the folder
    cannot be created. After any, run again with resume.
    """
    if executor is not None and not isinstance(executor, Executor):
        raise SgError(f"an executor must be a concurrent.futures.Executor, not {type(executor).__name__}")
    usual, limit = (1, MAX_JOBS) if executor is None else (GIVEN, MAX_GIVEN)
    number = checked_integer(usual if jobs is None else jobs, "the number of jobs", 1, limit)

    def finish(folder: Path, tasks: Iterator[Task[Row]]) -> Finished[Row]:
        if executor is not None:
            return _finish_by(executor, options, folder, tasks, number)
        make = partial(caught, partial(written, partial(_encode, options), folder.absolute()))
        return finish_locally(make, tasks, number)

    return into_folder(items, output_dir, _with_one_budget(options), finish, resume, on_row)


def _finish_by(
    executor: Executor, options: dict[str, Any], folder: Path, tasks: Iterator[Task[Row]], limit: int
) -> Finished[Row]:
    def begin(task: Task[Row]) -> Future[Made | Exception]:
        picture = task.picture  # the executor's processes may have another current folder
        there = Path(picture).absolute() if isinstance(picture, str | os.PathLike) else picture
        # Its error is returned, not raised: it must not look like the executor's.
        return executor.submit(made_or_error, partial(_encode, options), there)

    return finish_elsewhere(begin, folder, tasks, limit)


def _with_one_budget(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options in which equal budgets look equal, for the manifest: quality "web", 60 and 60.0."""
    names = [name for name in BUDGET_KINDS if options.get(name) is not None]
    given = options.get("budget")
    with suppress(SgError):  # which each picture raises, as it does for several
        if len(names) == 1 and given is None:
            given = Budget(names[0], options[names[0]])
        if isinstance(given, Budget):
            others = {name: value for name, value in options.items() if name not in BUDGET_KINDS}
            return {**others, "budget": (given.kind, float(given.value))}
    return dict(options)


def _encode(options: dict[str, Any], picture: Input) -> Made:
    with noted() as notes:
        encoded = encode(picture, **options)
    return encoded.data, encoded.stats.to_dict(), notes
