"""Encoding any number of pictures on a server, several at a time."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from sgmethod.budget import DEFAULT_BUDGET, whole
from sgmethod.client.client import Client, bytes_of
from sgmethod.many.manifest import Row
from sgmethod.many.run import Item, Made, OnRow, Picture, Tally, made, run

MAX_JOBS = 256


def encode_many(
    client: Client,
    items: Iterable[Item],
    output_dir: str | os.PathLike[str],
    *,
    jobs: int = 4,
    resume: bool = False,
    on_row: OnRow | None = None,
    **options: Any,
) -> Tally:
    """sgmethod.encode_many() by a server. items: paths, or pairs of a name and the path or bytes of an image file;
    jobs: pictures that the server has at a time; options: of Client.encode(), such as budget.

    A server that is busy is asked again for as long as the client has patience: give it hours for a long run. Jobs of a
    run that was killed are found again by the next one into the same folder.
    """
    threads = whole(jobs, "the number of jobs", 1, MAX_JOBS)
    options = {"budget": DEFAULT_BUDGET, "priority": "bulk", **options}

    def make_row(folder: Path, one: Picture) -> Row:
        def make(picture: Any) -> Made:
            image = bytes_of(picture)
            asked = f"{folder.resolve()} {one.row.name} {sorted(options.items())!r}"
            key = hashlib.sha256(asked.encode(errors="surrogateescape") + image).hexdigest()
            encoded = client.encode(image, idempotency_key=key, **options)
            return encoded.data, encoded.figures, encoded.notes

        return made(make, folder, one)

    def finish(folder: Path, pictures: Iterator[Picture]) -> Generator[Row, None, None]:
        yield from _in_threads(partial(make_row, folder), pictures, threads)

    return run(items, output_dir, options, finish, resume, on_row)


def _in_threads(
    make_row: Callable[[Picture], Row], pictures: Iterator[Picture], threads: int
) -> Generator[Row, None, None]:
    running: set[Future[Row]] = set()
    with ThreadPoolExecutor(threads, "sgmethod") as pool:
        while True:
            running |= {pool.submit(make_row, one) for one in islice(pictures, threads - len(running))}
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
