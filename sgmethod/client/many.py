"""Encoding any number of pictures on a server, several at a time."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

from sgmethod.arguments import AnyInt, checked_integer
from sgmethod.client.client import Client
from sgmethod.errors import ServerError
from sgmethod.io.files import bytes_of
from sgmethod.many.folder import Item, Made, finish_elsewhere, into_folder
from sgmethod.many.manifest import Row, text_of
from sgmethod.many.processes import MAX_JOBS
from sgmethod.many.run import Finished, OnRow, Tally, Task, made_or_error


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
    options = {"priority": "bulk", **options}

    def make(folder: Path, task: Task[Row]) -> Made:
        image = bytes_of(task.picture, ServerError)
        key = key_of(folder.resolve() / task.row.name, options, image)
        encoded = client.encode(image, idempotency_key=key, **options)
        return encoded.data, encoded.figures, encoded.notes

    def finish(folder: Path, tasks: Iterator[Task[Row]]) -> Finished[Row]:
        return finish_elsewhere(partial(_in_thread, partial(make, folder)), folder, tasks, threads)

    return into_folder(items, output_dir, options, finish, resume, on_row)


def key_of(target: Path, options: Mapping[str, object], image: bytes) -> str:
    """Return the idempotency key of a picture: the same for the same file of a later run."""
    asked = f"{target} {text_of(options)}"
    return hashlib.sha256(asked.encode(errors="surrogateescape") + image).hexdigest()


def _in_thread(make: Callable[[Task[Row]], Made], task: Task[Row]) -> Future[Made | Exception]:
    """Begin a task in a thread that nothing waits for after an error or Ctrl-C: a server may be busy for hours."""
    future: Future[Made | Exception] = Future()
    future.set_running_or_notify_cancel()
    Thread(target=lambda: future.set_result(made_or_error(make, task)), daemon=True).start()
    return future
