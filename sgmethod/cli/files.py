"""What the commands read and write, and the errors of both in one sentence with the path as it was given."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sgmethod.io.files import write_atomically

MAX_INPUT_BYTES = 1 << 30  # the largest picture that is read takes 800 MB uncompressed; a device never ends


class CommandError(Exception):
    """What keeps a command from being carried out, in one sentence."""


def read(path: str) -> bytes:
    """The bytes of a file, of at most MAX_INPUT_BYTES."""
    data = bytearray()
    with _saying("read", path), Path(path).open("rb") as file:
        while block := file.read(1 << 20):
            data += block
            if len(data) > MAX_INPUT_BYTES:
                raise CommandError(f"cannot read {path}: it has more than {MAX_INPUT_BYTES:,} bytes")
    return bytes(data)


def write(path: str, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with _saying("write", path):
        write_atomically(path, data)


@contextmanager
def _saying(verb: str, path: str) -> Iterator[None]:
    """What the system refuses becomes one sentence with the path as it was given."""
    try:
        yield
    except OSError as error:
        raise CommandError(f"cannot {verb} {path}: {error.strerror or error}") from error


def check_outputs(source: str, outputs: list[str]) -> None:
    """Raise CommandError if one of the files cannot be written, or would replace the input or each other."""
    for path in outputs:
        with _saying("write", path):
            _check_writable(Path(os.path.realpath(path)))
    files = [os.path.realpath(path) for path in (source, *outputs) if not _is_device(path)]
    if len(set(files)) < len(files):
        raise CommandError("the input and what is written must be different files")


def _is_device(path: str) -> bool:
    return Path(path).exists() and not Path(path).is_file()


def _check_writable(target: Path) -> None:
    """Raise OSError as writing would."""
    mode = None
    with suppress(FileNotFoundError):
        mode = target.stat().st_mode
    if mode is not None and stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if mode is not None and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    if mode is None or stat.S_ISREG(mode):
        with tempfile.TemporaryFile(dir=target.parent):
            pass
