"""Source images and bitstreams in a bucket that speaks S3, for workers on several machines."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import BinaryIO

import obstore
from obstore.exceptions import BaseError
from obstore.store import from_url

from service.storage.files import check_key

ENDPOINT = "AWS_ENDPOINT_URL"
TIMEOUT = timedelta(seconds=60)  # of one request; the largest image fits in at 1 MB a second
RETRIES_END_AFTER = timedelta(seconds=20)


@contextmanager
def _as_os_errors() -> Iterator[None]:
    try:
        yield
    except (BaseError, FileNotFoundError) as error:
        if isinstance(error, FileNotFoundError) and "NoSuchBucket" not in str(error):
            raise FileNotFoundError(errno.ENOENT, "there is no such object") from error
        first_line = str(error).strip().partition("\n")[0]
        raise OSError(errno.EIO, f"the object store failed: {first_line}") from error


class BucketStorage:
    """Storage in a bucket, beneath a prefix if the address has one.

    url: s3://bucket/prefix. Endpoint, region and credentials come from the usual AWS_ variables.
    """

    def __init__(self, url: str) -> None:
        endpoint = os.environ.get(ENDPOINT, "")
        if endpoint and not endpoint.startswith(("http://", "https://")):  # obstore would panic later
            raise OSError(errno.EINVAL, f"{ENDPOINT} must begin with http:// or https://, got {endpoint!r}")
        with _as_os_errors():
            self._store = from_url(
                url,
                # Plain HTTP only where the endpoint says so: a store within the same network.
                client_options={"allow_http": True, "timeout": TIMEOUT, "connect_timeout": timedelta(seconds=5)},
                retry_config={"max_retries": 5, "retry_timeout": RETRIES_END_AFTER},
            )

    def put(self, key: str, data: bytes) -> None:
        with _as_os_errors():
            # One request for the whole object: an upload that breaks off leaves no parts behind.
            obstore.put(self._store, check_key(key), data, use_multipart=False)

    def get(self, key: str) -> bytes:
        with _as_os_errors():
            return bytes(obstore.get(self._store, check_key(key)).bytes())

    def open(self, key: str) -> BinaryIO:
        data = self.get(key)
        file = tempfile.TemporaryFile()  # noqa: SIM115
        file.write(data)
        file.seek(0)
        return file

    def delete(self, key: str) -> None:
        with _as_os_errors():
            obstore.delete(self._store, check_key(key))

    def check(self) -> None:
        with _as_os_errors():
            next(iter(obstore.list(self._store, chunk_size=1)), None)

    def free_bytes(self) -> int | None:
        return None

    def old(self, age_s: float) -> Iterator[str]:
        oldest = datetime.now(UTC) - timedelta(seconds=age_s)
        with _as_os_errors():
            for chunk in obstore.list(self._store):
                yield from (entry["path"] for entry in chunk if entry["last_modified"] < oldest)
