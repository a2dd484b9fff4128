"""Checks of an installation before the service starts."""

from __future__ import annotations

import asyncio
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

from service.errors import JobTableError, MissingPackagesError
from service.opening import open_job_table, open_storage
from service.sandbox.client import Sandbox, TaskError, own_sandbox
from service.sandbox.confinement import SandboxError, absent_layers, check_layers
from service.settings import IDLE_BYTES, MIN_FREE_UPLOADS, Settings
from service.storage.files import UNFINISHED
from sgmethod import machine
from sgmethod.errors import SgError
from sgmethod.profiles import PROFILE_NAMES, method_of

SANDBOX_STARTS_S = 30.0  # at the latest
ENCODE_BYTES = 650_000_000  # the least SG_JOB_MEMORY_BYTES with which 12 megapixels were encoded by default
ISA_NAMES = ("x86-64", "AVX2", "AVX-512")


class CheckError(Exception):
    """A check failed; one sentence."""


TROUBLE = (CheckError, JobTableError, MissingPackagesError, SandboxError, TaskError, SgError, OSError, ImportError)


def check(settings: Settings) -> Iterator[tuple[str, bool, str]]:
    """Run the checks, and yield the name of each, whether it passed, and a description. Raises nothing."""
    checks: dict[str, Callable[[Settings], str]] = {
        "settings": _settings,
        "database": _database,
        "storage": _storage,
        "free disk": _free_disk,
        "kernels": _kernels,
        "sandbox": _sandbox,
    }
    for name, run in checks.items():
        try:
            yield name, True, run(settings)
        except TROUBLE as error:
            yield name, False, str(error)


def _settings(settings: Settings) -> str:
    words = f"workers: {settings.workers}; threads of each: {settings.encode_threads}"
    left = max(0, machine.memory() - IDLE_BYTES)
    share = min(settings.job_memory_bytes, left // settings.workers)
    if settings.job_memory_bytes > left:
        words += f"; SG_JOB_MEMORY_BYTES exceeds the {left:,} bytes of memory that the service itself leaves:"
        words += " the system may kill an encode"
    elif share < ENCODE_BYTES:
        words += f"; an encode has {share:,} bytes of memory, and a photograph of 12 megapixels takes {ENCODE_BYTES:,}:"
        words += " lower SG_WORKERS or SG_MAX_PIXELS, or such jobs fail"
    return words


def _database(settings: Settings) -> str:
    table = open_job_table(settings)
    table.check_writable()
    jobs = table.counts().jobs
    table.close()
    kind = "PostgreSQL" if settings.uses_postgres else f"SQLite, {settings.database_path}"
    return f"{kind}: {', '.join(f'{count} {state}' for state, count in jobs.items())}"


def _storage(settings: Settings) -> str:
    storage = open_storage(settings)
    key, data = f"{UNFINISHED}/{secrets.token_hex(16)}", secrets.token_bytes(1024)
    storage.put(key, data)
    try:
        with storage.open(key) as file:
            if file.read() != data:
                raise CheckError("a stored file came back changed")
    finally:
        storage.delete(key)
    return f"{settings.storage_url or settings.data_dir}: stored, read and removed a file"


def _free_disk(settings: Settings) -> str:
    uses_data_dir = not (settings.uses_postgres and settings.storage_url)
    folder = settings.data_dir if uses_data_dir else Path(tempfile.gettempdir())
    free = shutil.disk_usage(folder).free
    if free < settings.min_free_bytes:
        raise CheckError(f"{folder}: only {free:,} bytes free, less than {MIN_FREE_UPLOADS} of the largest uploads")
    return f"{folder}: {free:,} bytes"


def _kernels(_settings: Settings) -> str:
    from sgmethod.native import native

    lacking = [name for name in PROFILE_NAMES if not all(map(find_spec, method_of(name).packages))]
    needed = [f"profile {name} needs PyTorch: pip install 'sgmethod[torch]'" for name in lacking]
    return "; ".join([ISA_NAMES[native.best_isa()], *needed])


def _sandbox(settings: Settings) -> str:
    """Run a task in the sandbox. A missing layer is a failure only where it is required."""
    absent = absent_layers()  # before there is a second thread
    warnings = check_layers(absent, required=settings.require_sandbox)
    with own_sandbox(settings, absent) as requests:
        asyncio.run(Sandbox(requests).try_out(SANDBOX_STARTS_S))
    return "; ".join(warnings) or "every layer is there"
