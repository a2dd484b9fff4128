"""Removal of files without a job, and of finished jobs after their retention time."""

from __future__ import annotations

from dataclasses import dataclass

from service.jobs.table import JobTable
from service.storage.files import Storage, discard, keys_of, source_key

# A file without a job was left over by a crash, or belongs to a job that is being accepted or finished just now. The
# latter takes seconds.
ORPHAN_AGE_S = 3600.0
MAX_PAUSE_S, MIN_PAUSE_S = 3600.0, 1.0
OVERDUE = 1 / 4  # something may stay for longer than it is kept, by this part of that time


@dataclass(frozen=True)
class SweepResult:
    """Numbers of removed jobs and files, and of files that could not be removed."""

    jobs: int
    files: int
    stuck: int = 0


def sweep(
    table: JobTable,
    storage: Storage,
    *,
    retention_s: float,
    source_retention_s: float = 0,
    orphan_age_s: float = ORPHAN_AGE_S,
) -> SweepResult:
    """Remove expired jobs and images, and files that no job needs.

    A file older than the job table stays: it is of a table that was lost.

    retention_s: age of finished jobs in seconds (0: keep them); source_retention_s: age of images of finished jobs.
    A file that cannot be removed, such as one under legal hold, is logged and left to the next sweep. Raises
    JobTableError, OSError.
    """
    expired = table.finished(retention_s) if retention_s else []
    # An image whose time is over goes at once. What no job knows must be old: it may be of one that is being accepted.
    ended = table.finished(source_retention_s, with_image=True)
    files = {*map(source_key, ended), *table.unneeded(storage.old(orphan_age_s, table.made_at()))}
    # First: on a full disk, the job table cannot be written before.
    stuck = {key for key in files if not discard(storage, key)}
    for job_id in ended:
        if source_key(job_id) not in stuck:
            table.source_removed(job_id)
    of_jobs = [key for job_id in expired for key in _remove(table, storage, job_id)]
    return SweepResult(len(expired), len(files) - len(stuck), len(stuck.union(of_jobs)))


def pause_s(*kept_s: float) -> float:
    """Return the seconds between sweeps. kept_s: retention times, 0 for ever or not at all."""
    wanted_s = min((OVERDUE * seconds for seconds in kept_s if seconds), default=MAX_PAUSE_S)
    return min(max(wanted_s, MIN_PAUSE_S), MAX_PAUSE_S)


def _remove(table: JobTable, storage: Storage, job_id: str) -> list[str]:
    """Remove a job. Returns the keys of its files that could not be removed."""
    removed = table.remove(job_id)
    keys = [] if removed is None else keys_of(job_id, removed.attempt)
    return [key for key in keys if not discard(storage, key)]
