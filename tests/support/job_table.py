"""Job tables for tests, and jobs to put into them."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from pathlib import Path
from typing import Any

from service.jobs.job import BudgetView, EncodeRequest, EncodeResult, ImageView, Job, JobError, NewJob, new_job_id
from service.jobs.postgres import PostgresJobTable
from service.jobs.sqlite import SqliteJobTable
from service.jobs.table import JobTable
from service.settings import Settings

IMAGE = ImageView(format="PNG", width=64, height=48, bytes=1000)
RESULT = EncodeResult("ab" * 32, {"bytes": 100, "psnr": None})
CRASH, REFUSED = JobError("crashed", "it crashed"), JobError("refused", "no")
LONG_S, NO_TIME_S = 60.0, 0.0

OpenTable = Callable[..., JobTable]


def request_of(kind: str = "bpp", value: float = 1.0, **more: Any) -> EncodeRequest:
    """What a client asks for, with this budget."""
    members = {"profile": "rd", "tune": "psnr", "effort": 5, "time_limit_s": 60.0, **more}
    return EncodeRequest(budget=BudgetView(kind=kind, value=value, max_bpp=None), **members)


REQUEST = request_of()


def settings(lease_s: float = LONG_S, **options: Any) -> Settings:
    """Settings that need not be valid, as of a lease that is too short for a service."""
    return Settings().model_copy(update={"lease_s": lease_s, "source_retention_s": 0, **options})


def new(key: str | None = None, fingerprint: str = "f", image: ImageView = IMAGE, **more: Any) -> NewJob:
    return NewJob(new_job_id(), REQUEST, image, fingerprint, key, **more)


def submitted(table: JobTable, **more: Any) -> str:
    """The id of a new job."""
    return table.submit(new(**more))[0].id


def claimed(table: JobTable) -> Job:
    """The next claim; there must be one."""
    claim = table.claim("w")
    assert claim is not None
    return claim


def job_of(table: JobTable, job_id: str, owner: str | None = None) -> Job:
    """A job; there must be one."""
    job = table.get(job_id, owner)
    assert job is not None
    return job


def state(table: JobTable, job_id: str) -> str:
    return job_of(table, job_id).state


def change(table: JobTable, statement: str, *values: Any) -> None:
    """Write what no request writes, such as times long ago."""
    with table._transaction() as db:
        db.execute(statement, values)


def grow_older(table: JobTable, seconds: float) -> None:
    """Let so much time have passed since all that was written of jobs."""
    columns = ("created_at", "finished_at", "lease_until")
    change(table, f"UPDATE jobs SET {', '.join(f'{name} = {name} - ?' for name in columns)}", *[seconds] * 3)


def open_table(database_url: str, folder: Path, lease_s: float, **options: Any) -> JobTable:
    """The job table of SG_DATABASE_URL, SQLite's in the folder."""
    chosen = settings(lease_s, **options)
    if database_url == "sqlite":
        return SqliteJobTable(folder / "jobs.sqlite3", chosen)
    return PostgresJobTable(database_url, chosen)


def what_all_say(target: Callable[..., None], number: int, *arguments: Any) -> list[Any]:
    """What processes that start together put into their queue."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])  # else each process loads everything anew
    results = context.SimpleQueue()
    processes = [context.Process(target=target, args=(*arguments, results)) for _ in range(number)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
        assert process.exitcode == 0
    heard = []
    while not results.empty():
        heard.append(results.get())
    return heard
