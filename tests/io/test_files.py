"""Every rule of sgmethod/io/files.py and the checks of sgmethod/io/kinds/png.py."""

from __future__ import annotations

import errno
import os
import stat
import zlib
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from sgmethod.io.files import write_atomically
from sgmethod.io.kinds.png import ZLIB_LEVEL, encode_png, zlib_compress


@pytest.mark.parametrize("size", [1, 2, 3, 1000, 70_000, 200_000])
def test_two_threads_make_one_stream(size: int) -> None:
    """What repeats reaches back over the middle."""
    data = (np.arange(size) % 20_011 * 7 % 251).astype(np.uint8)
    compressed = zlib_compress(data.data)
    assert zlib.decompress(compressed) == data.tobytes()
    assert len(compressed) < len(zlib.compress(data, ZLIB_LEVEL)) * 1.1 + 20


def test_encode_png_refuses_other_arrays() -> None:
    for pixels in (np.zeros((2, 2, 5), np.uint8), np.zeros((2, 2), np.uint8), np.zeros((0, 2, 3), np.uint8)):
        with pytest.raises(ValueError, match="uint8"):
            encode_png(pixels)
    with pytest.raises(ValueError, match="float64"):
        encode_png(np.zeros((2, 2, 3)))  # type: ignore[arg-type]


def test_write_atomically(tmp_path: Path) -> None:
    target = tmp_path / "out.png"
    for data in (b"first", b"second"):
        write_atomically(target, data)
        assert target.read_bytes() == data
    link = tmp_path / "link.png"
    link.symlink_to(target)
    write_atomically(link, b"third")
    assert link.is_symlink()
    assert target.read_bytes() == b"third"
    write_atomically(os.devnull, b"data")
    for path, error in ((tmp_path / "nowhere" / "out.sg", FileNotFoundError), (target / "out.sg", NotADirectoryError)):
        with pytest.raises(error, match=f"'{path}'$"):
            write_atomically(path, b"lost")
    assert not Path(os.devnull).is_file()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.png", "out.png"]


@pytest.mark.parametrize("mode", [0o600, 0o644, 0o400, 0o660])
def test_a_file_that_is_replaced_keeps_its_mode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int) -> None:
    """No other user may read the new one before it has the name."""
    target, real, seen = tmp_path / "out.sg", os.open, []

    def spy(path: str, flags: int, *more: int, **named: int) -> int:
        descriptor = real(path, flags, *more, **named)
        seen.append(stat.S_IMODE(os.fstat(descriptor).st_mode))
        return descriptor

    target.write_bytes(b"before")
    target.chmod(mode)
    with monkeypatch.context() as patch:
        patch.setattr(os, "open", spy)
        write_atomically(target, b"after")
    assert seen[0] & ~mode == 0
    assert target.read_bytes() == b"after"
    assert stat.S_IMODE(target.stat().st_mode) == mode


def test_a_new_file_has_the_mode_that_the_process_gives(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "out.sg", b"new")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "out.sg").stat().st_mode) == 0o640


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
def test_a_file_that_is_replaced_keeps_its_owner(tmp_path: Path) -> None:
    target = tmp_path / "out.sg"
    target.write_bytes(b"before")
    os.chown(target, 12345, 54321)
    target.chmod(0o640)
    write_atomically(target, b"after")
    found = target.stat()
    assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (12345, 54321, 0o640)


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="pipes have no names here")
def test_a_pipe_is_written_by_its_name() -> None:
    reader, writer = os.pipe()
    write_atomically(f"/dev/fd/{writer}", b"through")
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        assert pipe.read() == b"through"


def test_a_failed_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "out.png"
    target.write_bytes(b"before")
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError("no space left")))
    with pytest.raises(OSError, match="no space"):
        write_atomically(target, b"after")
    assert target.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [target]
    with pytest.raises(OSError, match="missing"):
        write_atomically(tmp_path / "missing" / "out.png", b"x")


@pytest.mark.parametrize(
    ("number", "reported"), [(errno.EINVAL, False), (errno.ENOTSUP, False), (errno.EACCES, False), (errno.EIO, True)]
)
def test_a_folder_that_cannot_be_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, reported: bool
) -> None:
    """Only a disk that fails is an error: the file is there, and more cannot be done where folders are not synced."""
    sync = os.fsync

    def only_files(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", only_files)
    with pytest.raises(OSError, match=os.strerror(number)) if reported else nullcontext():
        write_atomically(tmp_path / "out.sg", b"new")
    assert (tmp_path / "out.sg").read_bytes() == b"new"


def test_a_folder_that_cannot_be_listed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One may write to it, as to a folder to drop files into."""
    opened = os.open

    def without_folders(path: str, flags: int, *more: int, **named: int) -> int:
        if flags & os.O_DIRECTORY:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return opened(path, flags, *more, **named)

    monkeypatch.setattr(os, "open", without_folders)
    write_atomically(tmp_path / "out.sg", b"new")
    assert (tmp_path / "out.sg").read_bytes() == b"new"


def test_owner_and_mode_that_a_file_system_cannot_give(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container's kernel calls owners that it does not know invalid."""
    (tmp_path / "out.sg").write_bytes(b"before")
    for name in ("chown", "chmod"):
        monkeypatch.setattr(os, name, Mock(side_effect=OSError(errno.EINVAL, os.strerror(errno.EINVAL))))
    write_atomically(tmp_path / "out.sg", b"after")
    assert (tmp_path / "out.sg").read_bytes() == b"after"
