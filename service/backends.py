"""Opens the job table and the storage that the settings name; the only place that knows which they are."""

from __future__ import annotations

from service.jobs.interface import BackendError, JobBackend, JobRules
from service.jobs.sqlite import SqliteJobs
from service.settings import Settings
from service.storage.disk import DiskStorage, Storage


def open_backend(settings: Settings) -> JobBackend:
    """The job table, made if there is none yet. Raises BackendError, OSError."""
    rules = JobRules(settings.lease_s, settings.max_attempts, settings.max_running_per_key)
    if settings.uses_postgres:
        try:
            from service.jobs.postgres import PostgresJobs
        except ImportError as error:
            raise BackendError("PostgreSQL needs more packages: pip install '.[postgres]'") from error
        return PostgresJobs(settings.database_url, rules)
    settings.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    return SqliteJobs(settings.database_path, rules)


def open_storage(settings: Settings) -> Storage:
    """The storage of sources and bitstreams, made if there is none yet. Raises OSError, BackendError."""
    if not settings.storage_url:
        return DiskStorage(settings.data_dir)
    try:
        from service.storage.bucket import ObjectStorage
    except ImportError as error:
        raise BackendError("an object store needs more packages: pip install '.[s3]'") from error
    return ObjectStorage(settings.storage_url)
