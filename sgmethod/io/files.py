"""Files that are whole or absent."""

from __future__ import annotations

import os
from pathlib import Path


def write_atomically(path: str | os.PathLike[str], data: bytes, *, unfinished: Path | None = None) -> None:
    """Write data to path, which then holds all of it or, after any failure, what it held before.

    The bytes go to a new file and to the disk, and only then take the target's name. The new file lies beside the
    target, or in the folder `unfinished` of the same file system, where a power cut may leave it to be swept up. A
    link is followed; a device or pipe is written directly. Raises OSError, having removed the new file; only if the
    disk fails to take the new name at the very end, the target holds the data all the same.
    """
    target = Path(os.path.realpath(path))  # Path.resolve raises RuntimeError on a loop of links
    if target.exists() and not target.is_file():
        target.write_bytes(data)
        return
    if unfinished is None:
        temporary = target.with_name(f".{target.name[:40]}.{os.urandom(8).hex()}.tmp")
    else:
        temporary = unfinished / os.urandom(16).hex()
    try:
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync_folder(target.parent)


def sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where a system lets one ask for that. Raises OSError."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
