"""Encoding any number of pictures on a server, several at a time."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import partial
from itertools import islice
from pathlib import Path
from threading import Thread
from typing import Any

from sgmethod.arguments import AnyInt, checked_integer
from sgmethod.budget import DEFAULT_BUDGET
from sgmethod.client.client import Client
from sgmethod.errors import ServerError
from sgmethod.io.files import bytes_of
from sgmethod.many.folder import Item, Made, into_folder, written
from sgmethod.many.manifest import Row, text_of
from sgmethod.many.processes import MAX_JOBS
from sgmethod.many.run import Finished, OnRow, Tally, Task, caught


def encode_many(
    client: Client,
    items: Iterable[Item],
    output_dir: str | os.PathLike[str],
    *,
    jobs: AnyInt = 4,
    resume: bool = False,
    on_row: OnRow[Row] | None = None,
    **options: Any,
) -> Tally:
    """Encode many pictures as sgmethod.encode_many() does, on a server.

    items: paths, or pairs of a name and the path or bytes of an image file; jobs: pictures on the server at a time;
    options: of Client.encode(), such as budget. A busy server is asked again until the client's patience ends: give it
    hours for a long run. Jobs of a run that was killed are found again by the next one into the same folder.
    """
    threads = checked_integer(jobs, "the number of jobs", 1, MAX_JOBS)
    options = {"budget": DEFAULT_BUDGET, "priority": "bulk", **options}

    def make(folder: Path, task: Task[Row]) -> Made:
        image = bytes_of(task.picture, ServerError)
        key = key_of(folder.resolve() / task.row.name, options, image)
        encoded = client.encode(image, idempotency_key=key, **options)
        return encoded.data, encoded.figures, encoded.notes

    def write(folder: Path, made: Future[Made], task: Task[Row]) -> Row:
        return written(lambda _: made.result(), folder, task)

    def finish(folder: Path, tasks: Iterator[Task[Row]]) -> Finished[Row]:
        # Files are written here: a thread that outlives the run must not replace those of the next one.
        for task, made in _in_threads(partial(make, folder), tasks, threads):
            yield caught(partial(write, folder, made), task)

    return into_folder(items, output_dir, options, finish, resume, on_row)


def key_of(target: Path, options: Mapping[str, object], image: bytes) -> str:
    """Return the idempotency key of a picture: the same for the same file of a later run."""
    asked = f"{target} {text_of(options)}"
    return hashlib.sha256(asked.encode(errors="surrogateescape") + image).hexdigest()


def _in_threads(
    make: Callable[[Task[Row]], Made], tasks: Iterator[Task[Row]], threads: int
) -> Iterator[tuple[Task[Row], Future[Made]]]:
    """Finish tasks in threads that nothing waits for after an error or Ctrl-C: a server may be busy for hours."""

    def run(task: Task[Row], future: Future[Made]) -> None:
        try:
            future.set_result(make(task))
        except BaseException as error:
            future.set_exception(error)

    running: dict[Future[Made], Task[Row]] = {}
    while True:
        for task in islice(tasks, threads - len(running)):
            future: Future[Made] = Future()
            running[future] = task
            Thread(target=run, args=(task, future), daemon=True).start()
        if not running:
            return
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            yield running.pop(future), future
