"""Opens the job table and the storage that the settings name; only this module knows which they are."""

from __future__ import annotations

from service.errors import MissingPackagesError
from service.jobs.sqlite import SqliteJobTable
from service.jobs.table import JobTable
from service.settings import Settings
from service.storage.files import DiskStorage, Storage


def open_job_table(settings: Settings) -> JobTable:
    """Open the job table, or create it. Raises JobTableError, MissingPackagesError, OSError."""
    if settings.uses_postgres:
        try:
            from service.jobs.postgres import PostgresJobTable
        except ImportError as error:
            raise MissingPackagesError(
                f"PostgreSQL needs extra packages ({error}): pip install '.[postgres]'"
            ) from error
        return PostgresJobTable(settings.database_url, settings)
    settings.data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    return SqliteJobTable(settings.database_path, settings)


def open_storage(settings: Settings) -> Storage:
    """Open the storage of images and bitstreams, or create it. Raises OSError, MissingPackagesError."""
    if not settings.storage_url:
        return DiskStorage(settings.data_dir)
    try:
        from service.storage.bucket import BucketStorage
    except ImportError as error:
        raise MissingPackagesError(f"an object store needs extra packages ({error}): pip install '.[s3]'") from error
    return BucketStorage(settings.storage_url)
