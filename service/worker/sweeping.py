"""Removes what is no longer needed: files without a job, and finished jobs when their time is over."""

from __future__ import annotations

from dataclasses import dataclass

from service.jobs.job import Job
from service.jobs.table import JobTable
from service.storage.files import Storage, job_of_source, source_key

# A file without a job was left over by a crash, or belongs to a job that is being accepted or finished just now. The
# latter takes seconds.
ORPHAN_AGE_S = 3600.0


@dataclass(frozen=True)
class Swept:
    """How many of each went, or would go."""

    jobs: int
    files: int


def sweep(
    table: JobTable,
    storage: Storage,
    *,
    retention_s: float,
    orphan_age_s: float = ORPHAN_AGE_S,
    dry_run: bool = False,
) -> Swept:
    """Remove jobs that ended more than retention_s seconds ago (0: none), and files that no job needs.

    With dry_run nothing is removed. Raises JobTableError, OSError.
    """
    expired = table.finished(retention_s) if retention_s else []
    if not dry_run:
        for job in expired:
            _remove(table, storage, job)
    keep = table.needed_keys()
    orphans = [key for key in storage.old(orphan_age_s) if key not in keep]
    if not dry_run:
        for key in orphans:
            storage.delete(key)
            job_id = job_of_source(key)
            if job_id is not None:
                table.source_removed(job_id)
    return Swept(len(expired), len(orphans))


def _remove(table: JobTable, storage: Storage, job: Job) -> None:
    removed = table.remove(job.id)
    if removed is None:
        return
    storage.delete(source_key(removed.id))  # which may be kept for as long
    if removed.result is not None:
        storage.delete(removed.result.bitstream_key)
