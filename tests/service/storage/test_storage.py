"""Files are whole or absent, and lie only where our own keys say; on disk and in a bucket alike."""

from __future__ import annotations

import contextlib
import errno
import os
import ssl
import stat
import threading
import time
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import obstore
import pytest

from service.storage import bucket
from service.storage.bucket import BucketStorage
from service.storage.files import DiskStorage, Storage, bitstream_key, source_key
from tests.service.s3_server import S3Server
from tests.support.nginx import make_certificate
from tests.support.processes import failing

JOB = "0123456789abcdef" * 2
A_MOMENT_S = -5.0  # what was stored just now is older than this, whatever the server's clock

OpenStorage = Callable[[], Storage]


@pytest.fixture(params=["disk", "s3"])
def open_storage(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> OpenStorage:
    """Opens the same storage each time."""
    if request.param == "disk":
        return lambda: DiskStorage(tmp_path / "data")
    server: S3Server = request.getfixturevalue("s3")
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    url = server.new_storage()
    return lambda: BucketStorage(url)


@pytest.fixture
def storage(open_storage: OpenStorage) -> Storage:
    return open_storage()


@pytest.fixture
def disk(tmp_path: Path) -> DiskStorage:
    return DiskStorage(tmp_path / "data")


def test_what_was_put_is_there(storage: Storage, open_storage: OpenStorage) -> None:
    keys = {source_key(JOB), bitstream_key(JOB, 1), bitstream_key(JOB, 2)}
    for key in sorted(keys):
        storage.put(key, b"what is put again is replaced")
        storage.put(key, key.encode())
    again = open_storage()
    again.check()
    with again.open(bitstream_key(JOB, 1)) as file:
        assert file.read() == bitstream_key(JOB, 1).encode()
    with again.open(source_key(JOB)) as file:
        assert os.read(file.fileno(), 1000) == source_key(JOB).encode()  # as a child reads it
    assert set(again.old(A_MOMENT_S)) == keys
    assert list(again.old(60)) == []
    again.delete(source_key(JOB))
    again.delete(source_key(JOB))
    with pytest.raises(FileNotFoundError):
        again.open(source_key(JOB))
    assert set(storage.old(A_MOMENT_S)) == keys - {source_key(JOB)}


def test_a_disk_that_has_become_read_only(disk: DiskStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    """It can still be looked at. Only its free space shows that a disk is full."""
    disk.check()
    assert list(disk.old(A_MOMENT_S)) == []
    for code, refused in ((errno.EROFS, True), (errno.ENOSPC, False)):
        monkeypatch.setattr(Path, "touch", failing(Path.touch, OSError(code, "no")))
        with pytest.raises(OSError, match="no") if refused else contextlib.nullcontext():
            disk.check()


def test_files_of_others_are_left_alone(storage: Storage, tmp_path: Path) -> None:
    """Such as a file manager's: one of them ended the sweeper for good."""
    storage.put(source_key(JOB), b"data")
    if isinstance(storage, BucketStorage):
        for key in ("sources/marker", "backup/2026.tar"):
            obstore.put(storage._store, key, b"theirs")
    else:
        (tmp_path / "data" / "bitstreams" / ".DS_Store").write_bytes(b"theirs")
        (tmp_path / "data" / "sources" / "lost+found").mkdir()
    assert list(storage.old(A_MOMENT_S)) == [source_key(JOB)]


@pytest.mark.parametrize(
    "key", ["", "a", "../a", "sources/../a", f"sources/{JOB}/a", f"sources/{JOB}\n", "/etc/passwd"]
)
def test_other_keys_are_refused(storage: Storage, key: str) -> None:
    for action in (storage.open, storage.delete, partial(storage.put, data=b"")):
        with pytest.raises(ValueError, match="not a storage key"):
            action(key)


def test_everything_is_synced_before_put_returns(disk: DiskStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rule 1: the file's bytes before the rename, the folder after it."""
    steps: list[str] = []
    sync, rename = os.fsync, Path.replace

    def note_sync(descriptor: int) -> None:
        steps.append("sync " + ("folder" if stat.S_ISDIR(os.fstat(descriptor).st_mode) else "file"))
        sync(descriptor)

    def note_rename(path: Path, target: Path) -> Path:
        steps.append("rename")
        return rename(path, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_rename)
    disk.put(source_key(JOB), b"data")
    assert steps == ["sync file", "rename", "sync folder"]


def test_what_was_never_stored_whole_is_old(disk: DiskStorage, tmp_path: Path) -> None:
    leftover = f"unfinished/{JOB}"
    path = tmp_path / "data" / leftover
    path.write_bytes(b"half")
    assert list(disk.old(60)) == []
    an_hour_ago = time.time() - 3600
    os.utime(path, (an_hour_ago, an_hour_ago))
    assert list(disk.old(60)) == [leftover]
    disk.delete(leftover)
    assert not path.exists()


def test_a_missing_storage(disk: DiskStorage, tmp_path: Path) -> None:
    disk.check()
    (tmp_path / "data").rename(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="No such file"):
        disk.check()


def test_a_bucket_that_is_not_there(s3: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in s3.environment.items():
        monkeypatch.setenv(name, value)
    storage = BucketStorage("s3://another/sgmethod")
    for action, words in ((storage.check, ": .*404"), (partial(storage.put, source_key(JOB), b"data"), "")):
        with pytest.raises(OSError, match=f"the object store failed{words}"):
            action()


def test_a_bucket_that_stores_slowly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small objects were given up after SILENCE, and a worker tried to store its result again for ever."""
    monkeypatch.setattr(bucket, "SILENCE", timedelta(seconds=2))
    stored: list[bytes] = []

    class Slow(BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # an empty bucket
            self.respond(b"<ListBucketResult><Name>pictures</Name><IsTruncated>false</IsTruncated></ListBucketResult>")

        def do_PUT(self) -> None:
            stored.append(self.rfile.read(int(self.headers["Content-Length"])))
            time.sleep(3)
            self.respond(b"")

        def respond(self, body: bytes) -> None:
            self.send_response(200)
            self.send_header("ETag", '"1"')
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    with ThreadingHTTPServer(("127.0.0.1", 0), Slow) as server:
        threading.Thread(target=server.serve_forever).start()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_address[1]}")
        try:
            storage = BucketStorage("s3://pictures/sgmethod")
            storage.put(source_key(JOB), b"data")
            assert stored == [b"data"]
        finally:
            server.shutdown()


def test_a_certificate_that_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message was no more than that a request could not be sent."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(make_certificate(tmp_path), tmp_path / "key.pem")
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:
        server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever).start()
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            monkeypatch.setenv(name, "test")
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"https://localhost:{server.server_address[1]}")
        with pytest.raises(OSError, match=r"certificate is not trusted; .* SSL_CERT_FILE"):
            BucketStorage("s3://pictures/sgmethod").check()
        server.shutdown()


def test_pictures_are_the_owners_alone(disk: DiskStorage, tmp_path: Path) -> None:
    disk.check()
    assert (tmp_path / "data" / "sources").stat().st_mode & 0o077 == 0
