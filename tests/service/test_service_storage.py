"""Files are whole or absent, and lie only where our own keys say."""

from __future__ import annotations

import os
import stat
import time
from pathlib import Path

import pytest

from service.storage import DiskStorage, bitstream_key, source_key

JOB = "0123456789abcdef" * 2


@pytest.fixture
def storage(tmp_path: Path) -> DiskStorage:
    return DiskStorage(tmp_path / "data")


def files(storage: DiskStorage) -> list[str]:
    return sorted(path.name for path in storage._files())


def test_what_was_put_is_there(storage: DiskStorage, tmp_path: Path) -> None:
    for key in (source_key(JOB), bitstream_key(JOB, 1), bitstream_key(JOB, 2)):
        storage.put(key, key.encode())
    again = DiskStorage(tmp_path / "data")
    assert again.get(bitstream_key(JOB, 1)) == bitstream_key(JOB, 1).encode()
    with again.open(source_key(JOB)) as file:
        assert file.read() == source_key(JOB).encode()
    again.delete(source_key(JOB))
    again.delete(source_key(JOB))
    with pytest.raises(FileNotFoundError):
        again.get(source_key(JOB))
    assert files(again) == [f"{JOB}.1.sg", f"{JOB}.2.sg"]


@pytest.mark.parametrize(
    "key", ["", "a", "../a", "sources/../a", f"sources/{JOB}/a", f"sources/{JOB}\n", "/etc/passwd"]
)
def test_other_keys_are_refused(storage: DiskStorage, key: str) -> None:
    for action in (storage.get, storage.open, storage.delete):
        with pytest.raises(ValueError, match="not a storage key"):
            action(key)
    with pytest.raises(ValueError, match="not a storage key"):
        storage.put(key, b"")


def test_a_failed_write_leaves_nothing(storage: DiskStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space"):
        storage.put(source_key(JOB), b"data")
    assert files(storage) == []


def test_everything_is_synced_before_put_returns(storage: DiskStorage, monkeypatch: pytest.MonkeyPatch) -> None:
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
    storage.put(source_key(JOB), b"data")
    assert steps == ["sync file", "rename", "sync folder"]


def test_sweep_removes_old_files_that_nobody_needs(storage: DiskStorage, tmp_path: Path) -> None:
    kept, young, old = source_key(JOB), bitstream_key(JOB, 1), bitstream_key(JOB, 2)
    for key in (kept, young, old):
        storage.put(key, b"data")
    leftover = tmp_path / "data" / "unfinished" / "x"
    leftover.write_bytes(b"half")
    an_hour_ago = time.time() - 3600
    for path in (tmp_path / "data" / kept, tmp_path / "data" / old, leftover):
        os.utime(path, (an_hour_ago, an_hour_ago))
    assert storage.sweep({kept}, older_than_s=1800) == 2
    assert files(storage) == sorted([JOB, f"{JOB}.1.sg"])


def test_a_storage_that_is_gone(storage: DiskStorage, tmp_path: Path) -> None:
    storage.check()
    (tmp_path / "data").rename(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="No such file"):
        storage.check()


def test_pictures_are_the_owners_alone(storage: DiskStorage, tmp_path: Path) -> None:
    storage.put(source_key(JOB), b"data")
    assert (tmp_path / "data" / "sources").stat().st_mode & 0o077 == 0
