"""Source images and bitstreams in a bucket that speaks S3, for workers on several machines."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, BinaryIO

import obstore
from obstore.exceptions import BaseError
from obstore.store import from_url

from service.storage.files import check_key, is_key

if TYPE_CHECKING:
    from obstore.store import ClientConfig, RetryConfig

ENDPOINT = "AWS_ENDPOINT_URL"
# A store that accepts a connection and never answers counts as unreachable after this long, since clients wait.
SILENCE = timedelta(seconds=5)
SMALL_BYTES = 1 << 20  # are written within that time
TIMEOUT = timedelta(seconds=60)  # of one request; the largest image fits in at 1 MB a second
RETRIES_END_AFTER = timedelta(seconds=3)  # so that a request that was met with silence is not repeated


@contextmanager
def _as_os_errors() -> Iterator[None]:
    try:
        yield
    except (BaseError, FileNotFoundError) as error:
        if isinstance(error, FileNotFoundError) and "NoSuchBucket" not in str(error):
            raise FileNotFoundError(errno.ENOENT, "no such object") from error
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
        # Plain HTTP only where the endpoint says so: a store within the same network.
        options: ClientConfig = {"allow_http": True, "timeout": TIMEOUT, "connect_timeout": SILENCE}
        retries: RetryConfig = {"max_retries": 5, "retry_timeout": RETRIES_END_AFTER}
        with _as_os_errors():
            self._store = from_url(url, client_options={**options, "read_timeout": SILENCE}, retry_config=retries)
            # The library takes for silence too that nothing is read while much is written.
            self._patient = from_url(url, client_options=options, retry_config=retries)

    def put(self, key: str, data: bytes) -> None:
        store = self._store
        if len(data) > SMALL_BYTES:
            self.check()  # the request itself may take long
            store = self._patient
        with _as_os_errors():
            # One request for the whole object: an upload that breaks off leaves no parts behind.
            obstore.put(store, check_key(key), data, use_multipart=False)

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
                yield from (e["path"] for e in chunk if is_key(e["path"]) and e["last_modified"] < oldest)
