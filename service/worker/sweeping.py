"""Removes what is no longer needed: files without a job, and finished jobs when their time is over."""

from __future__ import annotations

from dataclasses import dataclass

from service.jobs.table import JobTable
from service.storage.files import Storage, source_key

# A file without a job was left over by a crash, or belongs to a job that is being accepted or finished just now. The
# latter takes seconds.
ORPHAN_AGE_S = 3600.0
LONGEST_PAUSE_S, SHORTEST_PAUSE_S = 3600.0, 1.0
OVERDUE = 1 / 4  # something may stay for longer than it is kept, by this part of that time


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
    source_retention_s: float = 0,
    orphan_age_s: float = ORPHAN_AGE_S,
    dry_run: bool = False,
) -> Swept:
    """Remove jobs that ended more than retention_s seconds ago (0: none), images of jobs that ended more than
    source_retention_s seconds ago, and files that no job needs.

    With dry_run nothing is removed. Raises JobTableError, OSError.
    """
    expired = table.finished(retention_s) if retention_s else []
    # An image whose time is over goes at once. What no job knows must be old: it may be of one that is being accepted.
    ended = table.finished(source_retention_s, with_image=True)
    keep = table.needed_keys()
    files = {*map(source_key, ended), *(key for key in storage.old(orphan_age_s) if key not in keep)}
    if not dry_run:
        for key in files:  # first: on a full disk, the job table cannot be written before
            storage.delete(key)
        for job_id in ended:
            table.source_removed(job_id)
        for job_id in expired:
            _remove(table, storage, job_id)
    return Swept(len(expired), len(files))


def pause_s(*kept_s: float) -> float:
    """Seconds from one sweep to the next. kept_s: how long things are kept, 0 for ever or not at all."""
    wanted_s = min((OVERDUE * seconds for seconds in kept_s if seconds), default=LONGEST_PAUSE_S)
    return min(max(wanted_s, SHORTEST_PAUSE_S), LONGEST_PAUSE_S)


def _remove(table: JobTable, storage: Storage, job_id: str) -> None:
    removed = table.remove(job_id)
    if removed is None:
        return
    storage.delete(source_key(job_id))  # which may be kept for as long
    if removed.result is not None:
        storage.delete(removed.result.bitstream_key)
