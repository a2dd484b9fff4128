"""Source images and bitstreams in an S3 bucket, for workers on several machines."""

from __future__ import annotations

import errno
import os
import re
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

# Parts of the library's messages, and what they mean.
HINTS = {
    "InvalidCertificate(": "its certificate is not trusted; name its authority's certificate in SSL_CERT_FILE "
    "(AWS_CA_BUNDLE is not read)",
    "No CA certificates": "no certificates of authorities were found; correct SSL_CERT_FILE and SSL_CERT_DIR, or "
    "install ca-certificates",
    "http://169.254.169.254/": "it has no credentials; set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
}
# Clients wait, so a store that is silent for this long counts as unreachable.
SILENCE = timedelta(seconds=5)
TIMEOUT = timedelta(seconds=60)  # of one request: enough for the largest image at 1 MB a second
RETRIES_END_AFTER = timedelta(seconds=3)  # so that a request without an answer is not repeated


@contextmanager
def _as_os_errors() -> Iterator[None]:
    try:
        yield
    except (BaseError, FileNotFoundError) as error:
        if isinstance(error, FileNotFoundError) and "NoSuchBucket" not in str(error):
            raise FileNotFoundError(errno.ENOENT, "no such object") from error
        raise OSError(errno.EIO, f"the object store failed: {_explain(str(error))}") from error
    except BaseException as error:
        if type(error).__name__ == "PanicException":  # of the library, and not a subclass of Exception
            words = "the object store's library panicked, as it does for a malformed AWS_ variable"
            raise OSError(errno.EIO, f"{words}: {error}") from error
        raise


def _explain(text: str) -> str:
    """Return the library's error as one line. Its cause, if given, is some twenty lines further down."""
    for word, hint in HINTS.items():
        if word in text:
            return hint
    causes = re.findall(r'^ +(?:message|error): "(.+)"', text, re.MULTILINE)
    return ", ".join([text.strip().partition("\n")[0], *causes])


class BucketStorage:
    """Storage in a bucket, beneath a prefix if the URL has one.

    url: s3://bucket/prefix. Endpoint, region and credentials come from the usual AWS_ variables.
    """

    def __init__(self, url: str) -> None:
        # A secret made from a file may have a line end: the library would panic, or sign with it and get a 403.
        for name, value in os.environ.items():
            if name.startswith("AWS_") and value != value.strip():
                raise OSError(errno.EINVAL, f"{name} begins or ends with a space or a line end")
        # Plain HTTP is used only if the endpoint says so.
        options: ClientConfig = {"allow_http": True, "timeout": TIMEOUT, "connect_timeout": SILENCE}
        retries: RetryConfig = {"max_retries": 5, "retry_timeout": RETRIES_END_AFTER}
        with _as_os_errors():
            self._store = from_url(url, client_options={**options, "read_timeout": SILENCE}, retry_config=retries)
            # For uploads: read_timeout would also count while an object is being sent and stored.
            self._patient = from_url(url, client_options=options, retry_config=retries)

    def put(self, key: str, data: bytes | memoryview) -> None:
        self.check()  # fails fast if the store is down; storing even a small object may take long
        with _as_os_errors():
            # One request for the whole object, so that a broken upload leaves no parts behind.
            obstore.put(self._patient, check_key(key), data, use_multipart=False)

    def open(self, key: str) -> BinaryIO:
        with _as_os_errors():
            data = bytes(obstore.get(self._store, check_key(key)).bytes())
        try:
            file = tempfile.TemporaryFile()  # noqa: SIM115
        except FileNotFoundError as error:  # whose type would mean that the bucket lacks the object
            raise OSError(errno.EIO, f"there is no folder for temporary files: {error}") from error
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

    def old(self, age_s: float, since: float = 0) -> Iterator[str]:
        first, until = datetime.fromtimestamp(since, UTC), datetime.now(UTC) - timedelta(seconds=age_s)
        with _as_os_errors():
            for chunk in obstore.list(self._store):
                yield from (e["path"] for e in chunk if is_key(e["path"]) and first <= e["last_modified"] < until)
