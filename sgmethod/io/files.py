"""Files and their names: reading them whole, and writing them completely or not at all."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import suppress
from functools import partial
from pathlib import Path

from sgmethod.errors import SgError

# Some systems and file systems cannot sync folders, and a folder that may be written to may not be open to reading.
CANNOT_SYNC = {errno.EINVAL, errno.EBADF, errno.EISDIR, errno.ENOSYS, errno.ENOTSUP, errno.EACCES, errno.EPERM}

File = str | os.PathLike[str] | bytes | bytearray | memoryview  # a path, or the bytes themselves


def write_atomically(path: str | os.PathLike[str], data: bytes | memoryview, *, unfinished: Path | None = None) -> None:
    """Write data to path, or leave path unchanged after any failure.

    The data is written to a new file and synced, and only then renamed to the target, with the permissions and, if
    allowed, the owner of the file it replaces. The new file is created beside the target, or in the folder `unfinished`
    of the same file system, where a power cut may leave it to be cleaned up. Links are followed; devices and pipes are
    written directly. Raises OSError after removing the new file; only if the disk fails while the folder is
    synced at the end does the target already have the new data.
    """
    # Checked before links are resolved: /dev/stdout and >(...) are links to pipes that have no path.
    if Path(path).exists() and not Path(path).is_file():
        Path(path).write_bytes(data)
        return
    target = Path(os.path.realpath(path))  # Path.resolve raises RuntimeError on a loop of links
    if unfinished is None:
        temporary = target.with_name(f".{target.name[:40]}.{os.urandom(8).hex()}.tmp")
    else:
        temporary = unfinished / os.urandom(16).hex()
    before = target.stat() if target.exists() else None
    mode = 0o666 if before is None else stat.S_IMODE(before.st_mode)
    try:
        # Whoever may not read the old file may not open the new one either, not even while it is empty.
        with open(temporary, "xb", opener=partial(os.open, mode=mode)) as file:
            if before is not None:
                _take_over(temporary, before)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError) and error.filename == str(temporary) and error.filename2 is None:
            error.filename = os.fspath(path)  # that of the caller
        raise
    sync_folder(target.parent)


def _take_over(file: Path, before: os.stat_result) -> None:
    """Give a file the owner and permissions of the one it replaces, as far as the system allows."""
    with suppress(OSError, AttributeError):  # Windows has no owners
        os.chown(file, before.st_uid, before.st_gid)
    with suppress(OSError):
        file.chmod(stat.S_IMODE(before.st_mode))


def sync_folder(folder: Path) -> None:
    """Sync a folder's names to disk where that is possible. Raises OSError if the disk fails."""
    if os.name == "nt":
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno not in CANNOT_SYNC:
            raise


def checked_path(path: str | os.PathLike[str], error: type[SgError] = SgError) -> Path:
    """Convert to a Path. Raises `error` for an invalid file name."""
    name = os.fsdecode(path)
    try:
        if b"\0" not in os.fsencode(name):
            return Path(name)
    except UnicodeEncodeError:
        pass
    raise error(f"{name!r} is not a valid file name")


def bytes_of(file: File, error: type[SgError], name: str = "a file") -> bytes:
    """Return the bytes of a file. Raises OSError, and `error` for anything else. name: of the file in a message."""
    if isinstance(file, str | os.PathLike):
        return checked_path(file, error).read_bytes()
    if isinstance(file, bytes | bytearray | memoryview):
        return bytes(file)
    raise error(f"{name} must be a path or bytes, not {type(file).__name__}")
