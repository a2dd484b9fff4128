"""Every rule of sgmethod/io/files.py and the checks of sgmethod/io/png.py."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import numpy as np
import pytest

from sgmethod.io import encode_png, write_atomically
from sgmethod.io.png import ZLIB_LEVEL, zlib_compress


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
    write_atomically(os.devnull, b"gone")
    assert not Path(os.devnull).is_file()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.png", "out.png"]


def test_a_failed_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(_: int) -> None:
        raise OSError("no space left")

    target = tmp_path / "out.png"
    target.write_bytes(b"before")
    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match="no space"):
        write_atomically(target, b"after")
    assert target.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [target]
    with pytest.raises(OSError, match="missing"):
        write_atomically(tmp_path / "missing" / "out.png", b"x")
